"""The interactive viewer's data: factors of the run's fits in one texture, environments as small lat-long maps, the
statue as a field of distances. The reference and the fits that are no sums of products have tables instead
(figures.tables), which the page loads when they are chosen.

Bagher et al. 2016 put the factors of all materials into one "uber-texture" and render straight from it (their Fig. 16
and appendix); so does this page. A fit is as many rows of ``WIDTH`` texels (rgb, float32) as it has products:

    texels    0 .. 271   D, F, G, rho_d, rho_s as in export.uber_texture, G, rho_d and rho_s in the first row; G is
                         all 0 for a fit without G. In the alpha of the first D the cumulated mass of its cells, to draw
                         samples from
    texels  272 .. 451   H at the centres of the phi_d cells (the naive model); 1 for all others

An environment is a lat-long map of constant cells: row j covers polar angles [j, j + 1) pi / h from +y, column i
azimuths [i, i + 1) 2 pi / w, seen along (sin p sin t, cos t, -cos p sin t).
"""

import base64
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from brdfatlas.angles import N_PHI_D, N_THETA_H
from brdfatlas.constants import ABSENT, LUMINANCE, REFERENCE
from brdfatlas.export.uber_texture import D_AT, F_AT, G_AT, RHO_D_AT, RHO_S_AT, WIDTH
from brdfatlas.figures.tables import has_few_products
from brdfatlas.files import read_npz, read_record, write_text
from brdfatlas.fits import load_fit
from brdfatlas.models import MODELS
from brdfatlas.models.base import Factors
from brdfatlas.reports.data import SceneFacts
from brdfatlas.reports.pages import as_script, render_page

H_AT = RHO_S_AT + 1


def factor_rows(factors: Factors | None) -> np.ndarray | None:
    """One fit as rows of the texture, (products, WIDTH, 4) float32; None for a fit that is no sum of products, or of
    too many."""
    if not has_few_products(factors):
        return None
    d, f = factors.d, factors.f
    rho_s = np.ones(3) if factors.rho_s is None else factors.rho_s
    rows = np.zeros((d.shape[1], WIDTH, 4), np.float32)
    rows[:, D_AT:F_AT, :3] = np.moveaxis(d, 0, -1)
    rows[:, F_AT:G_AT, :3] = np.moveaxis(f, 0, -1)
    rows[0, G_AT:RHO_D_AT, :3] = 0 if factors.g is None else factors.g.T
    rows[0, H_AT : H_AT + N_PHI_D, :3] = 1 if factors.h is None else factors.h.T
    rows[0, RHO_D_AT, :3], rows[0, RHO_S_AT, :3] = factors.rho_d, rho_s
    # The mass of D cos(theta_h) in each cell, and a little everywhere so that no direction is out of reach. Several
    # products: that of their sum where it is seen most, at theta_d = 0.
    edges = (np.arange(N_THETA_H + 1) / N_THETA_H) ** 2 * (np.pi / 2)
    area = np.diff(np.sin(edges) ** 2)
    peak = np.maximum((d * f[:, :, :1]).sum(1), 0) if d.shape[1] > 1 else d[:, 0]
    mass = area * (peak.T @ (LUMINANCE * rho_s))
    mass = mass / mass.sum() if mass.sum() > 0 else area
    mass = 0.98 * mass + 0.02 * area
    rows[0, D_AT:F_AT, 3] = np.cumsum(mass) / mass.sum()
    return rows


