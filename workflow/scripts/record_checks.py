"""Write the verdicts on the measured files, so that the next run reads none of them again."""

from brdfatlas.files import write_json
from brdfatlas.pipeline.logs import logged

with logged(snakemake.log[0]):
    write_json(snakemake.output[0], snakemake.params.checks)
