"""Figures of Bagher et al. 2016 for any material and fit: slices, weights, convergence of the starts.

Each function writes one picture; the format follows the path's ending (svg, png, webp, pdf).
"""

import os
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.transforms import Bbox

from brdfatlas.angles import N_PHI_D, grid_cosines
from brdfatlas.figures import style
from brdfatlas.figures.panel import Panel, boxes, limits, linear, logarithmic, root_degrees
from brdfatlas.measured import Measured
from brdfatlas.objectives import compressive_weight, fast_median, importance_weight

NO_DATA = 0.85


def compressed(values: np.ndarray, median: float) -> np.ndarray:
    """The compressive tone map f(rho / median) ln 2 = 1 - 2^(-rho / median) (Eq. 12), in [0, 1)."""
    return -np.expm1(-np.log(2) * np.maximum(values, 0) / max(median, 1e-300))


#: Slices side by side: a WebP has at most 16,383 pixels a side.
COLUMNS = 16
#: phi_d of the slices, degrees.
SLICE = 90.0


def slice_of(table: np.ndarray) -> np.ndarray:
    """The cells (90, 90, 3) of a table (90, 90, 180 or 360, 3) at phi_d = SLICE; a copy, so that the table can go."""
    return table[:, :, int(SLICE / 180 * N_PHI_D)].copy()


def plot_slices(
    measured: Measured, slices: Mapping[str, np.ndarray], path: str | os.PathLike, *, title: str = ""
) -> None:
    """:func:`slice_of` of the reference and of each fit, under the compressive tone map (Fig. 5).

    theta_h to the right on the root scale of the grid, theta_d upwards. The tone map's median is the reference's in
    each channel. Grey where nothing was measured.
    """
    importance = importance_weight(measured.valid)
    if not importance.any():
        importance = measured.valid.astype(float)
    flat = importance.ravel()
    medians = [fast_median(np.where(flat > 0, rho, 0), flat) for rho in measured.table.reshape(-1, 3).T]
    valid = slice_of(measured.valid)
    pictures = {"reference (stand-in)" if measured.standin else "reference": slice_of(measured.table)}
    pictures |= slices
    with style.paper():
        columns = min(len(pictures), COLUMNS)
        rows = -(-len(pictures) // columns)
        figure = Figure(figsize=(1.75 * columns + 0.6, 2.5 * rows))
        places = _squares(figure, rows, columns, top=0.7 if title else 0.45)
        for box, (name, table) in zip(places, pictures.items()):
            picture = np.stack([compressed(table[..., c], medians[c]) for c in range(3)], -1)
            picture = np.where(valid[..., None], picture, NO_DATA)
            _map(figure, box, picture, textwrap.fill(name, 22), first=box in places[::columns])
        if title:
            figure.suptitle(title)
        style.save(figure, path)


def _squares(figure: Figure, rows: int, columns: int, **margins: float) -> list[Bbox]:
    """Places for so many maps, row by row."""
    places = boxes(figure, rows, columns, gaps=(0.15, 0.85), **margins)
    return [box.shrunk_to_aspect(1).anchored("C", box) for box in places]


def _map(figure: Figure, box: Bbox, picture: np.ndarray, title: str, *, first: bool) -> None:
    """A picture of the grid's cells (theta_h, theta_d, rgb in [0, 1]); degrees of theta_d beside the ``first``."""
    x = replace(root_degrees(), ticks=(1, 10, 30, 60, 90))
    panel = Panel(figure, box, x, linear(0, 90, most=5), named="xy" if first else "x")
    panel.image(np.clip(picture.swapaxes(0, 1), 0, 1))
    panel.label(below="θh (degrees)", left="θd (degrees)" if first else "", title=title)


def plot_weights(measured: Measured, path: str | os.PathLike, *, power: float = 1.4, title: str = "") -> None:
    """The three weights of the objective and their product (Fig. 3), green channel, over (theta_h, theta_d) at
    phi_d = 90 degrees, each against its largest; grey where no sample counts."""
    importance = importance_weight(measured.valid)
    cos_i, cos_o = grid_cosines()
    middle = N_PHI_D // 2
    keep = importance[:, :, middle] > 0
    importing = np.where(keep, (cos_i * cos_o)[:, :, middle], 0.0).astype(float)
    whole = compressive_weight(measured.table[..., 1], importance, power)[:, :, middle]
    safe = np.where(keep, importance[:, :, middle], 1.0)
    parts = {
        r"volume form $w_V$": safe / np.where(keep, importing, 1.0),
        r"importance $w_I$": importing,
        r"compressive $w_C$": whole / safe,
        r"product $w$": whole,
    }
    colours = ScalarMappable(Normalize(0, 1), "viridis")
    with style.paper():
        figure = Figure(figsize=(8.4, 2.4))
        places = _squares(figure, 1, 4, right=0.6, top=0.5 if title else 0.25)
        for box, (name, values) in zip(places, parts.items()):
            values = np.where(keep, values, 0)
            picture = colours.to_rgba(values / (values.max() or 1.0))[..., :3]
            _map(figure, box, np.where(keep[..., None], picture, NO_DATA), name, first=box is places[0])
        figure.colorbar(colours, cax=figure.add_axes((0.94, 0.2, 0.012, 0.65)))
        if title:
            figure.suptitle(title)
        style.save(figure, path)


def plot_convergence(channels: Sequence[Mapping[str, Any]], path: str | os.PathLike, *, title: str = "") -> bool:
    """The objective over the iterations of every start, a plot for each colour channel.

    ``channels``: ``details["channels"]`` of a fit's report; each with ``starts`` that have ``name`` and ``history``, or
    with a ``history`` alone. Returns False, and writes nothing, if there is no curve.
    """
    curves = []
    for channel in channels:
        starts = [s for s in channel.get("starts", ()) if s.get("history")]
        if not starts and channel.get("history"):
            starts = [{"name": "fit", "history": channel["history"]}]
        curves.append(starts)
    if not any(curves):
        return False
    drawn = []
    for starts in curves:
        drawn.append([])
        for start in starts:
            history = np.maximum(np.asarray(start["history"], float), 1e-16)
            # A thinned curve keeps its ends, so its length in iterations is known from the report.
            last = max(int(start.get("iterations", history.size - 1)), history.size - 1)
            drawn[-1].append((start["name"], np.linspace(0, last, history.size), history))
    longest = max(x[-1] for own in drawn for _, x, _ in own)
    low, high = limits(y for own in drawn for *_, y in own)
    margin = max(high / low, 10) ** 0.05
    x, y = linear(-0.05 * longest, max(1.05 * longest, 1), most=6), logarithmic(low / margin, high * margin)
    with style.paper():
        figure = Figure(figsize=(8.4, 2.7))
        places = boxes(figure, 1, len(curves), top=0.5 if title else 0.25, right=1.6, gaps=(0.2, 0))
        for number, (box, own, colour) in enumerate(zip(places, drawn, ("red", "green", "blue"))):
            panel = Panel(figure, box, x, y, named="x" if number else "xy")
            panel.label(below="iteration", left="" if number else "objective (relative)", title=colour)
            lines = [panel.line(*xy, label=name, **style.line_of(n)) for n, (name, *xy) in enumerate(own)]
            if lines and not number:
                figure.legend(lines, [name for name, *_ in own], loc="center right")
        if title:
            figure.suptitle(title)
        style.save(figure, path)
    return True