def statue_grid(resolution: int = 64) -> dict[str, Any]:
    """The statue of the scenes as distances on a grid, 2 high about the origin: counts, corner, step and values
    (float16, x fastest)."""
    from brdfatlas.rendering.statue import statue_field

    field, low, step = statue_field(resolution)
    # Where the surface begins and ends along y, between grid points.
    columns = np.nonzero((field < 0).any((0, 2)))[0]
    inside = field[:, columns[0] - 1 : columns[-1] + 2].min((0, 2))
    bottom = low[1] + step * (columns[0] - 1 + inside[0] / (inside[0] - inside[1]))
    top = low[1] + step * (columns[-1] + inside[-2] / (inside[-2] - inside[-1]))
    scale = 2 / (top - bottom)
    corner = (low - [0, bottom, 0]) * scale - [0, 1, 0]
    values = np.moveaxis(field * scale, (0, 1, 2), (2, 1, 0))
    return {
        "counts": list(field.shape),
        "low": corner.tolist(),
        "step": step * scale,
        "data": encode(values, "<f2"),
    }


def shrink_environment(image: np.ndarray, height: int = 128) -> np.ndarray:
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
    materials: Sequence[Mapping[str, Any]],
    models: Mapping[str, str],
    fits: Mapping[str, Any],
    texture: np.ndarray,
    environments: Mapping[str, np.ndarray],
) -> str:
    """``window.ATLAS_VIEWER_DATA``: materials, models (name -> title), what there is of a fit ("material/model" -> its
    first row and number of products, or why it is not shown; one with a table is not listed), the texture (rows,
    WIDTH, 4), the environments and the statue."""
    lights = [
        {"name": name, "height": len(image), "data": encode(np.minimum(image, 65504), "<f2")}
        for name, image in environments.items()
    ]
    shown = [{"name": name, "title": title} for name, title in models.items()]
    content = {"materials": list(materials), "models": shown, "fits": dict(fits)}
    content |= {"width": WIDTH, "height": len(texture), "texture": encode(texture)}
    return as_script("ATLAS_VIEWER_DATA", content | {"environments": lights, "statue": statue_grid()})


def write_viewer(
    output: str | Path,
    *,
    data: str | Path,
    fits: Sequence[tuple[str, str, str | Path]],
    materials: Mapping[str, str | Path],
    scenes: Sequence[tuple[SceneFacts, str | Path]],
    textures: Sequence[str] = (),
    **links: bool,
) -> dict[str, int]:
    """Write the viewer page and its data; returns how many fits it shows by factors and by tables, and how many not.

    ``fits``: (material, model, path of the .npz, its report .json beside it); ``materials``: name -> description;
    ``scenes``: with the prepared scene's .npz that holds the environment; ``textures``: names of EXRs in ``data`` to
    link to. Of a fit that failed the page says why.
    """
    described = {name: read_record(path, "name") for name, path in materials.items()}
    titles, found, texels = {REFERENCE: "reference"}, {}, []
    counts = {"factors": 0, "tables": 0, "failed": 0}
    for material, model, path in fits:
        titles.setdefault(model, MODELS[model].title)
        report = read_record(Path(path).with_suffix(".json"), "status")
        if report["status"] != "ok":
            found[f"{material}/{model}"] = " ".join(str(report.get("reason") or "the fit failed").split())
            counts["failed"] += report["status"] != ABSENT
            continue
        rows = factor_rows(load_fit(path).factors())
        counts["factors" if rows is not None else "tables"] += 1
        if rows is not None:
            found[f"{material}/{model}"] = [sum(map(len, texels)), len(rows)]
            texels.append(rows)
    texture = np.concatenate(texels) if texels else np.zeros((1, WIDTH, 4), np.float32)
    environments = {scene.name: shrink_environment(read_npz(path)["environment"]) for scene, path in scenes}
    told = [
        {"name": name, "title": str(facts.get("title") or name), "standin": bool(facts.get("standin"))}
        for name, facts in described.items()
    ]
    write_text(Path(data) / "viewer.js", viewer_script(told, titles, found, texture, environments))
    tones = {scene.name: {"exposure": scene.exposure, "gamma": scene.gamma} for scene, _ in scenes}
    render_page(
        "viewer.html.j2",
        output,
        root="",
        here="viewer",
        materials=told,
        counts=counts,
        tones=tones,
        textures=textures,
        **(links | {"viewer": True}),
    )
    return counts
