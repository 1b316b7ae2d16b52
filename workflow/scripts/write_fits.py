"""The fits of a material and their exports below reports/."""

from brdfatlas.pipeline.logs import logged
from brdfatlas.reports.fit_files import fit_files_job

with logged(snakemake.log[0]):
    fit_files_job(snakemake.input.fits, snakemake.params.folder, snakemake.output.listing)
