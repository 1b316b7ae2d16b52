# files of measured reflectance in; stand-ins where there are none; a description of each material and of the run.

from brdfatlas.pipeline.records import revision, versions


# A node of a cluster may have no git: the revision is asked for where the run is started.
localrules:
    record_checks,
    record_run,


rule make_standin:
    input:
        published=expand(f"{PUBLISHED}/bilgili2011/{{table}}.csv", table=PUBLISHED_LOBES),
    output:
        "results/standins/{material}.binary",
    log:
        "results/logs/make_standin/{material}.log",
    benchmark:
        "results/benchmarks/make_standin/{material}.tsv"
    priority: first_material_first
    resources:
        mem_mb=1000,
        runtime=10,
    params:
        provenance=provenance("brdfatlas.pipeline.standins", libraries=FITTING),
    message:
        "stand-in for {wildcards.material} from published fits"
    script:
        "../scripts/make_standin.py"


rule read_material:
    input:
        lambda wildcards: SOURCES[wildcards.material],
    output:
        "results/measured/{material}.measured",
    log:
        "results/logs/read_material/{material}.log",
    benchmark:
        "results/benchmarks/read_material/{material}.tsv"
    priority: first_material_first
    resources:
        mem_mb=1500,
        runtime=10,
    params:
        planned=planned,
        provenance=provenance("brdfatlas.formats.reader", libraries=("numpy", "scipy", "numba", "colour-science")),
    message:
        "reading {input}"
    script:
        "../scripts/read_material.py"


rule describe_material:
    input:
        binary=binary_of,
    output:
        "results/materials/{material}.json",
    log:
        "results/logs/describe_material/{material}.log",
    benchmark:
        "results/benchmarks/describe_material/{material}.tsv"
    priority: first_material_first
    resources:
        mem_mb=1000,
        runtime=10,
    params:
        planned=planned,
        provenance=provenance("brdfatlas.pipeline.records", libraries=("numpy", "scipy")),
        standin=lambda wildcards: wildcards.material in STANDINS,
    message:
        "describing {wildcards.material}"
    script:
        "../scripts/describe_material.py"


rule record_checks:
    output:
        "results/checks.json",
    log:
        "results/logs/record_checks.log",
    benchmark:
        "results/benchmarks/record_checks.tsv"
    priority: 1000
    resources:
        mem_mb=200,
        runtime=5,
    params:
        checks=CHECKS,
    message:
        "recording which files can be used"
    script:
        "../scripts/record_checks.py"


rule record_run:
    input:
        checks="results/checks.json",
        descriptions=expand("results/materials/{material}.json", material=MATERIALS),
    output:
        "results/run.json",
    log:
        "results/logs/record_run.log",
    benchmark:
        "results/benchmarks/record_run.tsv"
    resources:
        mem_mb=500,
        runtime=5,
    params:
        provenance=provenance("brdfatlas.pipeline.records", libraries=("numpy", "scipy")),
        config=config,
        models={name: ALL_ENTRIES[name].plain for name in MODELS},
        materials=BINARIES,
        left_out=[vars(item) for item in LEFT_OUT],
        revision=lambda wildcards: revision(Path.cwd()),
        versions=versions(),
    message:
        "recording configuration, versions and inputs"
    script:
        "../scripts/record_run.py"
