"""The page of standings, from the tables of the run."""

from pathlib import Path

from brdfatlas.models import use_entries
from brdfatlas.pipeline.logs import logged
from brdfatlas.reports.standings_page import write_standings

with logged(snakemake.log[0]):
    p, output = snakemake.params, snakemake.output
    use_entries(p.entries)
    write_standings(
        output.page,
        tables=Path(snakemake.input.tables[0]).parent,
        data=Path(output.tables[0]).parent,
        figure=snakemake.input.summary,
        models=p.models,
        files=p.files,
        statistics=snakemake.input.statistics,
        **p.links,
    )
