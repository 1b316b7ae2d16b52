"""A fit as a glTF 2.0 file: a sphere that wears the material, for Blender, three.js and every glTF viewer."""

import base64
import os
from collections.abc import Mapping
from typing import Any

import numpy as np

from brdfatlas.export.facts import ExportError, facts
from brdfatlas.files import read_json, write_json
from brdfatlas.fits import Fit

FLOAT, UNSIGNED_SHORT = 5126, 5123
ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER = 34962, 34963


def sphere(rows: int = 24, columns: int = 48) -> tuple[np.ndarray, np.ndarray]:
    """Points of the unit sphere, which are its normals, (n, 3) float32, and triangles (m, 3) uint16, y up."""
    theta = np.linspace(0, np.pi, rows + 1)[:, None]
    phi = np.linspace(0, 2 * np.pi, columns + 1)[None, :]
    points = np.stack(np.broadcast_arrays(np.sin(theta) * np.sin(phi), np.cos(theta), np.sin(theta) * np.cos(phi)), -1)
    corner = (np.arange(rows)[:, None] * (columns + 1) + np.arange(columns)).ravel()
    below = corner + columns + 1
    upper = np.stack([corner, below, corner + 1], -1)[columns:]  # at the poles one of the two triangles has no area
    lower = np.stack([corner + 1, below, below + 1], -1)[:-columns]
    points = points / np.linalg.norm(points, axis=-1, keepdims=True)
    return points.reshape(-1, 3).astype(np.float32), np.concatenate([upper, lower]).astype(np.uint16)


def gltf_of(fit: Fit, more: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """The glTF document. ExportError for a model that the material of glTF 2.0 cannot hold."""
    material = fit.material_for("gltf")
    if material is None:
        raise ExportError(f"{fit.entry}: no material of glTF 2.0 is exactly this model")
    told = facts(fit, more) | {"roughness": "`roughnessFactor` is perceptual; alpha is its square"}
    extensions = dict(material.get("extensions", {}))
    factors = {key: value for key, value in material.items() if key != "extensions"}
    points, triangles = sphere()
    blob = points.tobytes() + triangles.tobytes()
    document = {
        "asset": {"version": "2.0", "generator": told["written by"], "extras": told},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "name": "sphere"}],
        "materials": [{"name": f"{fit.material} {fit.entry}", "pbrMetallicRoughness": factors}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "NORMAL": 0}, "indices": 1, "material": 0}]}],
        "accessors": [
            {"bufferView": 0, "componentType": FLOAT, "count": len(points), "type": "VEC3"}
            | {"min": points.min(0).tolist(), "max": points.max(0).tolist()},
            {"bufferView": 1, "componentType": UNSIGNED_SHORT, "count": triangles.size, "type": "SCALAR"},
        ],
        "bufferViews": [
            {"buffer": 0, "byteOffset": 0, "byteLength": points.nbytes, "target": ARRAY_BUFFER},
            {"buffer": 0, "byteOffset": points.nbytes, "byteLength": triangles.nbytes, "target": ELEMENT_ARRAY_BUFFER},
        ],
        "buffers": [
            {
                "byteLength": len(blob),
                "uri": "data:application/octet-stream;base64," + base64.b64encode(blob).decode("ascii"),
            }
        ],
    }
    if extensions:
        document["materials"][0]["extensions"] = extensions
        document["extensionsUsed"] = sorted(extensions)
    return document


def export_gltf(fit: Fit, path: str | os.PathLike, more: Mapping[str, Any] | None = None) -> None:
    """Write :func:`gltf_of`, one file with its sphere inside."""
    write_json(path, gltf_of(fit, more))


def read_gltf_material(path: str | os.PathLike) -> dict[str, Any]:
    """``pbrMetallicRoughness`` of the first material of a glTF file."""
    return dict(read_json(path)["materials"][0]["pbrMetallicRoughness"])
