"""Style and scripts of the report, and the page that compares."""

from brdfatlas.pipeline.logs import logged
from brdfatlas.reports.site import write_assets, write_compare

with logged(snakemake.log[0]):
    write_assets(snakemake.params.folder)
    write_compare(snakemake.output.compare, **snakemake.params.links)
