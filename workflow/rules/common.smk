# The run's materials, models and scenes, checked before any work, and the few helpers that rules share. Reading this
# writes nothing.

import gc
import functools
import os
import shlex
import sys
from pathlib import Path

from snakemake.io import IOFile

from brdfatlas.constants import REFERENCE, REFERENCE_AGAIN
from brdfatlas.export.uber_texture import HEIGHT, has_row
from brdfatlas.files import stamps
from brdfatlas.models import name_sources, read_entries
from brdfatlas.models.given import why_no_row
from brdfatlas.pipeline.configuration import (
    check_configfiles,
    check_samples,
    check_writable,
    choose,
    files_of_scene,
    read_assets,
    read_config,
    read_rgl,
    time_fault,
)
from brdfatlas.pipeline.leftovers import missing_files
from brdfatlas.pipeline.materials import MEASURED_FOLDER, find_materials
from brdfatlas.pipeline.provenance import provenance, shipped
from brdfatlas.pipeline.records import revision, versions
from brdfatlas.pipeline.standins import PUBLISHED_MODELS
from brdfatlas.rendering.scenes import read_scenes
from brdfatlas.settings import located

# A plan makes millions of objects that stay: to look for those that do not takes a sixth of its time.
gc.freeze()
gc.set_threshold(500_000, 20, 20)

# Snakemake hands this path to a shell as it is: a project's folder may have spaces and quotes.
if Path(sys.executable).exists():  # not quoted yet
    sys.executable = shlex.quote(sys.executable)

try:
    # Snakemake, which writes there before it plans, ends in a traceback where it cannot.
    check_writable([".snakemake", *Path(".snakemake").glob("*/")])
    check_configfiles(workflow.configfiles)
    config = read_config(config)
    ALL_ENTRIES = read_entries(config["models_file"])
    ALL_SCENES = read_scenes(config["scenes_file"])
    MODELS = choose(config["models"], list(ALL_ENTRIES), "models", str(config["models_file"]))
    SCENES = choose(config["scenes"], list(ALL_SCENES), "scenes", config["scenes_file"])
    ASSETS = read_assets(located("config/assets.yaml"))
    PUBLISHED_FITS = read_assets(located("config/published_fits.yaml"))
    RGL = read_rgl(located("config/rgl.yaml"))
    config["animation"]["scene"] = choose(
        [config["animation"]["scene"] or SCENES[0]], SCENES, "animation.scene", "config"
    )[0]
    choose([config["animation"]["model"]] if config["animation"]["model"] else [], MODELS, "animation.model", "config")
    check_samples(config, {name: ALL_SCENES[name] for name in SCENES})
    FOUND, LEFT_OUT, CHECKS = find_materials(config, "results/standins", "results/checks.json")
    # An entry of given parameters stands in the run if any material has them.
    for name in list(MODELS):
        if not ALL_ENTRIES[name].parameters:
            continue
        reasons = [
            why_no_row(name, ALL_ENTRIES[name].parameters, material.name, standin=material.standin)
            for material in FOUND
        ]
        if all(reasons):
            MODELS.remove(name)
            print(f"left out: {name}: {reasons[0]}", file=sys.stderr)
except ValueError as error:
    raise WorkflowError(str(error)) from None

# The rows of the run, for every job that says more of a model than its name.
ENTRIES = [ALL_ENTRIES[name].plain for name in MODELS]
name_sources(ALL_ENTRIES.values())
# Paper or family -> the rows of the run that one job fits. A job a row would spend more on its start than on its fit.
FAMILIES = {
    family: [name for name in MODELS if ALL_ENTRIES[name].family == family]
    for family in dict.fromkeys(ALL_ENTRIES[name].family for name in MODELS)
}

BINARIES = {material.name: material.binary for material in FOUND}
# Files of other formats than MERL are put on the grid once; jobs read the result.
SOURCES = {material.name: material.source for material in FOUND if material.source}
STANDINS = {material.name for material in FOUND if material.standin}
MATERIALS = list(BINARIES)
# Stamps of the measurements before any job, for all jobs of a run must read the same.
STAMPS = {item.name: stamps([item.source or item.binary]) for item in FOUND if not item.standin}
REFERENCES = [REFERENCE, REFERENCE_AGAIN]
PUBLISHED = located("config/published")
PUBLISHED_LOBES = [model.name for model in PUBLISHED_MODELS]
for item in LEFT_OUT:
    print(f"left out: {item.reason}", file=sys.stderr)

# Libraries whose versions make a result another. Each job states what it is made of, by provenance().
FITTING = ("numpy", "scipy", "numba")
RENDERING = ("numpy", "mitsuba", "drjit")
MEASURING = ("numpy", "numba", "scikit-image", "scipy")
DRAWING = ("numpy", "matplotlib", "pillow", "scikit-image", "scipy")
TEMPLATES = ("reports/templates/*.j2",)

# What the pictures of a run are in memory: millions of pixels of one, and MB of one with all its batches.
MEGAPIXELS = config["render"]["size"] ** 2 / 1e6
BATCHES_MB = 12 * config["render"]["batches"] * MEGAPIXELS


onstart:
    # Snakemake's limit of jobs a second (9.27) adds a timer with every job that ends, and each asks every second which
    # jobs are ready: after some hundred jobs the main process needs a core for it. A local run needs no limit.
    if workflow.local_exec:
        workflow.scheduler.job_rate_limiter = None


