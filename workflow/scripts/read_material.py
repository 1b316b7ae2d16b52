"""Put a file of measured reflectance on the MERL grid."""

from brdfatlas.pipeline.logs import logged
from brdfatlas.pipeline.records import read_material_job

with logged(snakemake.log[0], snakemake.params.planned):
    read_material_job(snakemake.input[0], snakemake.output[0])
