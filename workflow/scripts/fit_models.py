"""Fit the models of one paper to one material."""

from brdfatlas.pipeline.jobs import fit_job
from brdfatlas.pipeline.logs import logged

with logged(snakemake.log[0], snakemake.params.planned):
    p, out = snakemake.params, snakemake.output
    names = [entry["name"] for entry in p.entries]
    fit_job(
        entries=p.entries,
        seed=p.seed,
        binary=snakemake.input.binary,
        standin=p.standin,
        outputs=dict(zip(names, zip(out.fits, out.reports, strict=True), strict=True)),
        provenance=p.provenance,
        made=out.made,
    )
