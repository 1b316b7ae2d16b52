# tables of the run --> the page of standings: wins and ties, classes of materials, published figures beside ours.

STANDINGS = "brdfatlas.reports.standings_page"
STANDINGS_TABLES = ["summary", "summary_brdf", "wins", "published"]


rule write_standings:
    input:
        tables=expand("results/tables/{table}.tsv", table=STANDINGS_TABLES),
        summary="reports/assets/summary.svg",
        models=expand("reports/models/{model}.html", model=MODELS),
    output:
        page="reports/standings.html",
        tables=expand("reports/data/{table}.tsv", table=STANDINGS_TABLES),
    log:
        "results/logs/write_standings.log",
    benchmark:
        "results/benchmarks/write_standings.tsv"
    resources:
        mem_mb=400,
        runtime=5,
    params:
        provenance=provenance(STANDINGS, files=TEMPLATES),
        models=MODELS,
        entries=ENTRIES,
        links=LINKS,
    message:
        "page of standings"
    script:
        "../scripts/write_standings.py"
