"""``brdfatlas export FIT --to TARGET``: one name a target, one function a format.

Everything can be written as JSON, as a MERL table and as a Mitsuba material of our own plugin. Standard materials
(glTF, MaterialX, stock Mitsuba) hold a fit exactly or not at all.
"""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from brdfatlas.export.facts import ExportError, check_ranges
from brdfatlas.export.fit_json import export_json
from brdfatlas.export.gltf import export_gltf
from brdfatlas.export.materialx import export_materialx
from brdfatlas.export.mitsuba import export_mitsuba
from brdfatlas.export.sampler import export_sampler
from brdfatlas.fits import Fit
from brdfatlas.formats.merl import write_merl
from brdfatlas.measured import fold
from brdfatlas.models import MODELS, own_faults

#: target -> ending of its files
ENDINGS = {
    "mitsuba": ".xml",
    "materialx": ".mtlx",
    "gltf": ".gltf",
    "json": ".json",
    "sampler": ".sampler.json",
    "merl": ".binary",
}
#: Targets that hold only models which they are exactly.
STANDARD = ("mitsuba", "materialx", "gltf")


def models_for(target: str) -> list[str]:
    """Entries whose fits a standard target holds exactly."""
    return [name for name in MODELS if target in MODELS[name].targets]


def stem_of(material: str, model: str) -> str:
    """How the files of a fit begin, whatever its material is called: no path, nothing that is not printable,
    no ``$``, by which Mitsuba names a parameter."""
    plain = "".join(c if c.isprintable() and c not in "/\\$" else "_" for c in f"{material}-{model}")
    return plain.encode()[:200].decode(errors="ignore")


def targets_of(fit: Fit) -> tuple[str, ...]:
    """Targets that hold this fit; "mitsuba" always, by our plugin where no stock one is the model."""
    exact = [target for target in ("materialx", "gltf") if target in fit.instance.targets]
    return ("mitsuba", *exact, "json", *(["sampler"] if fit.sampler() is not None else []), "merl")


def export(fit: Fit, target: str, path: str | os.PathLike, more: Mapping[str, Any] | None = None) -> list[Path]:
    """Write a fit for ``target`` and return the files. ``more``: facts to be stated in the file, such as a dE00.

    ExportError, one line, for an unknown target, a target that cannot hold the model, parameters out of range.
    """
    if target not in ENDINGS:
        raise ExportError(f"unknown target {target!r}; known targets: {', '.join(ENDINGS)}")
    if target not in targets_of(fit):
        if target == "sampler":
            raise ExportError(f"model {fit.model} has no sampling procedure")
        able = ", ".join(models_for(target))
        raise ExportError(f"{fit.entry} cannot be expressed exactly in {target}; models that can: {able}")
    check_ranges(fit)
    path = Path(path)
    if target == "mitsuba":
        with own_faults(fit.instance, fit.material):  # what its material states may be anything
            return export_mitsuba(fit, path, more)
    if target == "merl":
        write_merl(path, fold(fit.table()), standin=fit.standin, reconstructed=True)
        return [path]
    if target in ("json", "sampler"):
        {"json": export_json, "sampler": export_sampler}[target](fit, path)
    else:
        with own_faults(fit.instance, fit.material):
            {"materialx": export_materialx, "gltf": export_gltf}[target](fit, path, more)
    return [path]
