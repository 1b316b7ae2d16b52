"""Figures of one material from its fits."""

from pathlib import Path

from brdfatlas.figures.jobs import figures_job
from brdfatlas.models import use_entries
from brdfatlas.pipeline.logs import logged

with logged(snakemake.log[0], snakemake.params.planned):
    i, p = snakemake.input, snakemake.params
    use_entries(p.entries)
    figures_job(i.binary, p.models, Path(i.fits[0]).parent, p.folder, snakemake.output.listing)
