"""The animation of one material."""

from brdfatlas.models import use_entries
from brdfatlas.pipeline.logs import logged
from brdfatlas.reports.animation import animation_job

with logged(snakemake.log[0], snakemake.params.planned):
    i, p = snakemake.input, snakemake.params
    use_entries(p.entries)
    animation_job(
        i.binary,
        {"facts": i.facts, "fits": i.reports, "errors": i.errors, "brdf": i.brdf},
        p.fits,
        p.models,
        tuple(p.scene),
        p.settings,
        snakemake.output.animation,
        snakemake.output.listing,
        source=p.scenes_file,
        threads=snakemake.threads,
    )
