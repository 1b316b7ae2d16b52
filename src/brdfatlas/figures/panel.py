"""Frames with ticks, curves and words of a few artists each: Matplotlib's Axes, which also serve to pan and to choose
limits, take most of the time of a figure of many small plots."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.gridspec import GridSpec
from matplotlib.image import BboxImage
from matplotlib.lines import Line2D
from matplotlib.patches import PathPatch, Polygon
from matplotlib.path import Path
from matplotlib.text import Text
from matplotlib.ticker import LogLocator, MaxNLocator
from matplotlib.transforms import Bbox, TransformedBbox

from brdfatlas.figures import style

#: Points: length of a tick's mark; from the frame to the words of the ticks, left and down, and down to those of the
#: axis; from the middle of a digit down to its baseline.
MARK, PAD, WORDS, AXIS, MIDDLE = 3.5, 7.0, 12.7, 24.3, 2.85


@dataclass(frozen=True)
class Scale:
    """One direction of a panel: limits, ticks, the words at them, and what puts its values (n,) on an even scale."""

    low: float
    high: float
    ticks: Sequence[float]
    word: Callable[[float], str] = "{:g}".format
    even: Callable[[np.ndarray], np.ndarray] = np.asarray

    def share(self, values: Any) -> np.ndarray:
        """How far between the limits, 0 to 1, values (n,) lie."""
        low, high = self.even(np.array([self.low, self.high], float))
        return (self.even(np.asarray(values, float)) - low) / (high - low)

    def words(self) -> list[str]:
        """What stands at the ticks."""
        return [self.word(tick).replace("-", "−") for tick in self.ticks]


def limits(arrays: Iterable[Any]) -> tuple[float, float]:
    """The least and the largest finite value of arrays of any shape; 0 and 1 where there is none."""
    values = np.concatenate([np.ravel(np.asarray(array, float)) for array in arrays])
    values = values[np.isfinite(values)]
    return (float(values.min()), float(values.max())) if values.size else (0.0, 1.0)


def linear(low: float, high: float, ticks: Sequence[float] | None = None, *, most: int = 9) -> Scale:
    """An even scale; without ``ticks`` with at most so many intervals between round numbers."""
    if ticks is None:
        ticks = _within(MaxNLocator(most, steps=[1, 2, 2.5, 5, 10]).tick_values(low, high), low, high)
    return Scale(low, high, ticks, _words(np.array(ticks)))


def _words(ticks: np.ndarray) -> Callable[[float], str]:
    """Numbers with equally many decimals; large ones as a number times a power of ten, which has room."""
    power = int(np.log10(max(np.abs(ticks).max(initial=0), 1)))
    if power >= 4:
        return lambda value: f"{value / 10.0**power:g}·{style.power_of_ten(10.0**power)}" if value else "0"
    decimals = next(d for d in range(9) if np.allclose(ticks, np.round(ticks, d), rtol=0, atol=1e-9) or d == 8)
    return f"{{:.{decimals}f}}".format


def root_degrees() -> Scale:
    """Angles as in :func:`brdfatlas.figures.style.root_axis`."""
    return Scale(0, 90, style.ROOT_TICKS, even=lambda x: np.sqrt(np.maximum(x, 0)))


def logarithmic(low: float, high: float) -> Scale:
    """A tick at some powers of ten, as in :func:`brdfatlas.figures.style.log_axis`; what is not positive lies far
    below."""
    ticks = _within(LogLocator(numticks=6).tick_values(low, high), low, high)
    return Scale(low, high, ticks, style.power_of_ten, lambda values: np.log10(np.maximum(values, 1e-300)))


def decades(top: float) -> Scale:
    """Logarithmic, from style.LEAST of ``top`` to twice of it."""
    top = max(top, 1e-12)
    return logarithmic(top * style.LEAST, top * 2)


def _within(ticks: Sequence[float], low: float, high: float) -> list[float]:
    slack = 1e-9 * (high - low)
    return [float(tick) for tick in ticks if low - slack <= tick <= high + slack]


def boxes(figure: Figure, rows: int, columns: int, **margins: Any) -> Iterator[Bbox]:
    """Where the panels of a figure are, in inches, row by row; ``margins``: of :func:`brdfatlas.figures.style.grid`."""
    size = figure.get_size_inches()
    grid = GridSpec(rows, columns, **style.grid(rows, columns, size, **margins))
    below, above, left, right = grid.get_grid_positions(figure)
    for low, high in zip(below, above):
        for start, end in zip(left, right):
            yield Bbox(np.array([[start, low], [end, high]]) * size)


class Panel:
    """A frame at ``box`` (inches) of a figure with ticks, grid and, for directions in ``named``, words at the ticks.
    Made and drawn within :func:`brdfatlas.figures.style.paper`."""

    def __init__(self, figure: Figure, box: Bbox, x: Scale, y: Scale, *, named: str = "xy"):
        self.figure, self.x, self.y, self.box = figure, x, y, box
        self.inches = figure.dpi_scale_trans
        self.clip = TransformedBbox(box, self.inches)
        self.curves: list[np.ndarray] = []
        (x0, y0), (x1, y1), mark = box.p0, box.p1, MARK / 72
        across = [x0 + share * box.width for share in x.share(x.ticks)]
        up = [y0 + share * box.height for share in y.share(y.ticks)]
        grid = [((at, y0), (at, y1)) for at in across] + [((x0, at), (x1, at)) for at in up]
        self._strokes(grid, color="#E2E2E2", linewidth=0.6, zorder=1.5)
        marks = [((at, y0), (at, y0 - mark)) for at in across] + [((x0, at), (x0 - mark, at)) for at in up]
        self._strokes(marks, color=style.INK, linewidth=0.8, zorder=2.5)
        self._strokes([((x0, y1), (x0, y0)), ((x0, y0), (x1, y0))], color="#777777", linewidth=0.8, zorder=2.5)
        if "x" in named:
            for at, words in zip(across, x.words()):
                self.text(at, y0 - WORDS / 72, words, ha="center")
        if "y" in named:
            for at, words in zip(up, y.words()):
                self.text(x0 - PAD / 72, at - MIDDLE / 72, words, ha="right")

    def _strokes(self, strokes: Sequence[tuple], **look: Any) -> None:
        """Straight lines as one path."""
        codes = [Path.MOVETO, Path.LINETO] * len(strokes)
        path = Path(np.reshape(strokes, (-1, 2)), codes)
        self.figure.add_artist(PathPatch(path, fill=False, transform=self.inches, **look))

    def text(self, x: float, y: float, words: str, **look: Any) -> Text:
        """Words with their baseline at a place in inches."""
        return self.figure.text(x, y, words, transform=self.inches, va="baseline", **look)

    def _place(self, x: Any, y: Any) -> np.ndarray:
        shares = np.stack([self.x.share(x), self.y.share(y)], -1)
        self.curves.append(shares)
        return self.box.p0 + shares * self.box.size

    def line(self, x: Any, y: Any, **look: Any) -> Line2D:
        """A curve through values (n,) of both directions; NaN breaks it."""
        line = Line2D(*self._place(x, y).T, transform=self.inches, clip_box=self.clip, **look)
        return self.figure.add_artist(line)

    def fill(self, x: Any, y: Any, **look: Any) -> Polygon:
        """An area with corners at values (n,) of both directions."""
        area = Polygon(self._place(x, y), transform=self.inches, clip_box=self.clip, **look)
        return self.figure.add_artist(area)

    def image(self, picture: np.ndarray) -> BboxImage:
        """A picture (rows, columns, 3) in [0, 1] all over the panel, its first row below."""
        image = BboxImage(self.clip, origin="lower", interpolation="nearest", zorder=2, data=picture)
        return self.figure.add_artist(image)

    def label(self, *, below: str = "", left: str = "", title: str = "", pad: float = 6.0, **look: Any) -> None:
        """Words below the axis across, left of the axis upwards, and ``pad`` points above; ``look``: of those above."""
        middle, height = (self.box.x0 + self.box.x1) / 2, (self.box.y0 + self.box.y1) / 2
        if below:
            self.text(middle, self.box.y0 - AXIS / 72, below, ha="center")
        if left:
            widest = max(map(len, self.y.words()), default=0)
            x = self.box.x0 - min(12 + 4.5 * widest, 34) / 72
            self.text(x, height, left, ha="center", rotation=90, rotation_mode="anchor")
        if title:
            self.text(middle, self.box.y1 + pad / 72, title, ha="center", **({"fontsize": 8} | look))

    def legend(self, lines: Sequence[Line2D]) -> None:
        """Names of one letter inside the panel, where the fewest points of curves are."""
        row = 10.5 / 72
        extent = np.array([0.47, row * len(lines) + 0.08]) / self.box.size
        places = [np.array(place) * (1 - extent) for place in ((1, 1), (0, 1), (0, 0), (1, 0), (1, 0.5), (0, 0.5))]
        points = np.concatenate(self.curves)

        def covered(place: np.ndarray) -> int:
            return int(((points > place) & (points < place + extent)).all(-1).sum())

        x, y = self.box.p0 + min(places, key=covered) * self.box.size
        for n, line in enumerate(reversed(lines)):
            at = y + 0.04 + row * n
            self.text(x + 0.33, at, str(line.get_label()), fontsize=7)
            look = {"color": line.get_color(), "linestyle": line.get_linestyle(), "transform": self.inches}
            self.figure.add_artist(Line2D([x + 0.08, x + 0.27], [at + 0.036] * 2, **look))
