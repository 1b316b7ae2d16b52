"""Fail, after the report is out, if any fit failed."""

from brdfatlas.pipeline.logs import logged
from brdfatlas.pipeline.records import check_failures_job

with logged(snakemake.log[0]):
    check_failures_job(snakemake.input.reports, snakemake.output[0])
