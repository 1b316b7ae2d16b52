"""The named functions of a fit, such as Fresnel, NDF and G1 (as in Dupuy et al. 2015, supplemental)."""

import os

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.transforms import Bbox

from brdfatlas.figures import style
from brdfatlas.figures.panel import Panel, boxes, decades, limits, linear, root_degrees
from brdfatlas.fits import Fit
from brdfatlas.models.base import Function

AXES = {
    "theta_h": "θh (degrees)",
    "theta_d": "θd (degrees)",
    "theta": "θ (degrees)",
    "phi_d": "φd (degrees)",
}


def plot_functions(fit: Fit, path: str | os.PathLike) -> bool:
    """A plot for each function of a fit, side by side; those of one symbol share a plot. rgb in red, green and blue.
    Those of all models together are functions.svg (figures.curves). Returns False, and writes nothing, for a model
    without functions.
    """
    plots = grouped(fit)
    if not plots:
        return False
    with style.paper():
        figure = Figure(figsize=(2.8 * len(plots), 2.5))
        for box, own in zip(boxes(figure, 1, len(plots)), plots.values()):
            _plot(figure, box, own)
        style.save(figure, path)
    return True


def grouped(fit: Fit) -> dict[tuple[str, str, str], list[Function]]:
    """The functions of a fit by symbol, axis and unit, in the model's order."""
    found: dict[tuple[str, str, str], list[Function]] = {}
    for function in fit.functions():
        found.setdefault((function.symbol, function.axis, function.unit), []).append(function)
    return found


def _plot(figure: Figure, box: Bbox, own: list[Function]) -> None:
    first = own[0]
    low, top = limits(function.values for function in own)
    margin = 0.05 * (top - low) or 0.05
    y = linear(low - margin, top + margin)
    if first.axis == "theta_h":  # spaced as the measurements are
        x = root_degrees()
        if low >= 0:
            y = decades(top)
    else:
        x = linear(0, 180, [0, 60, 120, 180]) if first.axis == "phi_d" else linear(0, 90, [0, 30, 60, 90])
        if low >= 0:
            y = linear(0, max(1.02, top * 1.02))
    panel = Panel(figure, box, x, y)
    unit = f" ({first.unit})" if first.unit else ""
    panel.label(below=AXES[first.axis], left=f"{first.symbol}{unit}")
    lines = [line for function in own for line in _curves(panel, function)]
    if first.values.ndim == 2:
        panel.legend(lines[:3])


def _curves(panel: Panel, function: Function) -> list[Line2D]:
    degrees = np.rad2deg(function.angle)
    if function.values.ndim == 1:
        return [panel.line(degrees, function.values, color=style.INK, zorder=3)]
    looks = zip("RGB", style.RGB, ("-", "--", ":"), function.values.T)
    return [panel.line(degrees, y, label=name, color=colour, linestyle=line) for name, colour, line, y in looks]
