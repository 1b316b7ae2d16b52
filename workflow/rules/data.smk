# Files of others, from their public homes, only when asked for: `snakemake rgl`, `merl`,
# `assets`, `published_fits`.


# Where jobs run on other machines, these stay on this one: nodes of a cluster are often offline.
localrules:
    rgl,
    merl,
    assets,
    published_fits,
    download_merl,


# No output, as of assets below: files that are there stay.
rule rgl:
    log:
        "results/logs/rgl.log",
    resources:
        mem_mb=500,
        runtime=60,
    params:
        materials=RGL,
        folder=config["measured_folder"] or MEASURED_FOLDER,
    message:
        "fetching what is missing of the RGL database"
    script:
        "../scripts/fetch_rgl.py"


rule merl:
    input:
        f"{config['merl_folder']}/merl_source.json",
    message:
        f"the MERL database is in {config['merl_folder']}"


rule download_merl:
    output:
        f"{config['merl_folder']}/merl_source.json",
    log:
        "results/logs/download_merl.log",
    benchmark:
        "results/benchmarks/download_merl.tsv"
    resources:
        mem_mb=500,
        runtime=600,
    params:
        source=config["merl_source"],
        folder=lambda wildcards, output: str(Path(output[0]).parent),
    message:
        "downloading the MERL database"
    script:
        "../scripts/download_merl.py"


# No output: Snakemake removes outputs before it makes them, and what lies in data/assets may be the user's own.
rule assets:
    log:
        "results/logs/fetch_assets.log",
    resources:
        mem_mb=500,
        runtime=60,
    params:
        assets=ASSETS,
        folder="data/assets",
    message:
        "fetching what is missing in data/assets"
    script:
        "../scripts/fetch_assets.py"


use rule assets as published_fits with:
    log:
        "results/logs/fetch_published_fits.log",
    params:
        assets=PUBLISHED_FITS,
        folder="data/published_fits",
    message:
        "fetching the published fits that are missing"
