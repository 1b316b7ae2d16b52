# (material, model) --> one EXR a scene. The model may be "reference", or "reference_again": the same with other random
# numbers, which measures the noise. An EXR that is still right is kept, so a new scene renders only itself.


rule check_scenes:
    input:
        files=lambda wildcards: scene_files(SCENES),
    output:
        "results/scenes/checked.txt",
    log:
        "results/logs/check_scenes.log",
    benchmark:
        "results/benchmarks/check_scenes.tsv"
    priority: 1000
    resources:
        mem_mb=1500,
        runtime=10,
    params:
        provenance=provenance("brdfatlas.rendering.scenes", libraries=RENDERING),
        scenes={name: ALL_SCENES[name] for name in SCENES},
        scenes_file=config["scenes_file"],
        variant=config["render"]["variant"],
    message:
        "checking the files of every scene"
    script:
        "../scripts/render_check.py"


rule prepare_scene:
    input:
        checked="results/scenes/checked.txt",
        files=lambda wildcards: scene_files([wildcards.scene]),
    output:
        "results/scenes/{scene}.npz",
    log:
        "results/logs/prepare_scene/{scene}.log",
    benchmark:
        "results/benchmarks/prepare_scene/{scene}.tsv"
    priority: 1000
    resources:
        mem_mb=1500,
        runtime=10,
    params:
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
        unpack(fit_of),
        binary=binary_of,
        scenes=expand(rules.prepare_scene.output, scene=SCENES),
    output:
        [update(f"results/renders/{{material}}/{{model}}/{scene}.exr") for scene in SCENES],
    log:
        "results/logs/render_material/{material}/{model}.log",
    benchmark:
        "results/benchmarks/render_material/{material}/{model}.tsv"
    priority: first_material_first
    # Short jobs are mostly imports, which use one core: two at a time. Long ones share the cores.
    threads: 1 if config["render"]["samples"] < 256 else 2
    resources:
        mem_mb=1500,
        runtime=30,
    params:
        provenance=provenance("brdfatlas.rendering.jobs", libraries=RENDERING),
        scenes=SCENES,
        settings={key: config["render"][key] for key in ("samples", "batches", "seed", "variant")},
        scene_samples={name: ALL_SCENES[name]["samples"] for name in SCENES},
        standin=lambda wildcards: wildcards.material in STANDINS,
    message:
        "rendering {wildcards.material} with {wildcards.model}"
    script:
        "../scripts/render_material.py"
