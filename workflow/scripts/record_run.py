"""Write the manifest of the run."""

from brdfatlas.files import write_json
from brdfatlas.pipeline.jobs import manifest
from brdfatlas.pipeline.logs import logged

with logged(snakemake.log[0]):
    p = snakemake.params
    record = manifest(p.config, p.models, p.materials, p.left_out, snakemake.input.descriptions)
    write_json(snakemake.output[0], record)
