# The run's materials, models and scenes, checked before any work, and the few helpers that rules share. Reading this
# writes nothing.

import json
import os
import sys
from pathlib import Path

from brdfatlas.pipeline.configuration import (
    check_samples,
    choose,
    files_of_scene,
    read_assets,
    read_config,
    read_models,
    read_variants,
)
from brdfatlas.pipeline.leftovers import missing_files
from brdfatlas.pipeline.materials import find_materials
from brdfatlas.pipeline.provenance import provenance, shipped
from brdfatlas.pipeline.records import revision, versions
from brdfatlas.rendering.scenes import read_scenes
from brdfatlas.pipeline.standins import PUBLISHED_MODELS
from brdfatlas.export.uber_texture import HEIGHT, MODELS_WITH_FACTORS

try:
    config = read_config(config)
    ALL_MODELS = read_models(config["models_file"])
    ALL_SCENES = read_scenes(config["scenes_file"])
    MODELS = choose(config["models"], list(ALL_MODELS), "models", config["models_file"])
    SCENES = choose(config["scenes"], list(ALL_SCENES), "scenes", config["scenes_file"])
    VARIANTS = read_variants(config["ablation"], ALL_MODELS)
    ASSETS = read_assets("config/assets.yaml")
    check_samples(config, {name: ALL_SCENES[name] for name in SCENES})
    FOUND, LEFT_OUT, CHECKS = find_materials(config, "results/standins", "results/checks.json")
except ValueError as error:
    raise WorkflowError(str(error)) from None

# What can be fitted: the models, and those of the ablation with other options.
FITTED = ALL_MODELS | VARIANTS

# Models of your own, for every job that loads a fit of one.
OWN_MODELS = {name: model["source"] for name, model in ALL_MODELS.items() if model["source"]}
os.environ.update(BRDFATLAS_MODELS=json.dumps(OWN_MODELS))

BINARIES = {material.name: material.binary for material in FOUND}
STANDINS = {material.name for material in FOUND if material.standin}
MATERIALS = list(BINARIES)
REFERENCES = ["reference", "reference_again"]
PUBLISHED_LOBES = [model.name for model in PUBLISHED_MODELS]
for item in LEFT_OUT:
    print(f"left out: {item.reason}", file=sys.stderr)

# A material that this run does not have is missed by the ablation only.
WANTED = MATERIALS if config["ablation"]["materials"] == "all" else config["ablation"]["materials"]
ABLATED = [name for name in WANTED if name in BINARIES]
for name in WANTED:
    if name not in BINARIES:
        print(f"left out of the ablation: {name} is not a material of this run", file=sys.stderr)

# Libraries whose versions make a result another. Each rule states what it is made of: provenance(MODULES, libraries=...).
FITTING = ("numpy", "scipy", "numba")
RENDERING = ("numpy", "mitsuba", "drjit")
MEASURING = ("numpy", "numba", "scikit-image", "flip-evaluator")
DRAWING = ("numpy", "matplotlib", "pillow", "scikit-image", "flip-evaluator")
TEMPLATES = ("reports/templates/*.j2",)


wildcard_constraints:
    material=r"[A-Za-z0-9][A-Za-z0-9._-]*",
    model=r"[A-Za-z0-9][A-Za-z0-9._-]*",
    scene=r"[A-Za-z0-9][A-Za-z0-9._-]*",


def binary_of(wildcards):
    """The MERL file of a material."""
    return BINARIES[wildcards.material]


def first_material_first(wildcards):
    """Priority of a job: materials are finished one after another, so that the first page is out early."""
    return len(MATERIALS) - MATERIALS.index(wildcards.material)


def neighbours(wildcards):
    """A material between those before and after it, to which its page links."""
    place = MATERIALS.index(wildcards.material)
    return MATERIALS[max(0, place - 1) : place + 2]


def scene_files(names):
    """The light probes and meshes that these scenes read. One that is not there stops every run that needs it when it
    is planned, before any work; by an exit, because Snakemake passes over errors of inputs of what exists already."""
    source = config["scenes_file"]
    try:
        return [file for name in names for file in files_of_scene(name, ALL_SCENES[name], source, ASSETS)]
    except ValueError as error:
        raise SystemExit(str(error)) from None


def fit_of(wildcards):
    """The fit that a render needs: none for the measured table itself."""
    if wildcards.model in REFERENCES:
        return {}
    return {
        "fit": rules.fit_model.output.fit.format(**wildcards),
        "report": rules.fit_model.output.report.format(**wildcards),
    }


def texture_rows(wildcards):
    """The materials in one of the textures of a model's factors."""
    part = int(wildcards.part)
    return MATERIALS[(part - 1) * HEIGHT : part * HEIGHT]


def asset_names():
    """Names of the site's styles and scripts."""
    return [path.name for path in shipped("reports/assets/*")]
