# The run's materials, models and scenes, checked before any work, and the few helpers that rules share.

import json
import os
import sys
from pathlib import Path

from brdfatlas.constants import REFERENCE, REFERENCE_AGAIN
from brdfatlas.pipeline.configuration import (
    check_samples,
    choose,
    files_of_scene,
    read_assets,
    read_config,
    read_models,
    read_variants,
)
from brdfatlas.pipeline.jobs import revision, versions
from brdfatlas.pipeline.materials import find_materials
from brdfatlas.pipeline.progress import Progress
from brdfatlas.pipeline.recovery import record_outputs, recover
from brdfatlas.pipeline.sources import list_sources, module_path
from brdfatlas.rendering.scenes import read_scenes
from brdfatlas.pipeline.standins import PUBLISHED_MODELS
from brdfatlas.export.uber_texture import HEIGHT, MODELS_WITH_FACTORS
from snakemake.logging import logger

# Only the process that will run jobs mends what an earlier run left, and follows the jobs: no dry run, no job itself,
# and no --lint, which Snakemake tells from a run only by this.
STARTING = workflow.is_main_process and not workflow.output_settings.dryrun and workflow.check_envvars

try:
    config = read_config(config)
    ALL_MODELS = read_models(config["models_file"])
    ALL_SCENES = read_scenes(config["scenes_file"])
    MODELS = choose(config["models"], list(ALL_MODELS), "models", config["models_file"])
    SCENES = choose(config["scenes"], list(ALL_SCENES), "scenes", config["scenes_file"])
    VARIANTS = read_variants(config["ablation"], ALL_MODELS)
    ASSETS = read_assets("config/assets.yaml")
    check_samples(config, {name: ALL_SCENES[name] for name in SCENES})
    if STARTING:
        recover(["src", "workflow", "config", config["merl_folder"]])
    FOUND, LEFT_OUT = find_materials(config, "results/standins", "results/materials/checks.json")
except ValueError as error:
    raise WorkflowError(str(error)) from None

# What can be fitted: the models, and those of the ablation with other options.
FITTED = ALL_MODELS | VARIANTS

VERSIONS = versions()

# Models of your own, for every job that loads a fit of one.
OWN_MODELS = {name: model["source"] for name, model in ALL_MODELS.items() if model["source"]}
os.environ.update(BRDFATLAS_MODELS=json.dumps(OWN_MODELS))

if STARTING:
    logger.addHandler(Progress("results/progress.log", workflow.resource_settings.cores or 1, finished=record_outputs))

BINARIES = {material.name: material.binary for material in FOUND}
STANDINS = {material.name for material in FOUND if material.standin}
MATERIALS = list(BINARIES)
PUBLISHED_LOBES = [model.name for model in PUBLISHED_MODELS]
for item in LEFT_OUT:
    print(f"left out: {item.reason}", file=sys.stderr)

# A material that this run does not have is missed by the ablation only.
WANTED = MATERIALS if config["ablation"]["materials"] == "all" else config["ablation"]["materials"]
ABLATED = [name for name in WANTED if name in BINARIES]
for name in WANTED:
    if name not in BINARIES:
        print(f"left out of the ablation: {name} is not a material of this run", file=sys.stderr)


wildcard_constraints:
    material=r"[A-Za-z0-9][A-Za-z0-9._-]*",
    model=r"[A-Za-z0-9][A-Za-z0-9._-]*",
    scene=r"[A-Za-z0-9][A-Za-z0-9._-]*",


def binary_of(wildcards):
    """The MERL file of a material."""
    return BINARIES[wildcards.material]


def sources(*modules):
    """A list of the source files that these modules depend on, with their checksums; declared as an input, so that a
    changed file reruns what needs it."""
    try:
        return list_sources("results/sources", *modules)
    except OSError as error:
        raise WorkflowError(f"results/sources: cannot be written ({error.strerror})") from None


def first_material_first(wildcards):
    """Priority of a job: materials are finished one after another, so that the first page is out early."""
    return len(MATERIALS) - MATERIALS.index(wildcards.material)


def neighbours(wildcards):
    """A material between those before and after it, to which its page links."""
    place = MATERIALS.index(wildcards.material)
    return MATERIALS[max(0, place - 1) : place + 2]


def model_sources(wildcards):
    """The model's own file and what it imports: editing one model refits that model only."""
    return sources(FITTED[wildcards.model]["module"], "brdfatlas.fits", "brdfatlas.measures.physics")


def scene_files(names):
    """The light probes and meshes that these scenes read. One that is not there stops a run when it is planned, before
    any work; downloads need no scene, so they are not stopped."""
    source = config["scenes_file"]
    try:
        return [file for name in names for file in files_of_scene(name, ALL_SCENES[name], source, ASSETS)]
    except ValueError as error:
        raise WorkflowError(str(error)) from None


def beside_site(folder, ending=""):
    """Files of the reports package that are no modules: templates (".j2" of pages, ".typ" of the PDF) and assets."""
    package = Path(os.path.relpath(module_path("brdfatlas.reports.site").parent))
    return sorted(str(path) for path in (package / folder).glob(f"[!.]*{ending}"))


def texture_rows(wildcards):
    """The materials in one of the textures of a model's factors."""
    part = int(wildcards.part)
    return MATERIALS[(part - 1) * HEIGHT : part * HEIGHT]


def asset_names():
    """Names of the site's styles and scripts."""
    return [Path(path).name for path in beside_site("assets")]
