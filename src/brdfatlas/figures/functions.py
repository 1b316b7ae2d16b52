"""The named functions of a fit, such as Fresnel, NDF and G1 (as in Dupuy et al. 2015, supplemental)."""

import os

import numpy as np
from matplotlib.axes import Axes

from brdfatlas.figures import style
from brdfatlas.fits import Fit
from brdfatlas.models.base import Function

AXES = {
    "theta_h": "θh (degrees)",
    "theta_d": "θd (degrees)",
    "theta": "θ (degrees)",
    "phi_d": "φd (degrees)",
}


def plot_functions(fit: Fit, path: str | os.PathLike, *, title: str = "") -> bool:
    """A plot for each function of a fit, side by side; those of one symbol share a plot. rgb in red, green and blue.
    Those of all models together are functions.svg (figures.curves). Returns False, and writes nothing, for a model
    without functions.
    """
    plots = grouped(fit)
    if not plots:
        return False
    with style.paper():
        figure, axes = style.panels(1, len(plots), (2.8 * len(plots), 2.5))
        for axis, own in zip(axes[0], plots.values()):
            _plot(axis, own, title or fit.entry)
        style.save(figure, path)
    return True


def grouped(fit: Fit) -> dict[tuple[str, str, str], list[Function]]:
    """The functions of a fit by symbol, axis and unit, in the model's order."""
    found: dict[tuple[str, str, str], list[Function]] = {}
    for function in fit.functions():
        found.setdefault((function.symbol, function.axis, function.unit), []).append(function)
    return found


def _plot(axis: Axes, own: list[Function], title: str) -> None:
    first = own[0]
    for number, function in enumerate(own):
        _curves(axis, function, title, label=number == 0)
    unit = f" ({first.unit})" if first.unit else ""
    axis.set(xlabel=AXES[first.axis], ylabel=f"{first.symbol}{unit}")
    top = max(float(function.values.max()) for function in own)
    low = min(float(function.values.min()) for function in own)
    if first.axis == "theta_h":  # spaced as the measurements are
        style.root_axis(axis)
        if low >= 0:
            style.log_axis(axis, max(top, 1e-12) * style.LEAST, max(top, 1e-12) * 2)
    else:
        axis.set_xticks([0, 30, 60, 90] if first.axis != "phi_d" else [0, 60, 120, 180])
        if low >= 0:
            axis.set_ylim(0, max(1.02, top * 1.02))
    axis.set_xlim(0, 180 if first.axis == "phi_d" else 90)
    if len(axis.get_legend_handles_labels()[0]) > 1:
        axis.legend()


def _curves(axis: Axes, function: Function, title: str, *, label: bool) -> None:
    degrees = np.rad2deg(function.angle)
    if function.values.ndim == 1:
        axis.plot(degrees, function.values, color=style.INK, label=title if label else None, zorder=3)
        return
    for channel, (colour, line) in enumerate(zip(style.RGB, ("-", "--", ":"))):
        name = "RGB"[channel] if label else None
        axis.plot(degrees, function.values[:, channel], color=colour, linestyle=line, label=name)
