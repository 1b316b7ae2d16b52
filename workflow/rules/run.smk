# The run: its materials, models and scenes, read and checked before any work. Reading this writes nothing.

import gc
import os
import shlex
import sys
from pathlib import Path

from brdfatlas.constants import REFERENCE, REFERENCE_AGAIN
from brdfatlas.files import shown, stamps
from brdfatlas.models import name_sources, read_entries
from brdfatlas.models.given import why_no_row
from brdfatlas.pipeline.configuration import (
    check_configfiles,
    check_samples,
    check_writable,
    choose,
    read_assets,
    read_config,
    read_rgl,
)
from brdfatlas.pipeline.materials import MEASURED_FOLDER, find_materials
from brdfatlas.pipeline.standins import PUBLISHED_MODELS
from brdfatlas.rendering.scenes import read_scenes
from brdfatlas.settings import located

# A plan makes millions of objects that stay: to look for those that do not takes a sixth of its time.
gc.disable()

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
    reason = f"{config['models_file']} has none"
    for name in list(MODELS):
        if not ALL_ENTRIES[name].parameters:
            continue
        reasons = [
            why_no_row(name, ALL_ENTRIES[name].parameters, material.name, standin=material.standin)
            for material in FOUND
        ]
        if all(reasons):
            MODELS.remove(name)
            reason = reasons[0]
            print(f"left out: {name}: {reason}", file=sys.stderr)
    if not MODELS:
        raise ValueError(f"config: models: no row is left to compare: {reason}")
except OSError as error:
    # A name longer than any may be, a folder that this user may not enter.
    raise WorkflowError(
        f"{shown(error.filename or '.')}: {error.strerror}; correct the configuration, or make it readable"
    ) from None
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
