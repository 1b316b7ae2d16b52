"""Fit one entry to one material."""

from brdfatlas.pipeline.jobs import fit_job
from brdfatlas.pipeline.logs import logged

with logged(snakemake.log[0], snakemake.params.planned):
    fit_job(
        entry=snakemake.params.entry,
        seed=snakemake.params.seed,
        binary=snakemake.input.binary,
        standin=snakemake.params.standin,
        fit_path=snakemake.output.fit,
        report_path=snakemake.output.report,
    )
