# material x model --> a fit (npz) and its report (json). A failed fit is reported, not raised.


rule fit_model:
    input:
        binary=binary_of,
        parameters=parameters_of,
    output:
        fit="results/fits/{material}/{model}.npz",
        report="results/fits/{material}/{model}.json",
    log:
        "results/logs/fit_model/{material}/{model}.log",
    benchmark:
        "results/benchmarks/fit_model/{material}/{model}.tsv"
    priority: first_material_first
    resources:
        mem_mb=1000,
        runtime=20,
    params:
        planned=lambda wildcards: planned(wildcards) | stamps(filter(None, [parameters_of(wildcards)])),
        provenance=lambda wildcards: provenance(
            ALL_ENTRIES[wildcards.model].module, "brdfatlas.pipeline.jobs", libraries=FITTING
        ),
        entry=lambda wildcards: ALL_ENTRIES[wildcards.model].plain,
        seed=config["seed"],
        standin=lambda wildcards: wildcards.material in STANDINS,
    message:
        "fitting {wildcards.model} to {wildcards.material}"
    script:
        "../scripts/fit_model.py"


rule check_failures:
    input:
        reports=expand("results/fits/{material}/{model}.json", material=MATERIALS, model=MODELS),
        report="reports/index.html",
    output:
        "results/verdict.txt",
    log:
        "results/logs/check_failures.log",
    benchmark:
        "results/benchmarks/check_failures.tsv"
    resources:
        mem_mb=200,
        runtime=5,
    params:
        provenance=provenance("brdfatlas.pipeline.records"),
    message:
        "checking every fit for failure"
    script:
        "../scripts/check_failures.py"
