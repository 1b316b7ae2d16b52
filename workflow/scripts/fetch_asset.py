"""Fetch one asset of a scene; what it says goes to the log and to the terminal."""

from brdfatlas.pipeline.download import fetch_asset_job
from brdfatlas.pipeline.logs import logged

with logged(snakemake.log[0]) as say:
    fetch_asset_job(snakemake.params.source, snakemake.output[0], snakemake.params.record, say)
