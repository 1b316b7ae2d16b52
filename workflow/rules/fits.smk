# material x model --> a fit (npz) and its report (json). A failed fit is reported, not raised.

# Their folder, for those who read them.
FITS = "results/fits/{material}"


localrules:
    list_fits,


rule fit_model:
    input:
        unpack(fitted),
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
        fitting=fitting,
    message:
        "fitting {wildcards.model} to {wildcards.material}"
    script:
        "../scripts/fit_model.py"


# Stands for the fits of a material and their reports where all of them are needed: tens of thousands of inputs less to
# plan. Checksums, not an empty mark: Snakemake passes over a new file whose content is the old one.
rule list_fits:
    input:
        expand("results/fits/{{material}}/{model}.{kind}", model=MODELS, kind=["npz", "json"]),
    output:
        "results/fitted/{material}.txt",
    log:
        "results/logs/list_fits/{material}.log",
    benchmark:
        "results/benchmarks/list_fits/{material}.tsv"
    priority: first_material_first
    resources:
        mem_mb=100,
        runtime=5,
    message:
        "all fits to {wildcards.material} are there"
    shell:
        "cksum {input} > {output} 2> {log}"


rule check_failures:
    input:
        fits=made_by(rules.list_fits, material=MATERIALS),
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
        reports=expand("results/fits/{material}/{model}.json", material=MATERIALS, model=MODELS),
    message:
        "checking every fit for failure"
    script:
        "../scripts/check_failures.py"
