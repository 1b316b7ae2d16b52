# What rules share: what results are made of, what jobs need, names of files.

import os

from brdfatlas.export.uber_texture import HEIGHT, has_row
from brdfatlas.pipeline.configuration import files_of_scene
from brdfatlas.pipeline.provenance import provenance, shipped

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
    gc.freeze()
    gc.enable()
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
    except OSError as error:
        raise SystemExit(f"{source}: {shown(error.filename or '.')}: {error.strerror}; correct the path") from None
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
