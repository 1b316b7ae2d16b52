# (material, paper) --> for each model of the paper a fit (npz) and its report (json), by a rule a paper: fit_dupuy2015,
# fit_bagher2016 ... A model of a user's own has its own rule. A failed fit is reported, not raised; one that is still
# right is kept, so a new model costs itself only. The last file that a job writes, with the checksums of all
# fits, stands for them: where a job fails, Snakemake (9.27) puts the old files of update() back as if they were made of
# today's settings.
MADE = expand("results/fits/{{material}}/{family}.made", family=FAMILIES)

for family, names in FAMILIES.items():

    rule:
        name:
            f"fit_{family}"
        input:
            binary=binary_of,
            parameters=parameters_of(names),
        output:
            fits=[update(f"results/fits/{{material}}/{name}.npz") for name in names],
            reports=[update(f"results/fits/{{material}}/{name}.json") for name in names],
            made=f"results/fits/{{material}}/{family}.made",
        log:
            f"results/logs/fit_{family}/{{material}}.log",
        benchmark:
            f"results/benchmarks/fit_{family}/{{material}}.tsv"
        priority: first_material_first
        resources:
            mem_mb=growing(1500),
            runtime=growing(30),
        params:
            planned=lambda wildcards, names=names: planned(wildcards) | stamps(parameters_of(names)),
            provenance=lambda wildcards, names=names: {name: provenance_of_fit(name) for name in names},
            entries=[ALL_ENTRIES[name].plain for name in names],
            seed=config["seed"],
            standin=lambda wildcards: wildcards.material in STANDINS,
        message:
            f"fitting {', '.join(names)} to {{wildcards.material}}"
        script:
            "../scripts/fit_models.py"


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
