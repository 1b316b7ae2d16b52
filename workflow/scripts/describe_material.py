"""Describe one material."""

from brdfatlas.pipeline.jobs import describe_material_job
from brdfatlas.pipeline.logs import logged

with logged(snakemake.log[0]):
    describe_material_job(snakemake.input.binary, snakemake.params.standin, snakemake.output[0])
