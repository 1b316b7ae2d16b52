"""Read every file that the scenes name, before anything is rendered."""

from brdfatlas.pipeline.logs import logged
from brdfatlas.rendering.jobs import check_scenes_job

with logged(snakemake.log[0]):
    p = snakemake.params
    check_scenes_job(p.scenes, p.scenes_file, p.variant, snakemake.output[0])
