"""List what the run made in reports/; remove what an earlier run made and this one did not."""

from brdfatlas.pipeline.leftovers import record_reports_job
from brdfatlas.pipeline.logs import logged

with logged(snakemake.log[0]) as say:
    record_reports_job(snakemake.input, snakemake.params.listings, snakemake.output[0], say)
