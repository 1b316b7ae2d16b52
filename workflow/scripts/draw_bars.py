"""Colour bars of the error maps."""

from pathlib import Path

from brdfatlas.figures.pictures import write_bars
from brdfatlas.pipeline.logs import logged

with logged(snakemake.log[0]):
    write_bars(Path(snakemake.output[0]).parent)
