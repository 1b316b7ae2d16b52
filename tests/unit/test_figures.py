"""The numbers behind the drawn figures, and that equal data give equal files."""

import re
from types import SimpleNamespace
from xml.etree import ElementTree

import numpy as np
import pandas as pd
import pytest
from matplotlib import pyplot

from brdfatlas import microfacet
from brdfatlas.angles import GRID_SHAPE, above_horizon, directions, grid_axes, theta_h_centres
from brdfatlas.figures import style
from brdfatlas.figures.curves import function_curves, plot_curves
from brdfatlas.figures.functions import grouped, plot_functions
from brdfatlas.figures.lobes import lobe, lobe_curves, outgoing_angles, plot_lobes
from brdfatlas.figures.pareto import pareto_figure
from brdfatlas.figures.summary import mean_errors, plot_summary
from brdfatlas.fits import Fit
from brdfatlas.measured import extend
from brdfatlas.measures.summary import Summary
from brdfatlas.models import MODELS
from brdfatlas.models.base import Function


def ggx_table(alpha: float = 0.2) -> np.ndarray:
    return Fit("ggx", "made", {"alpha": np.array([alpha]), "fresnel": np.full((90, 3), 0.5)}).table()


def dupuy_fit(model: str, alpha: float = 0.3) -> Fit:
    fresnel = np.linspace(0.1, 1, 90)[:, None] * [1.0, 0.9, 0.8]
    if model == "tabulated":
        return Fit(model, "made", {"ndf": microfacet.ggx_ndf(np.cos(theta_h_centres()), alpha), "fresnel": fresnel})
    return Fit(model, "made", {"alpha": np.array([alpha]), "fresnel": fresnel})


def test_the_lobe_of_a_white_surface_is_a_half_circle():
    table = np.full((*GRID_SHAPE, 3), 1 / np.pi)
    theta_o = outgoing_angles(np.deg2rad(40))
    np.testing.assert_allclose(lobe(table, np.deg2rad(40), theta_o), np.cbrt(1 / np.pi), rtol=1e-6)


@pytest.mark.parametrize("degrees", [15, 40, 65])
def test_a_highlight_points_in_the_mirror_direction_and_has_its_value(degrees):
    theta_i = np.deg2rad(degrees)
    table = np.nan_to_num(ggx_table(0.05))
    theta_o = outgoing_angles(theta_i)
    found = lobe(table, theta_i, theta_o)
    # a sharp lobe peaks at the mirror direction, up to the cell of theta_h = 0 and the slope of 1 / cos
    assert np.rad2deg(theta_o[np.argmax(found)]) == pytest.approx(degrees, abs=0.6)
    # at the peak: F D / (4 cos^2) G
    g1 = microfacet.ggx_g1(np.cos(theta_i), 0.05)
    expected = 0.5 / (np.pi * 0.05**2) * g1 / (2 - g1) / (4 * np.cos(theta_i) ** 2)
    assert found.max() ** 3 == pytest.approx(expected, rel=0.05)


def test_the_outgoing_angles_see_the_peak():
    theta_o = np.rad2deg(outgoing_angles(np.deg2rad(65.0)))
    assert np.all(np.diff(theta_o) > 0)
    assert np.abs(theta_o - 65).min() < 1e-6
    assert np.diff(theta_o)[np.abs(theta_o[:-1] - 65) < 3].max() < 0.11


def test_functions_are_those_the_models_evaluate():
    """F D G / (4 cos cos) put together from the drawn functions equals the model at the grid."""
    for model in ("tabulated", "gaussian", "ggx"):
        fit = dupuy_fit(model)
        own = {function.symbol: function for function in fit.functions()}
        theta_h, theta_d, phi_d = (a.ravel()[n] for a, n in zip(grid_axes(), (20, 30, 60)))
        wi, wo = directions(theta_h, theta_d, phi_d)
        g1_i, g1_o = (np.interp(np.arccos(v[2]), own["G1"].angle, own["G1"].values) for v in (wi, wo))
        g = g1_i * g1_o / (g1_i + g1_o - g1_i * g1_o)
        expected = own["F"].values[30] * own["D"].values[20] * g / (4 * wi[2] * wo[2])
        # G1 is interpolated between the drawn points
        np.testing.assert_allclose(fit.evaluate(wi, wo), expected, rtol=2e-3)


