"""Measure every render and fit of one material against its reference."""

from pathlib import Path

from brdfatlas.measures.errors import errors_job
from brdfatlas.pipeline.logs import logged

with logged(snakemake.log[0], snakemake.params.planned):
    errors_job(
        material=snakemake.wildcards.material,
        binary=snakemake.input.binary,
        models=snakemake.params.models,
        tones=snakemake.params.tones,
        renders=Path(snakemake.input.renders[0]).parents[1],
        fits=Path(snakemake.input.fits[0]).parent,
        images_path=snakemake.output.images,
        brdf_path=snakemake.output.brdf,
        pairs_path=snakemake.output.get("pairs"),
    )
