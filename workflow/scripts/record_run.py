"""Write the manifest of the run."""

from brdfatlas.files import write_json
from brdfatlas.pipeline.logs import logged
from brdfatlas.pipeline.records import manifest

with logged(snakemake.log[0]):
    p = snakemake.params
    descriptions = snakemake.input.descriptions
    record = manifest(p.config, p.models, p.materials, p.left_out, descriptions, p.revision, p.versions)
    write_json(snakemake.output[0], record)
