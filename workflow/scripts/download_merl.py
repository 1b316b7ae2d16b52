"""Download, check and unpack the MERL database; what it says goes to the log and to the terminal."""

from brdfatlas.pipeline.fetch import fetch_merl, remote_of
from brdfatlas.pipeline.logs import logged

with logged(snakemake.log[0]) as say:
    fetch_merl(remote_of(snakemake.params.source), snakemake.params.folder, snakemake.output[0], say=say)
