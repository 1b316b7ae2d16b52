"""Pictures of one material from its renders."""

from pathlib import Path

from brdfatlas.figures.pictures import pictures_job
from brdfatlas.pipeline.logs import logged

with logged(snakemake.log[0]):
    p, listing = snakemake.params, snakemake.output.listing
    renders, folder = Path(snakemake.input.renders[0]).parents[1], Path(snakemake.output.references[0]).parents[3]
    pictures_job(p.models, p.tones, renders, folder, listing, hdr=p.hdr)
