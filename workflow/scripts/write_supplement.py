"""The supplement: overview, contents and the pages of every material in one PDF."""

from brdfatlas.pipeline.logs import logged
from brdfatlas.reports.data import read_run, register_models, scene_facts
from brdfatlas.reports.pdf import write_supplement

with logged(snakemake.log[0]):
    p = snakemake.params
    register_models(p.model_files)
    write_supplement(
        snakemake.output[0],
        run_file=snakemake.input.record,
        materials=read_run(p.files),
        parts=snakemake.input.parts,
        models=p.models,
        scenes=scene_facts(p.scenes),
    )
