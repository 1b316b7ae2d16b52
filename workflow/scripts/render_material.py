"""Render one material with one model in every scene."""

from brdfatlas.pipeline.logs import logged
from brdfatlas.rendering.jobs import render_job

with logged(snakemake.log[0]):
    p = snakemake.params
    render_job(
        material=snakemake.wildcards.material,
        model=snakemake.wildcards.model,
        binary=snakemake.input.binary,
        fit=snakemake.input.get("fit"),
        report=snakemake.input.get("report"),
        scenes=dict(zip(p.scenes, snakemake.input.scenes, strict=True)),
        outputs=dict(zip(p.scenes, snakemake.output, strict=True)),
        settings=dict(p.settings) | {"scene_samples": p.scene_samples},
        provenance=p.provenance,
        standin=p.standin,
        threads=snakemake.threads,
    )
