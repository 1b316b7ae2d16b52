# material x model x variant of the objective --> fits and renders by the rules of the run --> the page that compares them:
# Figures 7 and 15 of Bagher et al. 2016 for any materials. `snakemake ablation` makes it; no other target needs it.

ABLATION_RENDERS = expand(
    "results/renders/{{material}}/{model}/{scene}.exr", model=[*REFERENCES, *VARIANTS], scene=SCENES
)
ABLATION_FILES = {item["model"]: item["source"] for item in VARIANTS.values() if item["source"]}


localrules:
    ablation,


rule ablation:
    input:
        "reports/ablation.html",
    message:
        "the comparison of objectives is in {input}"


use rule measure_errors as measure_ablation with:
    input:
        binary=binary_of,
        renders=ABLATION_RENDERS,
        fits=expand("results/fits/{{material}}/{model}.npz", model=VARIANTS),
        reports=expand("results/fits/{{material}}/{model}.json", model=VARIANTS),
    output:
        images="results/ablation/{material}.tsv",
        brdf="results/ablation/{material}.brdf.tsv",
    log:
        "results/logs/measure_ablation/{material}.log",
    benchmark:
        "results/benchmarks/measure_ablation/{material}.tsv"
    params:
        provenance=provenance("brdfatlas.measures.errors", libraries=MEASURING),
        models=list(VARIANTS),
        model_files=ABLATION_FILES,
        tones=TONES,
    message:
        "measuring the objectives' errors on {wildcards.material}"


use rule draw_pictures as draw_ablation with:
    input:
        renders=ABLATION_RENDERS,
    output:
        listing="results/ablation/{material}.json",
    log:
        "results/logs/draw_ablation/{material}.log",
    benchmark:
        "results/benchmarks/draw_ablation/{material}.tsv"
    params:
        provenance=provenance("brdfatlas.figures.pictures", libraries=DRAWING),
        models=list(VARIANTS),
        tones=TONES,
        folder="reports/ablation/{material}",
        hdr=False,
    message:
        "pictures of the objectives on {wildcards.material}"


rule write_ablation:
    input:
        facts=expand("results/materials/{material}.json", material=ABLATED),
        errors=expand("results/ablation/{material}.tsv", material=ABLATED),
        brdf=expand("results/ablation/{material}.brdf.tsv", material=ABLATED),
        pictures=expand("results/ablation/{material}.json", material=ABLATED),
        assets=ancient(ASSET_FILES),
    output:
        page="reports/ablation.html",
        tables=["reports/data/ablation.tsv", "reports/data/ablation_brdf.tsv"],
    log:
        "results/logs/write_ablation.log",
    benchmark:
        "results/benchmarks/write_ablation.tsv"
    resources:
        mem_mb=400,
        runtime=5,
    params:
        provenance=provenance("brdfatlas.reports.ablation_page", files=TEMPLATES),
        pictures=lambda wildcards, output: str(Path(output.page).with_suffix("")),
        variants=VARIANTS,
        scenes=SHOWN_SCENES,
        model_files=ABLATION_FILES,
        links=LINKS,
    message:
        "page of the objectives"
    script:
        "../scripts/write_ablation.py"
