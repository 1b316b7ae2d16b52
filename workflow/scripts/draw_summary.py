"""Sorted errors of all models over all materials."""

from brdfatlas.figures.summary import summary_job
from brdfatlas.models import use_entries
from brdfatlas.pipeline.logs import logged

with logged(snakemake.log[0]):
    i, p = snakemake.input, snakemake.params
    use_entries(p.entries)
    summary_job(i.errors, i.descriptions, p.models, snakemake.output[0])
