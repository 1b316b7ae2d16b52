"""Fail, after the report is out, if any fit failed."""

from brdfatlas.pipeline.jobs import check_failures_job
from brdfatlas.pipeline.logs import logged

with logged(snakemake.log[0]):
    check_failures_job(snakemake.input.reports, snakemake.output[0])
