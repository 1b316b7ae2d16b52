"""One look for drawn figures: white paper, colours that colour-blind readers tell apart, equal bytes for equal data."""

import os
import re
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import matplotlib

matplotlib.use("Agg")

import numpy as np
from matplotlib import pyplot
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullLocator

from brdfatlas.files import atomic_path

#: Okabe and Ito 2008, without black and yellow, which white paper swallows
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#6A3D9A", "#555555")
#: one cycle of line styles for each pass through the colours
LINES = ("-", "--", ":", "-.")
#: red, green and blue that also differ in lightness
RGB = ("#D55E00", "#009E73", "#0072B2")
INK = "#222222"
#: A logarithmic axis of an NDF begins at this share of its top: six decades hold all that is seen of a highlight.
LEAST = 1e-6
#: Width of a figure that fills a page of the PDF, inches: drawn at the size it is set at, so that type keeps its size.
PAGE = 7.16

RC = {
    "figure.facecolor": "white",
    "savefig.facecolor": "white",
    "axes.edgecolor": "#777777",
    "axes.labelcolor": INK,
    "text.color": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "axes.grid": True,
    "grid.color": "#E2E2E2",
    "grid.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "font.size": 7.5,
    "axes.titlesize": 8,
    # Matplotlib otherwise measures every tick's label for the height of a title.
    "axes.titley": 1.0,
    "legend.fontsize": 7,
    "legend.frameon": False,
    "lines.linewidth": 1.3,
    # Text stays text in an SVG: to draw every letter takes most of a small figure's bytes.
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans"],
    "svg.fonttype": "none",
    "svg.hashsalt": "brdfatlas",
    "path.simplify": True,
}


@contextmanager
def paper() -> Iterator[None]:
    """The settings of all figures, for the time of a block."""
    with matplotlib.rc_context(RC):
        yield


def line_of(number: int) -> dict[str, str]:
    """Colour and style of the n-th line of a figure; 32 differ."""
    return {"color": COLOURS[number % len(COLOURS)], "linestyle": LINES[number // len(COLOURS) % len(LINES)]}


def short(words: str, most: int) -> str:
    """At most so many characters: its ends, which tell titles with other options apart."""
    return words if len(words) <= most else f"{words[: most // 2 - 1]}…{words[len(words) - (most - most // 2) :]}"


#: Degrees with a tick on the root scale.
ROOT_TICKS = (0, 1, 5, 15, 30, 60, 90)


def root_axis(axis: Axes) -> None:
    """Angles on the root scale on which the measurements are spaced: a highlight gets the room it needs."""
    axis.set_xscale("function", functions=(lambda x: np.sqrt(np.maximum(x, 0)), np.square))
    axis.set_xticks(ROOT_TICKS)
    axis.set_xlim(0, 90)


def grid(
    rows: int,
    columns: int,
    size: tuple[float, float],
    *,
    left: float = 0.55,
    right: float = 0.1,
    bottom: float = 0.4,
    top: float = 0.1,
    gaps: tuple[float, float] = (0.55, 0.3),
) -> dict[str, float]:
    """Keywords of a GridSpec for margins and gaps (across, down) in inches on a figure of ``size``: to measure every
    text, as Matplotlib's layouts do, takes as long as to draw."""
    width, height = size
    each = (width - left - right - (columns - 1) * gaps[0]) / columns
    tall = (height - bottom - top - (rows - 1) * gaps[1]) / rows
    return {
        "left": left / width, "right": 1 - right / width, "bottom": bottom / height, "top": 1 - top / height,
        "wspace": gaps[0] / each, "hspace": gaps[1] / tall,
    }  # fmt: skip


def panels(
    rows: int, columns: int, size: tuple[float, float], *, shared: bool = False, **margins: Any
) -> tuple[Figure, np.ndarray]:
    """A figure of ``size`` and its axes (rows, columns); ``margins``: of :func:`grid`."""
    return pyplot.subplots(
        rows, columns, figsize=size, squeeze=False, sharex=shared, sharey=shared,
        gridspec_kw=grid(rows, columns, size, **margins),
    )  # fmt: skip


_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def power_of_ten(value: float, position: int | None = None) -> str:
    """A tick's label, 10⁻³, without the typesetting of formulas, which takes most of a figure's time."""
    return "10" + str(round(np.log10(value))).translate(_RAISED)


def log_axis(
    axis: Axes, low: float | None = None, high: float | None = None, *, along: str = "y", fine: bool = False
) -> None:
    """Logarithmic values with a tick at some powers of ten and none between; ``fine``, for values of one decade or two,
    at 1, 2 and 5 of each, as plain numbers."""
    axis.set(**{f"{along}scale": "log", f"{along}lim": (low, high)})
    ticks = axis.yaxis if along == "y" else axis.xaxis
    ticks.set_major_locator(LogLocator(subs=(1, 2, 5) if fine else (1,), numticks=6))
    ticks.set_minor_locator(NullLocator())
    ticks.set_major_formatter("{x:g}" if fine else power_of_ten)


def compact(svg: str) -> str:
    """An SVG with its lines drawn in steps, to a tenth of a point and with no rounding carried on, other paths to a
    hundredth, without space between tags, names of groups and turns by nothing: half its bytes."""

    def shorter(path: re.Match[str]) -> str:
        if set(re.findall("[A-Za-z]", path[1])) - set("MLz"):
            return re.sub(r"\s*([A-Za-z])\s*", r"\1", re.sub(r"(\.\d\d)\d+", r"\1", path[1].strip()))
        steps, at = [], (0, 0)
        for command, *place in re.findall(r"([MLz])(?:\s*(\S+)\s+([^\sMLz]+))?", path[1]):
            if command == "z":
                steps.append("z")
                continue
            to = (round(10 * float(place[0])), round(10 * float(place[1])))
            x, y = to if command == "M" else (to[0] - at[0], to[1] - at[1])
            if command == "M" or x or y:
                steps.append(f"{'M' if command == 'M' else 'l'}{x / 10:g} {y / 10:g}")
            at = to
        return re.sub(r"(?<!\d)0\.", ".", "".join(steps))

    svg = re.sub(r'(?<= d=")([^"]*)(?=")', shorter, svg)
    return re.sub(r'(?<=>)\s+(?=<)| id="\w+_\d+"| transform="rotate\(-0 [^"]*"', "", svg)


def save(figure: Figure, path: str | os.PathLike) -> None:
    """Write and close; the format by the path's ending, no date inside. Whole or not at all."""
    with atomic_path(path) as temporary:
        ending = temporary.suffix.lower()
        metadata = {".svg": dict.fromkeys(("Date", "Creator", "Format", "Type")), ".pdf": {"CreationDate": None}}.get(
            ending, {}
        )
        if ending == ".png":
            metadata = {"Software": None}
        figure.savefig(temporary, metadata=metadata or None, dpi=150)
        if ending == ".svg":
            temporary.write_text(compact(temporary.read_text(encoding="utf-8")), encoding="utf-8")
    pyplot.close(figure)
