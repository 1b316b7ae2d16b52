"""Fit one entry to one material."""

from brdfatlas.pipeline.jobs import fit_job
from brdfatlas.pipeline.logs import logged

how = snakemake.params.fitting
with logged(snakemake.log[0], how["planned"]):
    fit_job(
        entry=how["entry"],
        seed=how["seed"],
        binary=snakemake.input.binary,
        standin=how["standin"],
        fit_path=snakemake.output.fit,
        report_path=snakemake.output.report,
    )
