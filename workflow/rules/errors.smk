# renders and fits of a material --> its errors (tsv); all materials --> tables.
import re

TONES = {name: (ALL_SCENES[name]["exposure"], ALL_SCENES[name]["gamma"]) for name in SCENES}
# The reference stands for its scene: all pictures of a scene come from one job. So do a fit and its report.
RENDERS = expand("results/renders/{{material}}/reference/{scene}.{kind}", scene=SCENES, kind=("exr", "made"))
TABLES = ["errors", "brdf", "summary", "summary_brdf", "wins", "published"]
STANDINGS_TITLES = {
    "summary": "means by class of material and scene",
    "wins": "wins and ties between models",
    "published": "published means beside ours",
}


rule measure_errors:
    input:
        binary=binary_of,
        renders=RENDERS,
        fits=expand("results/fits/{{material}}/{model}.npz", model=MODELS),
        made=MADE,
    output:
        images=report(
            "results/errors/{material}/images.tsv",
            caption="../captions/errors.rst",
            category="Materials",
            subcategory="{material}",
            labels={"what": "image errors of every model"},
        ),
        brdf="results/errors/{material}/brdf.tsv",
        pairs="results/errors/{material}/pairs.tsv",
    log:
        "results/logs/measure_errors/{material}.log",
    benchmark:
        "results/benchmarks/measure_errors/{material}.tsv"
    # The names themselves: "x.brdf" must not be read as a material.
    wildcard_constraints:
        material="|".join(map(re.escape, MATERIALS)),
    priority: first_material_first
    resources:
        mem_mb=growing(1000 + 6 * BATCHES_MB),
        runtime=10,
    params:
        planned=planned,
        provenance=provenance("brdfatlas.measures.errors", libraries=MEASURING),
        models=MODELS,
        tones=TONES,
    message:
        "measuring the errors of {wildcards.material}"
    script:
        "../scripts/measure_errors.py"


rule tabulate_errors:
    input:
        errors=expand("results/errors/{material}/images.tsv", material=MATERIALS),
        brdf=expand("results/errors/{material}/brdf.tsv", material=MATERIALS),
        pairs=expand("results/errors/{material}/pairs.tsv", material=MATERIALS),
        descriptions=expand("results/materials/{material}.json", material=MATERIALS),
        published=[f"{PUBLISHED}/means.csv", f"{PUBLISHED}/bilgili2011/psnr.csv"],
    output:
        [f"results/tables/{table}.tsv" for table in TABLES if table not in STANDINGS_TITLES],
        [
            report(
                f"results/tables/{table}.tsv",
                caption="../captions/standings.rst",
                category="Results",
                labels={"what": title},
            )
            for table, title in STANDINGS_TITLES.items()
        ],
    log:
        "results/logs/tabulate_errors.log",
    benchmark:
        "results/benchmarks/tabulate_errors.tsv"
    resources:
        mem_mb=600,
        runtime=5,
    params:
        provenance=provenance("brdfatlas.measures.tables", libraries=MEASURING),
        models=MODELS,
    message:
        "means, wins and ties over all materials"
    script:
        "../scripts/tabulate_errors.py"
