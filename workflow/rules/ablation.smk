# material x model x variant of the objective --> fits and renders by the rules of the run --> the page that compares them:
# Figures 7 and 15 of Bagher et al. 2016 for any materials. `snakemake ablation` makes it; no other target needs it.

ABLATION_RENDERS = expand(
    "results/renders/{{material}}/{model}/{scene}.exr", model=["reference", "reference_again", *VARIANTS], scene=SCENES
)
NOT_IN_RUN = [name for name in VARIANTS if name not in MODELS]
ABLATION_FILES = {item["model"]: item["source"] for item in VARIANTS.values() if item["source"]}


localrules:
    ablation,


rule ablation:
    input:
        "reports/ablation.html",
    message:
        "the comparison of objectives is in {input}"


if NOT_IN_RUN:

    use rule render_material as render_ablation with:
        input:
            fits=expand("results/fits/{{material}}/{model}.npz", model=NOT_IN_RUN),
            reports=expand("results/fits/{{material}}/{model}.json", model=NOT_IN_RUN),
            binary=binary_of,
            scene=rules.prepare_scene.output,
            source=sources("brdfatlas.rendering.jobs", "brdfatlas.rendering.integrator"),
        output:
            [update(f"results/renders/{{material}}/{model}/{{scene}}.exr") for model in NOT_IN_RUN],
        log:
            "results/logs/render_ablation/{material}/{scene}.log",
        benchmark:
            "results/benchmarks/render_ablation/{material}/{scene}.tsv"
        params:
            pictures=NOT_IN_RUN,
            models=NOT_IN_RUN,
            settings=render_settings,
            renderer={name: VERSIONS[name] for name in ("mitsuba", "drjit")},
            standin=lambda wildcards: wildcards.material in STANDINS,
        message:
            "rendering the objectives on {wildcards.material} in {wildcards.scene}"


use rule measure_errors as measure_ablation with:
    input:
        binary=binary_of,
        renders=ABLATION_RENDERS,
        fits=expand("results/fits/{{material}}/{model}.npz", model=VARIANTS),
        reports=expand("results/fits/{{material}}/{model}.json", model=VARIANTS),
        source=sources("brdfatlas.measures.errors"),
    output:
        images="results/ablation/{material}.tsv",
        brdf="results/ablation/{material}.brdf.tsv",
    log:
        "results/logs/measure_ablation/{material}.log",
    benchmark:
        "results/benchmarks/measure_ablation/{material}.tsv"
    params:
        models=list(VARIANTS),
        model_files=ABLATION_FILES,
        tones=TONES,
    message:
        "measuring the objectives' errors on {wildcards.material}"


use rule draw_pictures as draw_ablation with:
    input:
        renders=ABLATION_RENDERS,
        source=sources("brdfatlas.figures.pictures"),
    output:
        listing="results/ablation/{material}.json",
        references=expand("reports/ablation/{{material}}/{scene}-reference.webp", scene=SCENES),
    log:
        "results/logs/draw_ablation/{material}.log",
    benchmark:
        "results/benchmarks/draw_ablation/{material}.tsv"
    params:
        models=list(VARIANTS),
        tones=TONES,
        hdr=False,
    message:
        "pictures of the objectives on {wildcards.material}"


rule write_ablation:
    input:
        facts=expand("results/materials/{material}.json", material=ABLATED),
        errors=expand("results/ablation/{material}.tsv", material=ABLATED),
        brdf=expand("results/ablation/{material}.brdf.tsv", material=ABLATED),
        pictures=expand("results/ablation/{material}.json", material=ABLATED),
        assets=expand("reports/assets/{asset}", asset=asset_names()),
        source=sources("brdfatlas.reports.ablation_page"),
        templates=beside_site("templates", ".j2"),
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
        pictures=lambda wildcards, output: str(Path(output.page).with_suffix("")),
        variants=VARIANTS,
        scenes=SHOWN_SCENES,
        model_files=ABLATION_FILES,
        links=LINKS,
    message:
        "page of the objectives"
    script:
        "../scripts/write_ablation.py"
