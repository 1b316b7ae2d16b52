"""A fit as a Mitsuba 3 material: a stock plugin where one is exactly the model, else ours with the fit beside it."""

import os
import re
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from brdfatlas.export.facts import ExportError, facts
from brdfatlas.files import shown, write_text
from brdfatlas.fits import Fit, load_fit

#: Stock plugins and what their numbers mean.
ROUGHNESS = {
    "diffuse": "none: the material is Lambertian",
    "principled": "`roughness` is perceptual; the plugin's alpha is max(0.001, roughness^2)",
    "brdfatlas": "as the fit stores it, see its parameters",
}

#: Elements of a scene file and what they hold.
KINDS = {"boolean": bool, "integer": int, "float": float}


def mitsuba_dict(fit: Fit, filename: str | os.PathLike = "") -> dict[str, Any]:
    """The material for ``mitsuba.load_dict``: stock where the model's hook knows one, else ``{"type": "brdfatlas",
    "filename": filename}``, which needs the saved fit and ``brdfatlas.rendering.register()``."""
    stock = fit.material_for("mitsuba")
    return dict(stock) if stock else {"type": "brdfatlas", "filename": os.fspath(filename)}


def comment(text: str) -> ElementTree.Element:
    """An XML comment, in which neither "--" nor a control character may stand."""
    return ElementTree.Comment(f" {re.sub('-(?=-)', '- ', shown(text))} ")


def beside_of(path: str | os.PathLike) -> Path:
    """Where the fit of a scene file is: beside the file itself, also where ``path`` is a link to it."""
    path = Path(path)
    return (Path(os.path.realpath(path)) if path.is_symlink() else path).with_suffix(".npz")


def holds(path: str | os.PathLike, fit: Fit) -> bool:
    """Whether a file holds this very fit."""
    with suppress(ValueError, OSError):
        return load_fit(path, fit.source) == fit
    return False


def export_mitsuba(fit: Fit, path: str | os.PathLike, more: Mapping[str, Any] | None = None) -> list[Path]:
    """Write a scene file with the material alone, id ``material``: include it and refer to the id, or load it.

    A fit that no stock plugin can hold is saved beside it as .npz. Returns the files written.
    """
    path, beside = Path(path), beside_of(path)
    material = mitsuba_dict(fit, beside.name)
    told = facts(fit, more) | {
        "roughness": ROUGHNESS.get(material["type"], f"as {material['type']} of Mitsuba takes it")
    }
    scene = ElementTree.Element("scene", version="3.0.0")
    for key, value in told.items():
        scene.append(comment(f"{key}: {value}"))
    scene.append(_element("bsdf", material, id="material"))
    ElementTree.indent(scene)
    files = [path]
    if material["type"] == "brdfatlas":
        if "$" in beside.name:  # in any attribute, and there is no escape
            raise ExportError(
                f"{shown(beside.name)}: Mitsuba takes $ for a parameter of the scene; name another output"
            )
        if path == beside:
            raise ExportError(f"{shown(path)}: the fit itself is written there beside the scene file; name it .xml")
        scene.insert(0, comment("needs the plugin: brdfatlas.rendering.register() before loading"))
        if not holds(beside, fit):  # the file that the fit was read from stays as it is
            fit.save(beside)
        files.append(beside)
    write_text(path, ElementTree.tostring(scene, encoding="unicode") + "\n")
    return files


def _element(tag: str, plugin: Mapping[str, Any], **attributes: str) -> ElementTree.Element:
    element = ElementTree.Element(tag, type=plugin["type"], **attributes)
    for name, value in plugin.items():
        if name == "type":
            continue
        if isinstance(value, Mapping) and value.get("type") == "rgb":  # {"type": "rgb", "value": [...]}
            text = ", ".join(map(repr, value["value"]))
            ElementTree.SubElement(element, "rgb", name=name, value=text)
        elif isinstance(value, Mapping):
            element.append(_element("bsdf", value, name=name))
        else:
            kind = next((kind for kind, known in KINDS.items() if isinstance(value, known)), "string")
            text = str(value).lower() if kind == "boolean" else str(value)
            ElementTree.SubElement(element, kind, name=name, value=text)
    return element
