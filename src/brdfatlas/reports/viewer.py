"""The interactive viewer's data: factors of the run's fits in one texture, environments as small lat-long maps.

Bagher et al. 2016 put the factors of all materials into one "uber-texture" and render straight from it (their Fig. 16
and appendix); so does this page. A row of ``WIDTH`` texels (rgb, float32) is one fit:

    texels    0 .. 271   D, F, G, rho_d, rho_s as in brdfatlas.uber_texture; G is all 0 for a fit without G. In the
                         alpha of D the cumulated mass of its cells, to draw samples from
    texels  272 .. 451   H at the centres of the phi_d cells (the naive model); 1 for all others

An environment is a lat-long map of constant cells: row j covers polar angles [j, j + 1) pi / h from +y, column i
azimuths [i, i + 1) 2 pi / w, seen along (sin p sin t, cos t, -cos p sin t).
"""

import base64
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from brdfatlas.angles import N_PHI_D, N_THETA_D, N_THETA_H
from brdfatlas.files import read_json, read_npz, write_text
from brdfatlas.fits import load_fit
from brdfatlas.models import MODELS
from brdfatlas.reports.data import SceneFacts
from brdfatlas.reports.pages import as_script, render_page
from brdfatlas.uber_texture import D_AT, F_AT, G_AT, RHO_D_AT, RHO_S_AT, WIDTH

N_NODES = RHO_D_AT - G_AT
H_AT = RHO_S_AT + 1
#: Rec. 709 luminance of linear rgb.
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])


def is_factored(parameters: Mapping[str, np.ndarray]) -> bool:
    """True for one-term factor fits, D F G G / (cos cos) or D F H: what the texture can hold."""
    shapes = {name: np.shape(value) for name, value in parameters.items()}
    tail = {"g": (3, N_NODES)}, {"h": (3, N_PHI_D)}
    base = {"rho_d": (3,), "rho_s": (3,), "d": (3, N_THETA_H), "f": (3, N_THETA_D)}
    return any(shapes == base | extra for extra in tail)


def factor_row(parameters: Mapping[str, np.ndarray]) -> np.ndarray:
    """One fit as a row of the texture, (WIDTH, 4) float32. ValueError for a fit that is not :func:`is_factored`."""
    if not is_factored(parameters):
        raise ValueError(f"not a one-term factor fit: {', '.join(parameters)}")
    row = np.zeros((WIDTH, 4), np.float32)
    row[D_AT:F_AT, :3] = np.asarray(parameters["d"]).T
    row[F_AT:G_AT, :3] = np.asarray(parameters["f"]).T
    row[G_AT:RHO_D_AT, :3] = np.asarray(parameters["g"]).T if "g" in parameters else 0
    row[H_AT : H_AT + N_PHI_D, :3] = np.asarray(parameters["h"]).T if "h" in parameters else 1
    row[RHO_D_AT, :3] = parameters["rho_d"]
    row[RHO_S_AT, :3] = parameters["rho_s"]
    # The mass of D cos(theta_h) in each cell, and a little everywhere so that no direction is out of reach.
    edges = (np.arange(N_THETA_H + 1) / N_THETA_H) ** 2 * (np.pi / 2)
    area = np.diff(np.sin(edges) ** 2)
    mass = area * (np.asarray(parameters["d"], float).T @ (LUMINANCE * np.asarray(parameters["rho_s"], float)))
    mass = mass / mass.sum() if mass.sum() > 0 else area
    mass = 0.98 * mass + 0.02 * area
    row[D_AT:F_AT, 3] = np.cumsum(mass) / mass.sum()
    return row


def shrink_environment(image: np.ndarray, height: int = 64) -> np.ndarray:
    """A lat-long image (h, w, 3) of the scenes' convention (rows at pi j / (h - 1), columns at cell centres) as a map
    of constant cells, (height, 2 height, 3) float32: means over each cell of the bilinear image, by solid angle."""
    rows, columns = image.shape[:2]
    fine_rows = max(2, round(2 * rows / height))
    fine_columns = max(2, round(columns / (2 * height)))
    theta = (np.arange(height * fine_rows) + 0.5) / (height * fine_rows) * np.pi
    phi = (np.arange(2 * height * fine_columns) + 0.5) / (2 * height * fine_columns) * columns - 0.5
    y = theta / np.pi * (rows - 1)
    low = np.minimum(y.astype(int), rows - 2)
    part = (y - low)[:, None, None]
    lines = image[low] * (1 - part) + image[low + 1] * part
    left = np.floor(phi).astype(int)
    share = (phi - left)[None, :, None]
    sampled = lines[:, left % columns] * (1 - share) + lines[:, (left + 1) % columns] * share
    weight = np.sin(theta)[:, None, None]
    cells = (sampled * weight).reshape(height, fine_rows, 2 * height, fine_columns, 3).sum((1, 3))
    area = weight.reshape(height, fine_rows, 1, 1).sum(1) * fine_columns
    return (cells / area).astype(np.float32)


def encode(array: np.ndarray, dtype: str = "<f4") -> str:
    """An array as base64 of its little-endian numbers."""
    return base64.b64encode(np.ascontiguousarray(array, dtype).tobytes()).decode("ascii")


def viewer_script(
    rows: Sequence[Mapping[str, Any]], texture: np.ndarray, environments: Mapping[str, np.ndarray]
) -> str:
    """``window.ATLAS_VIEWER_DATA``: the texture (rows, WIDTH, 4), what each row is, and the environments."""
    lights = [
        {"name": name, "height": len(image), "data": encode(np.minimum(image, 65504), "<f2")}
        for name, image in environments.items()
    ]
    content = {"width": WIDTH, "rows": list(rows), "texture": encode(texture), "environments": lights}
    return as_script("ATLAS_VIEWER_DATA", content)


def write_viewer(
    output: str | Path,
    *,
    data: str | Path,
    fits: Sequence[tuple[str, str | Path]],
    materials: Mapping[str, str | Path],
    scenes: Sequence[tuple[SceneFacts, str | Path]],
    textures: Sequence[str] = (),
    **links: bool,
) -> int:
    """Write the viewer page and its data; returns how many fits it shows.

    ``fits``: (model, path of the .npz, its report .json beside it); ``materials``: name -> description;
    ``scenes``: with the prepared scene's .npz that holds the environment; ``textures``: names of EXRs in ``data`` to
    link to. Fits that failed or do not factor are left out; a page without any says so.
    """
    described = {name: read_json(path) for name, path in materials.items()}
    rows, texels = [], []
    for model, path in fits:
        if read_json(Path(path).with_suffix(".json"))["status"] != "ok":
            continue
        fit = load_fit(path)
        if not is_factored(fit.parameters):
            continue
        facts = described[fit.material]
        label = {"material": fit.material, "title": str(facts.get("title") or fit.material), "model": model}
        rows.append(label | {"model_title": MODELS[model].title, "standin": bool(facts.get("standin"))})
        texels.append(factor_row(fit.parameters))
    texture = np.stack(texels) if texels else np.zeros((1, WIDTH, 4), np.float32)
    environments = {scene.name: shrink_environment(read_npz(path)["environment"]) for scene, path in scenes}
    write_text(Path(data) / "viewer.js", viewer_script(rows, texture, environments))
    tones = {scene.name: {"exposure": scene.exposure, "gamma": scene.gamma} for scene, _ in scenes}
    render_page(
        "viewer.html.j2",
        output,
        root="",
        here="viewer",
        rows=rows,
        tones=tones,
        textures=textures,
        **(links | {"viewer": True}),
    )
    return len(rows)