@pytest.mark.parametrize(
    "values", [[0, 0], [0.3, 0.3], [-1, 1], [-2, -2], [np.nan, 1], [np.nan, np.nan], [np.inf, 1], [0, 3e30]]
)
@pytest.mark.parametrize(("symbol", "axis"), [("F", "theta_d"), ("D", "theta_h"), ("H", "phi_d")])
def test_whatever_values_a_function_has_it_is_drawn(values, symbol, axis, tmp_path, monkeypatch):
    """Those of a model of one's own may be of any sign, and some may be no numbers."""
    function = Function(symbol, axis, np.array([0.1, 0.2]), np.array(values, float))
    fit = dupuy_fit("ggx")
    monkeypatch.setattr(Fit, "functions", lambda self: (function,))
    assert plot_functions(fit, tmp_path / "one.svg")
    assert plot_curves(function_curves({"ggx": fit.functions()}), {}, tmp_path / "all.svg") == (symbol != "H")


def test_models_without_functions_draw_nothing(tmp_path):
    fit = Fit("ward", "made", {"kd": np.zeros(3)})
    assert grouped(fit) == {}
    assert not plot_functions(fit, tmp_path / "no.svg")
    assert not (tmp_path / "no.svg").exists()


def errors_frame() -> pd.DataFrame:
    rows = [
        {"material": material, "model": model, "scene": scene, "status": "ok", "de00_mean": base * share + step}
        for material, base in (("b", 3), ("a", 2), ("c", 4))
        for model, share in (("ggx", 1), ("naive", 0.5), ("reference_again", 0.1))
        for scene, step in (("x", -0.1), ("y", 0.1))
    ]
    rows.append({"material": "a", "model": "broken", "scene": "x", "status": "failed", "de00_mean": np.nan})
    return pd.DataFrame(rows)


def test_errors_are_averaged_over_scenes_and_the_noise_floor_is_no_model():
    table = mean_errors(errors_frame())
    assert set(table.columns) == {"ggx", "naive", "broken"}
    assert table.loc["a", "naive"] == pytest.approx(1)
    assert np.isnan(table.loc["a", "broken"])
    with pytest.raises(ValueError, match="no column 'scene'"):
        mean_errors(errors_frame().drop(columns="scene"))


def test_curves_are_sorted_by_diffuseness_and_by_error(tmp_path):
    path = tmp_path / "summary.svg"
    plot_summary(errors_frame(), {"a": 0.3, "b": 0.1, "c": 0.2}, path, titles={"naive": "Naive"})
    texts = ["".join(node.itertext()).strip() for node in ElementTree.parse(path).iter() if node.tag.endswith("text")]
    names = [text for text in texts if text in "abc" and text]
    # above: by diffuseness; below: by the error of naive, whose median is the lowest
    assert names == ["b", "c", "a", "c", "b", "a"]
    assert "Naive" in texts
    assert "broken" not in texts
    # A model that is best but for one material leads the legend, as it leads the pages.
    spoilt = errors_frame()
    spoilt.loc[(spoilt["model"] == "naive") & (spoilt["material"] == "c"), "de00_mean"] = 100.0
    plot_summary(spoilt, {}, path)
    texts = ["".join(node.itertext()).strip() for node in ElementTree.parse(path).iter() if node.tag.endswith("text")]
    assert [text for text in texts if text in ("naive", "ggx")] == ["naive", "ggx"]


@pytest.mark.parametrize("length", [3, 60, 80])
def test_long_names_leave_the_plots_their_height(length, tmp_path, monkeypatch):
    heights = []
    monkeypatch.setattr(
        style, "save", lambda figure, path: heights.extend(a.bbox.height / figure.dpi for a in figure.axes)
    )
    errors = errors_frame()
    plot_summary(errors.assign(material=errors["material"].str.ljust(length, "x")), {}, tmp_path / "summary.svg")
    assert min(heights) > 1.5  # inches; upside down it is negative


@pytest.mark.parametrize("length", [20, 60, 200])
def test_a_plot_of_error_against_cost_is_wide_whatever_models_are_called(length, monkeypatch):
    titles = {name: f"Model, option {'x' * length} {name}" for name in "ab"}
    about = {"family": "ours", "status": "", "reciprocal": True, "targets": ()}
    models = {name: SimpleNamespace(title=title, **about) for name, title in titles.items()}
    picture = {"material": "m", "scene": "s", "status": "ok", "psnr_db": 20.0}
    errors = pd.DataFrame([picture | {"model": name, "de00_mean": n} for n, name in enumerate(models, 1)])
    fit = {"material": "m", "status": "ok", "seconds": 1.0, "max_albedo": 1.0}
    fits = pd.DataFrame([fit | {"model": name, "bytes": 100 / n} for n, name in enumerate(models, 1)])
    widths = []
    close = pyplot.close
    monkeypatch.setattr(
        pyplot, "close", lambda figure: widths.extend(a.bbox.width / figure.dpi for a in figure.axes) or close(figure)
    )
    pareto_figure(Summary(models, errors, fits, {"m": "glossy"}))
    assert min(widths) > 1  # inches
    assert len({style.short(title, 36) for title in titles.values()}) == 2


