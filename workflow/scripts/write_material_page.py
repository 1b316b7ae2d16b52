"""The page of one material, its tables and its thumbnail."""

from brdfatlas.models import use_entries
from brdfatlas.pipeline.logs import logged
from brdfatlas.reports.data import scene_facts
from brdfatlas.reports.site import write_material_page

with logged(snakemake.log[0]):
    i, p = snakemake.input, snakemake.params
    use_entries(p.entries)
    write_material_page(
        snakemake.output.page,
        material_file=i.facts,
        fit_files=i.fits,
        errors_file=i.errors,
        brdf_errors_file=i.brdf,
        listing=i.files,
        pictures=p.pictures,
        data=p.data,
        materials=p.materials,
        models=p.models,
        scenes=scene_facts(p.scenes),
        published=p.published,
        animation=i.animation[-1] if i.animation else None,
        **p.links,
    )
