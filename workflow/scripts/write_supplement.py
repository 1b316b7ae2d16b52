"""The supplement: overview, contents and the pages of every material in one PDF."""

from brdfatlas.models import use_entries
from brdfatlas.pipeline.logs import logged
from brdfatlas.reports.data import read_run, scene_facts
from brdfatlas.reports.pdf import write_supplement

with logged(snakemake.log[0]):
    p = snakemake.params
    use_entries(p.entries)
    write_supplement(
        snakemake.output[0],
        run_file=snakemake.input.record,
        materials=read_run(p.files),
        parts=snakemake.input.parts,
        models=p.models,
        scenes=scene_facts(p.scenes),
    )
