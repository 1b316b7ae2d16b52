"""The named functions of all fits of a material as numbers. Its page draws them from a script, its PDF from
:func:`plot_curves`."""

import os
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from brdfatlas.constants import LUMINANCE
from brdfatlas.figures import style
from brdfatlas.figures.panel import Panel, boxes, decades, limits, linear, root_degrees
from brdfatlas.models.base import Function

#: What the page draws, by symbol: title, unit, whether on a logarithmic scale.
SHOWN = {"F": ("Fresnel F", "", False), "D": ("Normal distribution D", "1/sr", True), "G1": ("Shadowing G1", "", False)}
SHOWN |= {"G": ("Shadowing G", "", False)}
AXES = {"theta_h": "θh", "theta_d": "θd", "theta": "θ", "phi_d": "φd"}


def luminance_of(values: np.ndarray) -> np.ndarray:
    """(n,) of (n,) or (n, 3)."""
    values = np.asarray(values, float)
    return values @ LUMINANCE if values.ndim == 2 else values


def round_values(values: np.ndarray, digits: int = 4) -> list[float | None]:
    """For a script: significant digits, None where there is no number."""
    return [float(f"{v:.{digits}g}") if np.isfinite(v) else None for v in np.ravel(values)]


def function_curves(functions: Mapping[str, Sequence[Function]]) -> list[dict[str, Any]]:
    """One chart a symbol and axis: {title, axis, unit, log, models: {name: {x (degrees), y}}}; the sums over several
    functions of one symbol are not drawn, the first stands for them."""
    charts: dict[tuple[str, str], dict[str, Any]] = {}
    for symbol in SHOWN:
        for name, found in functions.items():
            for function in found:
                if function.symbol != symbol:
                    continue
                title, unit, log = SHOWN[symbol]
                about = {"title": title, "axis": AXES[function.axis], "unit": unit, "log": log, "models": {}}
                chart = charts.setdefault((symbol, function.axis), about)
                curve = {
                    "x": round_values(np.rad2deg(function.angle)),
                    "y": round_values(luminance_of(function.values)),
                }
                chart["models"].setdefault(name, curve)
    return list(charts.values())


def plot_curves(charts: Sequence[Mapping[str, Any]], titles: Mapping[str, str], path: str | os.PathLike) -> bool:
    """All charts of :func:`function_curves` side by side, every model a line, one legend below. Returns False, and
    writes nothing, without a chart."""
    if not charts:
        return False
    names = list(dict.fromkeys(name for chart in charts for name in chart["models"]))
    place = {name: i for i, name in enumerate(names)}
    with style.paper():
        legend = 0.14 * -(-len(names) // 3) + 0.1
        figure, lines = Figure(figsize=(style.PAGE, 2.3 + legend)), {}
        for box, chart in zip(boxes(figure, 1, len(charts), bottom=0.4 + legend, top=0.25), charts):
            curves = {name: np.array(curve["y"], float) for name, curve in chart["models"].items()}
            low, top = limits(curves.values())
            x = root_degrees() if chart["axis"] == AXES["theta_h"] else linear(0, 90, [0, 30, 60, 90])
            y = linear(0, top + 0.05 * (top - low) if top > 0 else 1, most=7)
            if chart["log"]:
                y = decades(top)
            panel = Panel(figure, box, x, y)
            panel.label(below=f"{chart['axis']} (degrees)", title=chart["title"])
            for name, values in curves.items():
                look = {"label": titles.get(name, name), "linewidth": 1.0} | style.line_of(place[name])
                lines[name] = panel.line(chart["models"][name]["x"], values, **look)
        figure.legend(lines.values(), [line.get_label() for line in lines.values()], loc="lower center", ncols=3)
        style.save(figure, path)
    return True
