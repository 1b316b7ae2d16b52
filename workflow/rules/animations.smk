# fits, errors --> animations of a material, only when asked for: `snakemake animations`. The pages link those that are
# there the next time the report is made.

# The entry whose eight starts are shown, if one is in the run.
EIGHT_STARTS = [name for name in MODELS if ALL_ENTRIES[name].model == "independent_g"][:1]

TURNING_MEGAPIXELS = config["animation"]["size"] ** 2 / 1e6


localrules:
    animations,


rule animations:
    input:
        lambda wildcards: made_by(rules.draw_animation, material=MATERIALS),
        lambda wildcards: made_by(rules.draw_convergence, material=MATERIALS if EIGHT_STARTS else []),
    message:
        "animations are made; `snakemake` links them from the pages"


rule draw_animation:
    input:
        binary=binary_of,
        facts="results/materials/{material}.json",
        fits=expand("results/fits/{{material}}/{model}.npz", model=MODELS),
        reports=expand("results/fits/{{material}}/{model}.json", model=MODELS),
        errors="results/errors/{material}/images.tsv",
        brdf="results/errors/{material}/brdf.tsv",
        scene=lambda wildcards: scene_files([config["animation"]["scene"]]),
    output:
        animation="reports/materials/{material}/animation.webp",
        listing="results/animations/{material}.json",
    log:
        "results/logs/draw_animation/{material}.log",
    benchmark:
        "results/benchmarks/draw_animation/{material}.tsv"
    priority: first_material_first
    threads: 2
    resources:
        mem_mb=growing(1100 + 600 * TURNING_MEGAPIXELS + 16 * TURNING_MEGAPIXELS * config["animation"]["frames"]),
        runtime=growing(
            30 + config["animation"]["frames"] * TURNING_MEGAPIXELS * (0.3 + config["animation"]["samples"] / 60)
        ),
    params:
        planned=lambda wildcards: planned(wildcards) | stamps(scene_files([config["animation"]["scene"]])),
        provenance=provenance("brdfatlas.reports.animation", libraries=(*RENDERING, "pillow")),
        models=MODELS,
        entries=ENTRIES,
        fits=lambda wildcards, input: str(Path(input.fits[0]).parent),
        scene=[config["animation"]["scene"], ALL_SCENES[config["animation"]["scene"]]],
        scenes_file=config["scenes_file"],
        settings={key: config["animation"][key] for key in ("frames", "size", "samples", "model")}
        | {key: config["render"][key] for key in ("seed", "variant")}
        | {"batches": 4},
    message:
        "animating {wildcards.material}"
    script:
        "../scripts/draw_animation.py"


rule draw_convergence:
    input:
        binary=binary_of,
    output:
        "reports/materials/{material}/convergence.webp",
    log:
        "results/logs/draw_convergence/{material}.log",
    benchmark:
        "results/benchmarks/draw_convergence/{material}.tsv"
    priority: first_material_first
    resources:
        mem_mb=1200,
        runtime=10,
    params:
        planned=planned,
        provenance=provenance("brdfatlas.reports.animation", libraries=(*FITTING, "matplotlib", "pillow")),
        entry=[ALL_ENTRIES[name].plain for name in EIGHT_STARTS],
    message:
        "eight starts of independent factors on {wildcards.material}"
    script:
        "../scripts/draw_convergence.py"
