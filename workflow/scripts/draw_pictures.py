"""Pictures of one material from its renders."""

from pathlib import Path

from brdfatlas.figures.pictures import pictures_job
from brdfatlas.pipeline.logs import logged

with logged(snakemake.log[0]):
    p, renders = snakemake.params, Path(snakemake.input.renders[0]).parents[1]
    pictures_job(p.models, p.tones, renders, p.folder, snakemake.output.listing)
