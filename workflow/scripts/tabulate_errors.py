"""Tables over all materials."""

from pathlib import Path

from brdfatlas.measures.tables import write_tables
from brdfatlas.pipeline.logs import logged

with logged(snakemake.log[0]):
    i = snakemake.input
    folder = Path(snakemake.output[0]).parent
    write_tables(i.errors, i.brdf, i.descriptions, snakemake.params.models, folder, i.pairs)
