"""Fetch materials of the RGL database that are not there yet; what it says goes to the log and to the terminal."""

from brdfatlas.pipeline.fetch import fetch_rgl
from brdfatlas.pipeline.logs import logged

with logged(snakemake.log[0]) as say:
    fetch_rgl(snakemake.params.materials, snakemake.params.folder, say=say)
