"""Error against cost of all models, for the PDF; the site draws the same numbers in the browser (charts.js)."""

import io
import math
from collections.abc import Sequence

import numpy as np
from matplotlib import pyplot

from brdfatlas.figures import style
from brdfatlas.measures.summary import LEADING, Summary

#: Colour and marker of each family of models, as on the site.
FAMILIES = {
    "engine": ("#d55e00", "s"),
    "analytic": ("#0072b2", "o"),
    "tabulated": ("#7a7a00", "D"),
    "factored": ("#00805c", "^"),
    "ours": ("#8a3fa8", "v"),
}

#: Characters of a model's title beside a plot, which keeps more than an inch of width.
LONGEST = 36


def spread(heights: Sequence[float], gap: float) -> list[float]:
    """Descending ``heights`` moved apart to at least ``gap``, about their own middle, in the same order."""
    placed: list[float] = []
    for height in heights:
        placed.append(min(height, placed[-1] - gap) if placed else height)
    shift = sum(h - p for h, p in zip(heights, placed, strict=True)) / max(len(placed), 1)
    return [p + shift for p in placed]


def pareto_figure(summary: Summary) -> bytes:
    """Median ΔE00 over the materials against bytes and against seconds of one fit, both axes logarithmic, as SVG;
    empty if there is nothing to draw. The Pareto-optimal models are named in a column beside the plot. An error of 0
    has no place on the axis and stands at its lower end."""
    values = {name: summary.value(name) for name in summary.models}
    drawn = [name for name, value in values.items() if math.isfinite(value)]
    if not drawn:
        return b""
    end = min((values[name] for name in drawn if values[name] > 0), default=1.0) / 1.35
    values = {name: max(value, end) for name, value in values.items()}
    with style.paper():
        titles = {name: style.short(summary.models[name].title, LONGEST) for name in drawn}
        names = 0.25 + 0.05 * max(map(len, titles.values()))  # inches beside each plot
        figure, (both,) = style.panels(1, 2, (style.PAGE, 3.0), right=names, bottom=0.6, gaps=(names + 0.2, 0))
        both[1].sharey(both[0])
        for axes, key in zip(both, ("bytes", "seconds"), strict=True):
            points = {name: (summary.cost(name, key), values[name]) for name in drawn}
            points = {name: point for name, point in points.items() if point[0] > 0}
            front = [name for name in summary.front(key) if name in points]
            steps = np.reshape([points[name] for name in front], (-1, 2)).T
            axes.step(*steps, where="post", color="0.5", lw=0.8, ls=":")
            for name, point in points.items():
                colour, marker = FAMILIES[summary.models[name].family]
                filled = colour if name in front else "white"
                axes.plot(*point, marker, ms=4.5, color=colour, mfc=filled, label=summary.models[name].family)
            style.log_axis(axes, along="x")
            style.log_axis(axes, fine=True)
            axes.set_xlabel(f"{key} of one fit (median)")
            low, high = np.log(axes.get_ylim())
            order = sorted(front, key=lambda name: -points[name][1])
            heights = [(math.log(points[name][1]) - low) / (high - low) for name in order]
            for name, height in zip(order, spread(heights, 0.055), strict=True):
                axes.annotate(
                    titles[name].replace("$", r"\$"), points[name], (1.03, height),
                    textcoords="axes fraction", fontsize=6.5, va="center", annotation_clip=False,
                    arrowprops={"arrowstyle": "-", "lw": 0.3, "color": "0.6", "shrinkA": 1, "shrinkB": 2},
                )  # fmt: skip
        figure.axes[0].set_ylabel(f"{LEADING.label} (median)")
        handles = {line.get_label(): line for a in figure.axes for line in a.get_lines() if line.get_label()[0] != "_"}
        figure.legend(handles.values(), handles.keys(), loc="lower center", ncols=len(handles))
        stream = io.BytesIO()
        figure.savefig(stream, format="svg", metadata={"Date": None, "Creator": None})
        pyplot.close(figure)
        return stream.getvalue()
