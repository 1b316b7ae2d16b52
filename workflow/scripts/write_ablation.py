"""The page that compares fits under several objectives."""

from brdfatlas.pipeline.logs import logged
from brdfatlas.reports.ablation_page import write_ablation
from brdfatlas.reports.data import register_models, scene_facts

with logged(snakemake.log[0]):
    p = snakemake.params
    register_models(p.model_files)
    write_ablation(
        snakemake.output.page,
        facts=snakemake.input.facts,
        errors=snakemake.input.errors,
        brdf=snakemake.input.brdf,
        pictures=p.pictures,
        tables=snakemake.output.tables,
        variants=p.variants,
        scenes=scene_facts(p.scenes),
        **p.links,
    )
