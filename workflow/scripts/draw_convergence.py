"""The animation of a fit's eight starts."""

from brdfatlas.models import use_entries
from brdfatlas.pipeline.logs import logged
from brdfatlas.reports.animation import convergence_job

with logged(snakemake.log[0], snakemake.params.planned):
    entries = snakemake.params.entry
    use_entries(entries)
    convergence_job(snakemake.input.binary, entries[0]["name"], snakemake.output[0])
