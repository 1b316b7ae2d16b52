"""A panel puts values, ticks and words where Matplotlib's Axes would."""

import numpy as np
import pytest
from matplotlib.figure import Figure

from brdfatlas.figures import style
from brdfatlas.figures.panel import Panel, Scale, boxes, linear, logarithmic, root_degrees

SIZE = (5.0, 4.0)
MARGINS = {"left": 0.7, "right": 0.2, "bottom": 0.5, "top": 0.3, "gaps": (0.4, 0.6)}


def one_panel(x: Scale, y: Scale) -> Panel:
    figure = Figure(figsize=SIZE)
    return Panel(figure, next(boxes(figure, 1, 1, **MARGINS)), x, y)


@pytest.mark.parametrize("kind", ["linear", "logarithmic", "root"])
def test_values_and_ticks_lie_where_axes_have_them(kind):
    random = np.random.default_rng(1)
    with style.paper():
        figure, axes = style.panels(2, 3, SIZE, **MARGINS)
        for axis, box in zip(axes.flat, boxes(figure, 2, 3, **MARGINS)):
            low, high = np.sort(random.uniform(0.01, 500, 2))
            values = random.uniform(low, high, 20)
            axis.set(xlim=(0, 90), ylim=(low, high))
            x, y = linear(0, 90, [0, 90]), linear(low, high)
            if kind == "logarithmic":
                style.log_axis(axis, low, high)
                y = logarithmic(low, high)
            if kind == "root":
                style.root_axis(axis)
                x = root_degrees()
            panel = Panel(Figure(figsize=SIZE), box, x, y)
            angles = np.linspace(0, 90, 20)
            expected = axis.transData.transform(np.stack([angles, values], -1)) / figure.dpi
            np.testing.assert_allclose(panel.line(angles, values).get_xydata(), expected, atol=1e-9)
            if kind == "root":
                np.testing.assert_allclose(axis.get_xticks(), x.ticks)
            if kind == "logarithmic":
                ticks = axis.get_yticks()
                np.testing.assert_allclose(y.ticks, ticks[(ticks >= low) & (ticks <= high)])


@pytest.mark.parametrize(
    ("ticks", "words"),
    [
        ([0, 0.25, 0.5], ["0.00", "0.25", "0.50"]),
        ([-30, 0, 30], ["−30", "0", "30"]),
        ([-4e5, 0, 8e5], ["−4·10⁵", "0", "8·10⁵"]),
    ],
)
def test_words_at_ticks_are_short_and_have_equally_many_decimals(ticks, words):
    assert linear(ticks[0], ticks[-1], ticks).words() == words


def test_what_is_not_positive_lies_below_a_logarithmic_scale():
    assert (logarithmic(1e-3, 1).share([0.0, -1.0, 1e-4]) < 0).all()
    assert np.isnan(logarithmic(1e-3, 1).share([np.nan])).all()


def test_names_of_curves_keep_clear_of_them():
    with style.paper():
        for corner in ([0.9, 1], [0, 0.1]):
            for side in ([0.9, 1], [0, 0.1]):
                panel = one_panel(linear(0, 1), linear(0, 1))
                crowd = panel.line(np.linspace(*side, 50), np.linspace(*corner, 50), label="R", color="red")
                before = set(panel.figure.texts)
                panel.legend([crowd])
                (name,) = set(panel.figure.texts) - before
                place = (np.array(name.get_position()) - panel.box.p0) / panel.box.size
                assert np.abs(place - [np.mean(side), np.mean(corner)]).max() > 0.3