def test_equal_data_give_equal_files_and_formats_follow_the_ending(tmp_path):
    table, reference = (extend(ggx_table(alpha), above_horizon()) for alpha in (0.2, 0.25))
    lobes = lobe_curves(reference, [("ggx", table)])
    for name in ("1.svg", "2.svg", "1.png"):
        plot_lobes(lobes, {"ggx": "GGX"}, tmp_path / f"lobes{name}")
        assert plot_functions(dupuy_fit("ggx"), tmp_path / f"functions{name}")
        plot_summary(errors_frame(), {}, tmp_path / f"summary{name}")
    for kind in ("lobes", "functions", "summary"):
        first = (tmp_path / f"{kind}1.svg").read_bytes()
        assert first == (tmp_path / f"{kind}2.svg").read_bytes()
        assert b"<dc:date>" not in first
        ElementTree.fromstring(first)
        assert (tmp_path / f"{kind}1.png").read_bytes().startswith(b"\x89PNG")


def test_a_figure_does_not_depend_on_those_drawn_before_it(tmp_path):
    fits = [dupuy_fit(model, alpha) for model, alpha in (("ggx", 0.1), ("tabulated", 0.3), ("gaussian", 0.5))]
    for order in (fits, fits[::-1]):
        for fit in order:
            assert plot_functions(fit, tmp_path / f"{fit.model}-{order is fits}.svg")
    for fit in fits:
        once, again = (tmp_path / f"{fit.model}-{first}.svg" for first in (True, False))
        assert once.read_bytes() == again.read_bytes()


def test_lobes_bear_the_whole_title_of_every_model(tmp_path):
    """What tells two titles apart may be their last word."""
    lobes = lobe_curves(np.ones((*GRID_SHAPE, 3)), [])
    titles = {name: MODELS[name].title for name in MODELS}
    plot_lobes(lobes | {"models": dict.fromkeys(titles, lobes["reference"])}, titles, tmp_path / "lobes.svg")
    nodes = ElementTree.parse(tmp_path / "lobes.svg").iter()
    shown = " ".join("".join(node.itertext()).strip() for node in nodes if node.tag.endswith("text"))
    assert [title for title in titles.values() if title not in shown] == []


def test_lines_of_a_compact_svg_stay_within_a_twentieth_of_a_point():
    places = np.round(np.cumsum(np.random.default_rng(5).normal(0, 0.4, (300, 2)), 0), 6)
    line = " \n".join(f"{'L' if n else 'M'} {x} {y}" for n, (x, y) in enumerate(places))
    curve = '<path d="M 1.23456 2 C 3 4.5678 5 6 7 8 "/>'
    text = '<text x="1.23456" transform="rotate(-0 1 2)">0.12345</text>'
    svg = f'<g id="axes_1">\n <path d="{line} z"/>\n {curve}{text}</g>'
    short = style.compact(svg)
    assert short.endswith('<path d="M1.23 2C3 4.56 5 6 7 8"/><text x="1.23456">0.12345</text></g>')
    drawn = re.search(r'd="M(.*?)z"', short)[1]
    steps = np.array([step.split(" ") for step in drawn.split("l")], float)
    # Points that round to the same place are drawn once.
    rounded = np.round(places, 1)
    kept = np.r_[True, np.any(np.diff(rounded, axis=0) != 0, axis=1)]
    np.testing.assert_allclose(np.cumsum(steps, 0), rounded[kept], atol=1e-9)


def test_a_figure_without_content_says_so(tmp_path):
    with pytest.raises(ValueError, match=r"lobes\.svg: no fit"):
        plot_lobes(lobe_curves(np.ones((*GRID_SHAPE, 3)), []), {}, tmp_path / "lobes.svg")
    for rows in (errors_frame().iloc[:0], errors_frame().query("model == 'broken'")):
        plot_summary(rows, {}, tmp_path / "s.svg")  # else the page of standings would stay that of the last run
        assert "every fit or render failed" in (tmp_path / "s.svg").read_text()


def test_thirty_lines_differ():
    assert len({tuple(style.line_of(n).items()) for n in range(32)}) == 32
