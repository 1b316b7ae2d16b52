"""The index of the report and the tables of the whole run."""

from brdfatlas.models import use_entries
from brdfatlas.pipeline.logs import logged
from brdfatlas.reports.data import scene_facts
from brdfatlas.reports.site import read_run, write_index

with logged(snakemake.log[0]):
    p = snakemake.params
    use_entries(p.entries)
    write_index(
        snakemake.output.page,
        run_file=snakemake.input.record,
        materials=read_run(p.files),
        listings=snakemake.input.files,
        data=p.data,
        models=p.models,
        scenes=scene_facts(p.scenes),
        **p.links,
    )
