"""Fetch files of others that are not there yet, assets of scenes or published fits; what it says goes to the log and to
the terminal."""

from brdfatlas.pipeline.fetch import fetch_assets
from brdfatlas.pipeline.logs import logged

with logged(snakemake.log[0]) as say:
    fetch_assets(snakemake.params.assets, snakemake.params.folder, say)
