"""The interactive viewer."""

from brdfatlas.models import use_entries
from brdfatlas.pipeline.logs import logged
from brdfatlas.reports.data import scene_facts
from brdfatlas.reports.viewer import write_viewer

with logged(snakemake.log[0]):
    p = snakemake.params
    use_entries(p.entries)
    write_viewer(
        snakemake.output.page,
        data=p.data,
        fits=p.fits,
        materials=p.materials,
        textures=p.textures,
        scenes=list(zip(scene_facts(p.scenes), snakemake.input.scenes, strict=True)),
        **p.links,
    )
