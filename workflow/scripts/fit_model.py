"""Fit one model to one material."""

from brdfatlas.pipeline.jobs import fit_job
from brdfatlas.pipeline.logs import logged

with logged(snakemake.log[0]):
    fit_job(
        model=snakemake.params.model,
        source=snakemake.params.source,
        options=snakemake.params.options,
        seed=snakemake.params.seed,
        binary=snakemake.input.binary,
        standin=snakemake.params.standin,
        fit_path=snakemake.output.fit,
        report_path=snakemake.output.report,
    )
