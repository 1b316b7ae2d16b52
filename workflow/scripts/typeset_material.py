"""The PDF pages of one material."""

from brdfatlas.models import use_entries
from brdfatlas.pipeline.logs import logged
from brdfatlas.reports.data import scene_facts
from brdfatlas.reports.pdf import write_material_pdf

with logged(snakemake.log[0]):
    i, p = snakemake.input, snakemake.params
    use_entries(p.entries)
    write_material_pdf(
        snakemake.output[0],
        material_file=i.facts,
        fit_files=i.fits,
        errors_file=i.errors,
        brdf_errors_file=i.brdf,
        pictures=p.pictures,
        assets=p.assets,
        models=p.models,
        scenes=scene_facts(p.scenes),
        published=p.published,
    )
