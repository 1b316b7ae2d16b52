"""Sorted errors of all models over all materials."""

from brdfatlas.figures.jobs import summary_job
from brdfatlas.pipeline.logs import logged

with logged(snakemake.log[0]):
    i, p = snakemake.input, snakemake.params
    summary_job(i.errors, i.descriptions, p.models, p.model_files, snakemake.output[0])
