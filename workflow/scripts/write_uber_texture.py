"""The factors of one model for all materials in one texture."""

from brdfatlas.export.uber_texture import uber_texture_job
from brdfatlas.pipeline.logs import logged

with logged(snakemake.log[0]):
    uber_texture_job(snakemake.wildcards.model, snakemake.input.fits, snakemake.output[0])
