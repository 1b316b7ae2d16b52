"""The fits of a material and their exports below reports/."""

from brdfatlas.pipeline.logs import logged
from brdfatlas.reports.fit_files import fit_files_job

with logged(snakemake.log[0]):
    p = snakemake.params
    fit_files_job([f"{p.fits}/{model}.npz" for model in p.models], p.folder, snakemake.output.listing)
