"""The pages of all models."""

from brdfatlas.models import use_entries
from brdfatlas.pipeline.logs import logged
from brdfatlas.reports.data import scene_facts
from brdfatlas.reports.site import write_model_pages

with logged(snakemake.log[0]):
    p = snakemake.params
    use_entries(p.entries)
    write_model_pages(
        p.folder,
        files=p.files,
        pictures=p.pictures,
        data=p.data,
        models=p.models,
        scenes=scene_facts(p.scenes),
        **p.links,
    )
