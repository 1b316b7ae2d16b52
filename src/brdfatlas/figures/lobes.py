"""BRDF lobes in the incidence plane, fit against reference (as in Dupuy et al. 2015, supplemental)."""

import os
import textwrap
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle

from brdfatlas.constants import LUMINANCE
from brdfatlas.figures import style
from brdfatlas.figures.curves import round_values
from brdfatlas.figures.panel import Panel, boxes, linear, logarithmic
from brdfatlas.measured import look_up

#: incidence angles, degrees
INCIDENCE = (15, 40, 65)
#: Characters of a line of a plot's title.
TITLE = 28


def lobe(table: np.ndarray, theta_i: float, theta_o: np.ndarray) -> np.ndarray:
    """Cubic root of the luminance of a table without NaN (90, 90, 180, 3), 1/sr, in the incidence plane.

    ``theta_i`` and signed ``theta_o`` (n,) in radians; the mirror direction is theta_o = theta_i. Shape (n,).
    """
    wi = np.array([-np.sin(theta_i), 0.0, np.cos(theta_i)])
    wo = np.stack([np.sin(theta_o), np.zeros_like(theta_o), np.cos(theta_o)], -1)
    return np.cbrt(np.maximum(look_up(table, wi, wo) @ LUMINANCE, 0))


def outgoing_angles(theta_i: float) -> np.ndarray:
    """Signed theta_o in radians from -89 to 89 degrees: every degree, and ten a degree around the mirror direction."""
    coarse, fine = np.arange(-89, 89.5), np.arange(-4, 4.05, 0.1)
    degrees = np.concatenate([coarse, np.rad2deg(theta_i) + fine])
    return np.deg2rad(np.unique(np.round(degrees[np.abs(degrees) <= 89], 6)))


def lobe_values(table: np.ndarray, incidence: Sequence[float] = INCIDENCE) -> list[list[float | None]]:
    """Luminances (1/sr) of a table without NaN at :func:`outgoing_angles`, a list an incidence angle (degrees)."""
    angles = np.deg2rad(incidence)
    return [round_values(lobe(table, angle, outgoing_angles(angle)) ** 3, 3) for angle in angles]


def lobe_curves(
    reference: np.ndarray, tables: Iterable[tuple[str, np.ndarray]], incidence: Sequence[float] = INCIDENCE
) -> dict[str, Any]:
    """{incidence (degrees), x (outgoing angles a lobe, degrees), reference and models: luminances (1/sr) a lobe}, of
    tables (90, 90, 180 or 360, 3) in 1/sr without NaN; those of the models are taken one by one."""
    return {
        "incidence": list(incidence),
        "x": [round_values(np.rad2deg(outgoing_angles(angle))) for angle in np.deg2rad(incidence)],
        "reference": lobe_values(reference, incidence),
        "models": {name: lobe_values(table, incidence) for name, table in tables},
    }


def plot_lobes(
    curves: Mapping[str, Any], titles: Mapping[str, str], path: str | os.PathLike, *, columns: int = 5
) -> None:
    """A plot a model of what :func:`lobe_curves` gives, luminance (1/sr, logarithmic) over the signed outgoing angle:
    the reference filled, the fit as a line, one colour for each incidence angle. All share one scale, so that narrow
    and broad lobes can be read alike. ValueError without a model.
    """
    models, incidence = curves["models"], curves["incidence"]
    if not models:
        raise ValueError(f"{path}: no fit to draw lobes of")
    outgoing = [np.array(x) for x in curves["x"]]
    measured = [np.array(values, float) for values in curves["reference"]]
    top = max(max(float(r.max()) for r in measured), 1e-9)
    # The median of the darkest lobe lies well above the lower edge; seven decades are the most that can be read.
    low = max(min(float(np.median(r)) for r in measured) / 30, top * 1e-8)
    columns = min(columns, len(models))
    rows = -(-len(models) // columns)
    with style.paper():
        size = (style.PAGE, 1.12 * rows + 0.66)
        figure = Figure(figsize=size)
        places = boxes(figure, rows, columns, top=0.56, left=0.6, gaps=(0.08, 0.22))
        x, y = linear(-90, 90, [-60, 0, 60]), logarithmic(low, 4 * top)
        for number, (box, (name, lobes)) in enumerate(zip(places, models.items())):
            named = "x" * (number + columns >= len(models)) + "y" * (number % columns == 0)
            panel = Panel(figure, box, x, y, named=named)
            for n, (degrees, expected, fitted) in enumerate(zip(outgoing, measured, lobes)):
                colour = style.COLOURS[n]
                outline = [low, *np.maximum(expected, low), low]
                panel.fill([degrees[0], *degrees, degrees[-1]], outline, color=colour, alpha=0.22, linewidth=0)
                panel.line(degrees, np.maximum(np.array(fitted, float), low * 1e-3), color=colour, linewidth=0.9)
            lines = textwrap.wrap(titles.get(name, name), TITLE, max_lines=2, placeholder="…")
            panel.label(title="\n".join(lines), pad=2, fontsize=6.3 if len(lines) == 1 else 5.4, linespacing=1.0)
        handles, names = [], []
        for n, angle in enumerate(incidence):
            handles.append(Rectangle((0, 0), 1, 1, color=style.COLOURS[n], alpha=0.22))
            handles.append(Line2D([], [], color=style.COLOURS[n]))
            names += [f"reference, θi = {angle:g}°", f"fit, θi = {angle:g}°"]
        figure.supxlabel("outgoing angle (degrees)", fontsize=7.5, y=0.06 / size[1], va="bottom")
        figure.supylabel("BRDF (1/sr)", fontsize=7.5, x=0.06 / size[0], ha="left")
        figure.legend(handles, names, loc="upper center", ncols=len(incidence), columnspacing=1.2)
        style.save(figure, path)
