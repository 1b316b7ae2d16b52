# Files of others, from their public homes, only when asked for: `snakemake merl`, `snakemake assets`.


# Where jobs run on other machines, these stay on this one: nodes of a cluster are often offline.
localrules:
    merl,
    assets,
    download_merl,
    fetch_asset,


rule merl:
    input:
        f"{config['merl_folder']}/merl_source.json",
    message:
        f"the MERL database is in {config['merl_folder']}"


rule assets:
    input:
        expand("data/assets/{asset}", asset=ASSETS),
    message:
        "the assets are in data/assets"


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


rule fetch_asset:
    output:
        "data/assets/{asset}",
    log:
        "results/logs/fetch_asset/{asset}.log",
    benchmark:
        "results/benchmarks/fetch_asset/{asset}.tsv"
    wildcard_constraints:
        asset="|".join(map(re.escape, ASSETS)) or "$^",
    resources:
        mem_mb=500,
        runtime=60,
    params:
        source=lambda wildcards: ASSETS[wildcards.asset],
        record="data/assets/checksums/{asset}.json",
    message:
        "fetching {wildcards.asset}: {params.source[terms]}"
    script:
        "../scripts/fetch_asset.py"
