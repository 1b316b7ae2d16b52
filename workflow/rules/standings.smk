# tables of the run --> the page of standings: wins and ties, classes of materials, published figures beside ours.

STANDINGS = "brdfatlas.reports.standings_page"
STANDINGS_TABLES = ["summary", "summary_brdf", "wins", "published"]


rule write_standings:
    input:
        tables=expand("results/tables/{table}.tsv", table=STANDINGS_TABLES),
        summary="reports/assets/summary.svg",
        run=[path for files in RUN_FILES.values() for path in [files["facts"], files["errors"], files["brdf"]]],
        statistics=f"{PUBLISHED}/fitting_statistics.csv",
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
        files=RUN_FILES,
        provenance=provenance(STANDINGS, files=TEMPLATES),
        models=MODELS,
        entries=ENTRIES,
        links=LINKS,
    message:
        "page of standings"
    script:
        "../scripts/write_standings.py"


localrules:
    record_reports,


# What a run made in reports/, by name and content. What an earlier run made there of a material or model that is no
# longer in the run goes, unless somebody changed it; files of the user's are not in the list.
rule record_reports:
    input:
        REPORT,
        made_by(rules.write_standings),
        animation_files,
        convergence_files,
    output:
        update("results/reports.tsv"),
    log:
        "results/logs/record_reports.log",
    benchmark:
        "results/benchmarks/record_reports.tsv"
    resources:
        mem_mb=300,
        runtime=5,
    params:
        provenance=provenance("brdfatlas.pipeline.leftovers"),
        listings=LISTINGS,
    message:
        "recording what is in reports"
    script:
        "../scripts/record_reports.py"
