"""Render one material with its fits in one scene."""

from pathlib import Path

from brdfatlas.pipeline.logs import logged
from brdfatlas.rendering.jobs import render_job

with logged(snakemake.log[0], snakemake.params.planned):
    p, given = snakemake.params, snakemake.input
    reports = [str(Path(fit).with_suffix(".json")) for fit in given.fits]
    render_job(
        material=snakemake.wildcards.material,
        binary=given.binary,
        scene=given.scene,
        fits=dict(zip(p.models, zip(given.fits, reports, strict=True), strict=True)),
        outputs=dict(zip(p.pictures, snakemake.output.pictures, strict=True)),
        made=snakemake.output.made,
        settings=p.settings,
        provenance=p.provenance,
        standin=p.standin,
        threads=snakemake.threads,
    )
