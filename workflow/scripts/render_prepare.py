"""Prepare one scene for all materials."""

from brdfatlas.pipeline.logs import logged
from brdfatlas.rendering.jobs import prepare_scene_job

with logged(snakemake.log[0], snakemake.params.planned):
    p, name = snakemake.params, snakemake.wildcards.scene
    prepare_scene_job(name, p.definition, p.size, p.variant, p.scenes_file, snakemake.output[0], snakemake.threads)
