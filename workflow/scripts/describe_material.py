"""Describe one material."""

from brdfatlas.pipeline.logs import logged
from brdfatlas.pipeline.records import describe_material_job

with logged(snakemake.log[0], snakemake.params.planned):
    describe_material_job(snakemake.input.binary, snakemake.params.standin, snakemake.output[0])
