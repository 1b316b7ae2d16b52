# facts, fits, errors and pictures --> the report: a page a material (out as soon as its material is), pages of models,
# index and PDF.

import re

SITE = "brdfatlas.reports.site"
PDF = "brdfatlas.reports.pdf"
SHOWN_SCENES = {name: {key: ALL_SCENES[name][key] for key in ("title", "exposure", "gamma")} for name in SCENES}
LINKS = {"pdf": config["pdf"], "viewer": True, "standings": True}
RUN_FILES = {
    name: {
        "facts": f"results/materials/{name}.json",
        "fits": [f"results/fits/{name}/{model}.json" for model in MODELS],
        "errors": f"results/errors/{name}/images.tsv",
        "brdf": f"results/errors/{name}/brdf.tsv",
    }
    for name in MATERIALS
}
MATERIAL_TABLES = ["errors", "brdf", "fits", "parameters", "published"]
MODEL_TABLES = ["errors", "fits", "parameters"]
# Rows of a texture are materials; where there are more than it has rows, there are several.
FACTORED = [name for name in MODELS if has_row(ALL_ENTRIES[name].instance)]
TEXTURE_PARTS = range(1, -(-len(MATERIALS) // HEIGHT) + 1)
ASSET_FILES = expand("reports/assets/{asset}", asset=asset_names())
RUN_TABLES = ["materials", "recommended", "models", "errors", "brdf", "fits", "parameters", "left_out"]


rule write_fits:
    input:
        fits=expand("results/fits/{{material}}/{model}.npz", model=MODELS),
        made=MADE,
    output:
        # Which files a fit has depends on the fit: a list stands for them.
        listing="results/fit_files/{material}.json",
    log:
        "results/logs/write_fits/{material}.log",
    benchmark:
        "results/benchmarks/write_fits/{material}.tsv"
    priority: first_material_first
    resources:
        mem_mb=400,
        runtime=5,
    params:
        provenance=provenance("brdfatlas.reports.fit_files"),
        folder="reports/materials/{material}/fits",
    message:
        "fits of {wildcards.material} to take away"
    script:
        "../scripts/write_fits.py"


rule write_material_page:
    input:
        facts="results/materials/{material}.json",
        fits=expand("results/fits/{{material}}/{model}.json", model=MODELS),
        errors="results/errors/{material}/images.tsv",
        brdf="results/errors/{material}/brdf.tsv",
        pictures="results/pictures/{material}.json",
        figures="results/figures/{material}.json",
        files="results/fit_files/{material}.json",
        bars=expand("reports/assets/bar-{kind}.svg", kind=["de00", "flip", "diff"]),
        published=expand(f"{PUBLISHED}/bilgili2011/{{table}}.csv", table=PUBLISHED_LOBES + ["psnr"]),
        animation=animation_files,
        convergence=convergence_files,
    output:
        page="reports/materials/{material}.html",
        thumbnail="reports/materials/{material}/thumb.webp",
        tables=expand("reports/data/materials/{{material}}/{table}.tsv", table=MATERIAL_TABLES),
    log:
        "results/logs/write_material_page/{material}.log",
    benchmark:
        "results/benchmarks/write_material_page/{material}.tsv"
    wildcard_constraints:
        material="|".join(map(re.escape, MATERIALS)),
    priority: first_material_first
    resources:
        mem_mb=400,
        runtime=5,
    params:
        provenance=provenance(SITE, files=TEMPLATES),
        pictures="reports/materials/{material}",
        data=lambda wildcards: "reports/data",
        published=lambda wildcards, input: str(Path(input.published[0]).parent),
        materials=neighbours,
        models=MODELS,
        entries=ENTRIES,
        scenes=SHOWN_SCENES,
        links=LINKS,
    message:
        "page of {wildcards.material}"
    script:
        "../scripts/write_material_page.py"


rule write_model_pages:
    input:
        run=[path for files in RUN_FILES.values() for path in [files["facts"], files["errors"], files["brdf"]]],
        pictures=expand("results/pictures/{material}.json", material=MATERIALS),
    output:
        pages=expand("reports/models/{model}.html", model=MODELS),
        tables=expand("reports/data/models/{model}/{table}.tsv", model=MODELS, table=MODEL_TABLES),
    log:
        "results/logs/write_model_pages.log",
    benchmark:
        "results/benchmarks/write_model_pages.tsv"
    resources:
        mem_mb=600,
        runtime=10,
    params:
        provenance=provenance(SITE, files=TEMPLATES),
        folder=lambda wildcards, output: str(Path(output.pages[0]).parent),
        files=RUN_FILES,
        pictures="reports/materials",
        data=lambda wildcards: "reports/data",
        models=MODELS,
        entries=ENTRIES,
        scenes=SHOWN_SCENES,
        links=LINKS,
    message:
        "pages of the models"
    script:
        "../scripts/write_model_pages.py"


rule write_index:
    input:
        record="results/run.json",
        run=[path for files in RUN_FILES.values() for path in [files["facts"], files["errors"], files["brdf"]]],
        files=expand("results/fit_files/{material}.json", material=MATERIALS),
    output:
        page="reports/index.html",
        script="reports/data/atlas.js",
        tables=expand("reports/data/{table}.tsv", table=[table for table in RUN_TABLES if table != "models"]),
        models=report(
            "reports/data/models.tsv",
            caption="../captions/models.rst",
            category="Results",
            labels={"what": "models, medians over the materials"},
        ),
    log:
        "results/logs/write_index.log",
    benchmark:
        "results/benchmarks/write_index.tsv"
    resources:
        mem_mb=600,
        runtime=10,
    params:
        provenance=provenance(SITE, files=TEMPLATES),
        files=RUN_FILES,
        data=lambda wildcards, output: str(Path(output.script).parent),
        models=MODELS,
        entries=ENTRIES,
        scenes=SHOWN_SCENES,
        links=LINKS,
    message:
        "index, tables of the run"
    script:
        "../scripts/write_index.py"


rule write_assets:
    output:
        assets=ASSET_FILES,
        compare="reports/compare.html",
    log:
        "results/logs/write_assets.log",
    benchmark:
        "results/benchmarks/write_assets.tsv"
    priority: 1000
    resources:
        mem_mb=300,
        runtime=5,
    params:
        provenance=provenance(SITE, files=(*TEMPLATES, "reports/assets/*")),
        folder=lambda wildcards, output: str(Path(output.assets[0]).parent),
        links=LINKS,
    message:
        "style and scripts of the report, the page that compares"
    script:
        "../scripts/write_assets.py"


rule typeset_material:
    input:
        facts="results/materials/{material}.json",
        fits=expand("results/fits/{{material}}/{model}.json", model=MODELS),
        errors="results/errors/{material}/images.tsv",
        brdf="results/errors/{material}/brdf.tsv",
        pictures="results/pictures/{material}.json",
        figures="results/figures/{material}.json",
        bars="reports/assets/bar-de00.svg",
        published=expand(f"{PUBLISHED}/bilgili2011/{{table}}.csv", table=PUBLISHED_LOBES + ["psnr"]),
    output:
        "results/pdf/{material}.pdf",
    log:
        "results/logs/typeset_material/{material}.log",
    benchmark:
        "results/benchmarks/typeset_material/{material}.tsv"
    priority: first_material_first
    resources:
        mem_mb=500,
        runtime=5,
    params:
        provenance=provenance(PDF, files=("reports/templates/*.typ",), libraries=("typst", "pypdf")),
        pictures="reports/materials/{material}",
        assets=lambda wildcards, input: str(Path(input.bars).parent),
        published=lambda wildcards, input: str(Path(input.published[0]).parent),
        models=MODELS,
        entries=ENTRIES,
        scenes=SHOWN_SCENES,
    message:
        "PDF pages of {wildcards.material}"
    script:
        "../scripts/typeset_material.py"


rule write_supplement:
    input:
        record="results/run.json",
        run=[path for files in RUN_FILES.values() for path in [files["facts"], files["errors"], files["brdf"]]],
        parts=expand("results/pdf/{material}.pdf", material=MATERIALS),
    output:
        report(
            "reports/supplement.pdf",
            caption="../captions/supplement.rst",
            category="Report",
            labels={"what": "supplement, four pages a material"},
        ),
    log:
        "results/logs/write_supplement.log",
    benchmark:
        "results/benchmarks/write_supplement.tsv"
    resources:
        mem_mb=1000,
        runtime=10,
    params:
        provenance=provenance(PDF, files=("reports/templates/*.typ",), libraries=("typst", "pypdf")),
        number=len(MATERIALS),
        files=RUN_FILES,
        models=MODELS,
        entries=ENTRIES,
        scenes=SHOWN_SCENES,
    message:
        "joining the PDF of {params.number} materials"
    script:
        "../scripts/write_supplement.py"


rule write_uber_texture:
    input:
        fits=lambda wildcards: expand("results/fits/{material}/{{model}}.npz", material=texture_rows(wildcards)),
    output:
        "reports/data/models/{model}/uber-texture-{part}.exr",
    log:
        "results/logs/write_uber_texture/{model}/{part}.log",
    benchmark:
        "results/benchmarks/write_uber_texture/{model}/{part}.tsv"
    wildcard_constraints:
        part=r"\d+",
    resources:
        mem_mb=400,
        runtime=5,
    params:
        provenance=provenance("brdfatlas.export.uber_texture", libraries=("numpy",)),
    message:
        "texture of the factors of {wildcards.model}"
    script:
        "../scripts/write_uber_texture.py"


rule write_viewer:
    input:
        textures=expand("reports/data/models/{model}/uber-texture-{part}.exr", model=FACTORED, part=TEXTURE_PARTS),
        fits=expand("results/fits/{material}/{model}.npz", material=MATERIALS, model=MODELS),
        descriptions=expand("results/materials/{material}.json", material=MATERIALS),
        scenes=expand("results/scenes/{scene}.npz", scene=SCENES),
    output:
        page="reports/viewer.html",
        script="reports/data/viewer.js",
    log:
        "results/logs/write_viewer.log",
    benchmark:
        "results/benchmarks/write_viewer.tsv"
    resources:
        mem_mb=800,
        runtime=10,
    params:
        provenance=provenance("brdfatlas.reports.viewer", files=TEMPLATES),
        data=lambda wildcards, output: str(Path(output.script).parent),
        fits=[(material, model, f"results/fits/{material}/{model}.npz") for material in MATERIALS for model in MODELS],
        materials={material: f"results/materials/{material}.json" for material in MATERIALS},
        textures=lambda wildcards, input: [os.path.relpath(path, "reports/data") for path in input.textures],
        entries=ENTRIES,
        scenes=SHOWN_SCENES,
        links=LINKS,
    message:
        "interactive viewer"
    script:
        "../scripts/write_viewer.py"


# Everything in reports/.
REPORT = [
    *made_by(rules.draw_pictures, material=MATERIALS),
    *made_by(rules.draw_figures, material=MATERIALS),
    *made_by(rules.write_fits, material=MATERIALS),
    *made_by(rules.draw_bars),
    *made_by(rules.draw_summary),
    *made_by(rules.write_assets),
    *made_by(rules.write_material_page, material=MATERIALS),
    *made_by(rules.write_model_pages),
    *made_by(rules.write_uber_texture, model=FACTORED, part=TEXTURE_PARTS),
    *made_by(rules.write_viewer),
    *made_by(rules.write_index),
    *(made_by(rules.write_supplement) if config["pdf"] else []),
]
