"""Tables over all materials."""

from pathlib import Path

from brdfatlas.pipeline.logs import logged
from brdfatlas.tables import write_tables

with logged(snakemake.log[0]):
    i = snakemake.input
    folder = Path(snakemake.output[0]).parent
    write_tables(i.errors, i.brdf, i.descriptions, snakemake.params.models, folder)