wildcard_constraints:
    material=r"[A-Za-z0-9][A-Za-z0-9._-]*",
    model=r"[A-Za-z0-9][A-Za-z0-9._-]*",
    scene=r"[A-Za-z0-9][A-Za-z0-9._-]*",


def growing(amount):
    """mem_mb or runtime of a job that depends on the configuration, memory with room for the two Snakemakes that Slurm
    counts with it; as much again after each failure."""
    return lambda wildcards, attempt: attempt * round(amount)


def parameters_of(names):
    """The files of given parameters that entries have."""
    return sorted({ALL_ENTRIES[name].parameters for name in names} - {None})


def provenance_of_fit(name):
    """What a fit of an entry is made of."""
    return provenance(ALL_ENTRIES[name].module, "brdfatlas.pipeline.jobs", libraries=FITTING)


def binary_of(wildcards):
    """The file of a material that jobs read."""
    check_results()
    return BINARIES[wildcards.material]


@functools.cache
def check_results():
    """While a run is planned, once: that results are not of the future, where Snakemake fails what is made of them, that
    they can be written, and that it is known what they were made of. Where Snakemake's records are gone (.snakemake
    deleted), it takes whatever exists for today's; all jobs run then, and keep fits and renders that are still right.
    """
    if not workflow.is_main_process:
        return
    made = ["results/run.json", *made_by(rules.prepare_scene, scene=SCENES), *expand(MADE, material=MATERIALS)]
    if workflow.executor_plugin and not workflow.dryrun:  # not for who only looks
        if workflow.resource_settings.cores == 0:
            raise SystemExit("--cores 0: no job can begin, and Snakemake would wait without end; give 1 or more")
        if ahead := [file for file in made if time_fault(file)]:
            raise SystemExit(
                f"results: of a time to come ({ahead[0]}); correct the clock, or "
                "`find results reports -newermt now -exec touch {} +`, then run with --forceall"
            )
        try:
            check_writable(
                folder
                for top in map(Path, ("results", "reports"))
                for folder in [top, *top.glob("*/"), *top.glob("*/*/")]
            )
        except ValueError as error:
            raise SystemExit(str(error)) from None
    if any(os.path.exists(file) and not workflow.persistence.metadata(IOFile(file)) for file in made):
        print(
            "results: no record in .snakemake of what they were made of; every job looks at them again", file=sys.stderr
        )
        workflow.dag.forcerules.update(workflow.dag.rules)


def planned(wildcards):
    """The stamp of a material's file, a parameter of all jobs that read it: one replaced while they worked, or by one
    that is older than their outputs, is noticed by the next run. Stand-ins are the run's own."""
    return STAMPS.get(wildcards.material, {})


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


def texture_rows(wildcards):
    """The materials in one of the textures of a model's factors."""
    part = int(wildcards.part)
    return MATERIALS[(part - 1) * HEIGHT : part * HEIGHT]


def made_by(rule, **wildcards):
    """Names of what a rule makes, for all values of its wildcards. Plain names; a list of thousands of references to
    rules is planned in the square of its length."""
    return expand([str(file) for file in rule.output], **wildcards)


def asset_names():
    """Names of the site's styles and scripts."""
    return [path.name for path in shipped("reports/assets/*")]


# Files whose number depends on the fits: a list, {kind: {name: checksum}}, stands for them. Kind -> their folder.
LISTED = {
    "pictures": "reports/materials/{material}",
    "figures": "reports/materials/{material}",
    "fit_files": "reports/materials/{material}/fits",
}
LISTINGS = {
    f"results/{kind}/{material}.json": folder.format(material=material)
    for kind, folder in LISTED.items()
    for material in MATERIALS
}


def lost_listed(wildcards):
    """Lists of files some of which are gone: the rule that makes them runs again, before pages and PDF that show them."""
    lists = [name for name, folder in LISTINGS.items() if missing_files(name, folder)]
    workflow.dag.forcefiles.update(lists)
    return lists


def lost(wildcards):
    """What fits and renders wrote and is gone, or never came, although the material was begun. Where it was not, what is
    made of them asks for them, and naming tens of thousands of files once more would double the time of a plan."""
    begun = [
        name
        for name in MATERIALS
        if any(os.path.exists(f"results/{kind}/{name}") for kind in ("fits", "renders", "errors"))
    ]
    files = expand("results/fits/{material}/{model}.{kind}", material=begun, model=MODELS, kind=("npz", "json"))
    files += expand(MADE, material=begun) + made_by(rules.render_material, material=begun, scene=SCENES)
    return [file for file in files if not os.path.exists(file)]


def animated(rule, materials):
    """What `snakemake animations` has made for these materials by one of its rules, where all of it is there."""
    made = [made_by(rule, material=[name]) for name in materials]
    return [file for files in made if all(map(os.path.exists, files)) for file in files]


def animation_files(wildcards):
    """The animation of a material, or of all, and what is said of it."""
    return animated(rules.draw_animation, [wildcards.material] if wildcards else MATERIALS)


def convergence_files(wildcards):
    """The animation of a fit's starts, of a material or of all."""
    materials = [wildcards.material] if wildcards else MATERIALS
    return animated(rules.draw_convergence, materials) if EIGHT_STARTS else []


def render_settings(wildcards):
    """How a scene is rendered: samples, batches, seed and Mitsuba's variant."""
    settings = {key: config["render"][key] for key in ("samples", "batches", "seed", "variant")}
    samples = ALL_SCENES[wildcards.scene]["samples"]
    return settings | ({"samples": samples} if samples else {})
