"""Write one built-in stand-in in MERL format."""

from brdfatlas.pipeline.logs import logged
from brdfatlas.pipeline.standins import write_standin

with logged(snakemake.log[0]):
    write_standin(snakemake.wildcards.material, snakemake.output[0])
