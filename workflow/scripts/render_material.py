"""Render one material with its fits in one scene."""

from brdfatlas.pipeline.logs import logged
from brdfatlas.rendering.jobs import render_job

with logged(snakemake.log[0], snakemake.params.planned):
    p, given = snakemake.params, snakemake.input
    render_job(
        material=snakemake.wildcards.material,
        binary=given.binary,
        scene=given.scene,
        fits={model: (f"{p.fits}/{model}.npz", f"{p.fits}/{model}.json") for model in p.models},
        outputs=dict(zip(p.pictures, snakemake.output, strict=True)),
        settings=p.settings,
        provenance=p.provenance,
        standin=p.standin,
        threads=snakemake.threads,
    )
