# (material, scene) --> one EXR for the reference, the reference with other random numbers, which measures the noise, and
# every fit, all along the same paths. An EXR that is still right is kept, so a new model costs its own share only; the
# last file says that the job came to its end, as in fits.smk.


# First of all: a fault in a scene's files shows before any long work.
rule prepare_scene:
    input:
        files=lambda wildcards: scene_files([wildcards.scene]),
    output:
        "results/scenes/{scene}.npz",
    log:
        "results/logs/prepare_scene/{scene}.log",
    benchmark:
        "results/benchmarks/prepare_scene/{scene}.tsv"
    priority: 1000
    resources:
        mem_mb=growing(1000 + 500 * MEGAPIXELS),
        runtime=10,
    params:
        planned=lambda wildcards: stamps(scene_files([wildcards.scene])),
        provenance=provenance("brdfatlas.rendering.scenes", libraries=RENDERING),
        definition=lambda wildcards: ALL_SCENES[wildcards.scene],
        scenes_file=config["scenes_file"],
        size=config["render"]["size"],
        variant=config["render"]["variant"],
    message:
        "preparing scene {wildcards.scene}"
    script:
        "../scripts/render_prepare.py"


rule render_material:
    input:
        fits=expand("results/fits/{{material}}/{model}.npz", model=MODELS),
        made=MADE,
        binary=binary_of,
        scene=rules.prepare_scene.output[0],
    output:
        pictures=[update(f"results/renders/{{material}}/{model}/{{scene}}.exr") for model in [*REFERENCES, *MODELS]],
        made="results/renders/{material}/reference/{scene}.made",
    log:
        "results/logs/render_material/{material}/{scene}.log",
    benchmark:
        "results/benchmarks/render_material/{material}/{scene}.tsv"
    priority: first_material_first
    resources:
        mem_mb=growing(2700 + 25 * len(MODELS) + 6 * BATCHES_MB),
        runtime=30,
    params:
        planned=planned,
        provenance=provenance("brdfatlas.rendering.jobs", libraries=RENDERING),
        pictures=[*REFERENCES, *MODELS],
        models=MODELS,
        settings=render_settings,
        standin=lambda wildcards: wildcards.material in STANDINS,
    message:
        "rendering {wildcards.material} in {wildcards.scene}"
    script:
        "../scripts/render_material.py"
