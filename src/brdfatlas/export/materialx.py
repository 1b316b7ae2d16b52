"""A fit as MaterialX 1.39: a surface shader node with the fit's numbers, and a material that uses it."""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from brdfatlas.export.facts import ExportError, facts
from brdfatlas.export.mitsuba import comment
from brdfatlas.files import write_text
from brdfatlas.fits import Fit

VERSION = "1.39"
ROUGHNESS = {
    "open_pbr_surface": "specular_roughness, coat_roughness are perceptual; alpha is the square",
    "gltf_pbr": "roughness is perceptual; alpha is its square",
}


def materialx_of(fit: Fit, more: Mapping[str, Any] | None = None) -> str:
    """The document as XML text; it needs no library. ExportError for a model that no standard node is exactly."""
    material = fit.material_for("materialx")
    if material is None:
        raise ExportError(f"{fit.entry}: no surface shader of MaterialX is exactly this model")
    told = facts(fit, more) | {"roughness": ROUGHNESS.get(material["node"], f"as {material['node']} takes it")}
    root = ElementTree.Element("materialx", version=VERSION, colorspace="lin_rec709")
    for key, value in told.items():
        root.append(comment(f"{key}: {value}"))
    surface = ElementTree.SubElement(root, material["node"], name="surface", type="surfaceshader")
    for name, value in material["inputs"].items():
        if isinstance(value, list):
            text, kind = ", ".join(map(repr, value)), "color3"
        else:
            text, kind = repr(value), "float"
        ElementTree.SubElement(surface, "input", name=name, type=kind, value=text)
    use = ElementTree.SubElement(
        root, "surfacematerial", name=_identifier(f"{fit.material}_{fit.entry}"), type="material"
    )
    ElementTree.SubElement(use, "input", name="surfaceshader", type="surfaceshader", nodename="surface")
    ElementTree.indent(root)
    return '<?xml version="1.0"?>\n' + ElementTree.tostring(root, encoding="unicode") + "\n"


def _identifier(name: str) -> str:
    """A name as MaterialX allows it: letters, digits and _, no digit in front."""
    plain = "".join(c if c.isascii() and c.isalnum() else "_" for c in name)
    return f"_{plain}" if plain[:1].isdigit() else plain


def export_materialx(fit: Fit, path: str | os.PathLike, more: Mapping[str, Any] | None = None) -> None:
    """Write :func:`materialx_of`. Where the MaterialX library is installed, the document is validated first:
    ExportError with its words."""
    text = materialx_of(fit, more)
    fault = validate(text)
    if fault:
        raise ExportError(f"{Path(path).name}: MaterialX does not accept it ({fault})")
    write_text(path, text)


def validate(text: str) -> str:
    """What the MaterialX library finds wrong with a document, in one line; empty if nothing, or without the library."""
    try:
        import MaterialX as mx
    except ModuleNotFoundError:
        return ""
    document = mx.createDocument()
    libraries = mx.createDocument()
    mx.loadLibraries(mx.getDefaultDataLibraryFolders(), mx.getDefaultDataSearchPath(), libraries)
    mx.readFromXmlString(document, text)
    document.setDataLibrary(libraries)
    valid, message = document.validate()
    return "" if valid else " ".join(message.split())
