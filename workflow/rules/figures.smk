# renders of a material --> pictures for its pages; the scales of the maps.


rule draw_pictures:
    input:
        renders=RENDERS,
    output:
        # Hundreds of pictures a material would burden the DAG, and a failed fit has none: a list stands for them.
        listing="results/pictures/{material}.json",
    log:
        "results/logs/draw_pictures/{material}.log",
    benchmark:
        "results/benchmarks/draw_pictures/{material}.tsv"
    priority: first_material_first
    resources:
        mem_mb=growing(700 + 6 * BATCHES_MB),
        runtime=10,
    params:
        provenance=provenance("brdfatlas.figures.pictures", libraries=DRAWING),
        models=MODELS,
        tones=TONES,
        folder="reports/materials/{material}",
    message:
        "pictures of {wildcards.material}"
    script:
        "../scripts/draw_pictures.py"


rule draw_bars:
    output:
        expand("reports/assets/bar-{kind}.svg", kind=["de00", "flip", "diff"]),
    log:
        "results/logs/draw_bars.log",
    benchmark:
        "results/benchmarks/draw_bars.tsv"
    # The first page waits for it.
    priority: 1000
    resources:
        mem_mb=400,
        runtime=5,
    params:
        provenance=provenance("brdfatlas.figures.pictures", libraries=DRAWING),
    message:
        "colour bars of the error maps"
    script:
        "../scripts/draw_bars.py"


rule draw_figures:
    input:
        binary=binary_of,
        fits=expand("results/fits/{{material}}/{model}.npz", model=MODELS),
        made=MADE,
    output:
        # Which functions there are depends on the models: a list stands for them.
        listing="results/figures/{material}.json",
        lobes=report(
            "reports/materials/{material}/lobes.svg",
            caption="../captions/lobes.rst",
            category="Materials",
            subcategory="{material}",
            labels={"what": "lobes of every model"},
        ),
    log:
        "results/logs/draw_figures/{material}.log",
    benchmark:
        "results/benchmarks/draw_figures/{material}.tsv"
    priority: first_material_first
    resources:
        mem_mb=1200,
        runtime=10,
    params:
        planned=planned,
        provenance=provenance("brdfatlas.figures.jobs", libraries=DRAWING),
        models=MODELS,
        entries=ENTRIES,
        folder="reports/materials/{material}",
    message:
        "lobes and functions of {wildcards.material}"
    script:
        "../scripts/draw_figures.py"


rule draw_summary:
    input:
        errors=expand("results/errors/{material}/images.tsv", material=MATERIALS),
        descriptions=expand("results/materials/{material}.json", material=MATERIALS),
    output:
        report(
            "reports/assets/summary.svg",
            caption="../captions/summary.rst",
            category="Results",
            labels={"what": "sorted errors of every model"},
        ),
    log:
        "results/logs/draw_summary.log",
    benchmark:
        "results/benchmarks/draw_summary.tsv"
    resources:
        mem_mb=600,
        runtime=5,
    params:
        provenance=provenance("brdfatlas.figures.summary", libraries=DRAWING),
        models=MODELS,
        entries=ENTRIES,
    message:
        "sorted errors of all models"
    script:
        "../scripts/draw_summary.py"
