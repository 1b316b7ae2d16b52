"""The five 3-lobe models: laws of the formulas, exact derivatives, recovery of known lobes, bad input."""

from functools import cache

import numpy as np
import pytest

from brdfatlas.angles import GRID_SHAPE, above_horizon, directions, grid_axes, half_difference
from brdfatlas.fits import fit
from brdfatlas.measured import Measured, fold
from brdfatlas.models import MODELS
from brdfatlas.models.base import FitError, Model
from brdfatlas.models.published import published_names, published_parameters
from brdfatlas.models.three_lobe.base import lobe_columns
from brdfatlas.objectives import cosine_weighted, loew_e2
from brdfatlas.pipeline.standins import make_standin

NAMES = ("ashikhmin_shirley", "cook_torrance", "edwards", "ward", "ward_duer")
QUICK = {"starts": 24, "follow": 3}


def pairs(count=400, seed=0, min_cosine=0.05):
    rng = np.random.default_rng(seed)
    d = rng.standard_normal((2, 4 * count, 3))
    d[..., 2] = np.abs(d[..., 2])
    wi, wo = d / np.linalg.norm(d, axis=-1, keepdims=True)
    keep = np.minimum(wi[:, 2], wo[:, 2]) > min_cosine
    return wi[keep][:count], wo[keep][:count]


def printed(name, p, wi, wo):
    """The supplement's equations, written once more from vectors, without half-difference angles."""
    h = wi + wo
    length = np.linalg.norm(h, axis=-1)
    nh, oh = h[:, 2] / length, np.sum(wo * h, -1) / length
    ni, no = wi[:, 2], wo[:, 2]
    tan = np.sqrt(1 - nh**2) / nh
    total = 0
    for j in range(3):
        s = {k: v[j] for k, v in p.items()}
        if name == "ashikhmin_shirley":
            F = s["f0"] + (1 - s["f0"]) * (1 - oh) ** 5
            lobe = (s["n"] + 1) / (2 * np.pi) * nh ** s["n"] * F / (4 * oh * np.maximum(ni, no))
        elif name == "cook_torrance":
            D = np.exp(-((tan / s["m"]) ** 2)) / (s["m"] ** 2 * nh**4)
            G = np.minimum(1, np.minimum(2 * nh * no / oh, 2 * nh * ni / oh))
            lobe = D * G * (s["f0"] + (1 - s["f0"]) * (1 - oh) ** 5) / (np.pi * no * ni)
        elif name == "edwards":
            r = np.hypot(h[:, 0], h[:, 1]) / s["R"]
            D = (s["n"] + 1) / (np.pi * s["R"] ** 2) * np.maximum(1 - r**2, 0) ** s["n"]
            lobe = D * (s["f0"] + (1 - s["f0"]) * (1 - no) ** 5) * length**2 / (4 * np.sum(wi * h, -1) ** 2 / length**2)
        else:
            D = np.exp(-((tan / s["alpha"]) ** 2)) / (4 * np.pi * s["alpha"] ** 2)
            lobe = D / (np.sqrt(no * ni) if name == "ward" else no * ni)
        total = total + lobe
    return p["kd"] / np.pi + total[:, None] * p["ks"]


@pytest.mark.parametrize("name", NAMES)
def test_evaluates_the_printed_equations(name):
    wi, wo = pairs()
    for material in published_names()[::20]:
        p = published_parameters(name, material)
        # nh ** n loses n / 1e16 by the rounding of nh, with n up to 5e6
        np.testing.assert_allclose(MODELS[name].evaluate(p, wi, wo), printed(name, p, wi, wo), rtol=1e-6, atol=1e-12)


@pytest.mark.parametrize("name", NAMES)
def test_grid_is_the_general_evaluation(name):
    model, p = MODELS[name], published_parameters(name, "alum-bronze")
    theta_h, theta_d, phi_d = grid_axes()
    fast = model.evaluate_grid(p)
    assert fast.dtype == np.float32
    assert np.isfinite(fast).all()
    rows = np.arange(0, 90, 11)
    wi, wo = directions(theta_h[rows], theta_d, phi_d)
    keep = above_horizon()[rows]
    # float32 storage, and float32 cosines where they are small
    np.testing.assert_allclose(fast[rows][keep], model.evaluate(p, wi[keep], wo[keep]), rtol=2e-5)


@pytest.mark.parametrize("name", NAMES)
def test_reciprocity_is_as_declared(name):
    model, p = MODELS[name], published_parameters(name, "chrome")
    wi, wo = pairs()
    forward, backward = model.evaluate(p, wi, wo), model.evaluate(p, wo, wi)
    error = np.max(np.abs(forward - backward) / np.maximum(forward + backward, 1e-30))
    assert (error < 1e-9) == model.reciprocal
    assert model.reciprocal == (name != "edwards")


def test_halfway_vector_identity_that_edwards_uses():
    """||wi + wo||^2 = 4 (wi·h)^2 and |H_uv| = 2 cos theta_d sin theta_h."""
    wi, wo = pairs()
    H = wi + wo
    h = H / np.linalg.norm(H, axis=-1, keepdims=True)
    np.testing.assert_allclose(np.sum(H * H, -1), 4 * np.sum(wi * h, -1) ** 2, rtol=1e-12)
    theta_h, theta_d, _ = half_difference(wi, wo)
    np.testing.assert_allclose(np.hypot(H[:, 0], H[:, 1]), 2 * np.cos(theta_d) * np.sin(theta_h), rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("name", NAMES)
def test_lobe_densities_are_normalised(name):
    """int D cos = 1 (Cook–Torrance: pi), int D = 1 for Ashikhmin–Shirley, 1 over the disk for Edwards, and
    int D / cos^3 = 1/4 for Ward: the constants of the print are the right ones."""
    model = MODELS[name]
    theta = (np.arange(20000) + 0.5) / 20000 * np.pi / 2
    step, sin, cos = np.pi / 2 / 20000, np.sin(theta), np.cos(theta)
    for value in (0.1, 0.4):
        shape = {"f0": 1.0, "m": value, "alpha": value, "n": 1 / value**2, "R": 2 * value}
        amplitude = model.amplitudes(shape, cos, sin, np.float64(1.0))[0][0]
        if name == "ashikhmin_shirley":  # amplitude = D F / 4 at cos theta_d = 1
            total = np.sum(4 * amplitude * sin) * step * 2 * np.pi
        elif name == "cook_torrance":
            total = np.sum(amplitude * cos * sin) * step * 2
        elif name == "edwards":  # r = 2 sin theta_h at cos theta_d = 1
            total = np.sum(amplitude * 2 * sin * 2 * cos) * step * 2 * np.pi
        else:
            total = 4 * np.sum(amplitude / cos**3 * sin) * step * 2 * np.pi
        assert total == pytest.approx(1, rel=1e-4)


@pytest.mark.parametrize("name", NAMES)
def test_derivatives_are_those_of_the_columns(name):
    """Analytic derivatives by the fitted vector against central differences, away from the disk's edge."""
    model = MODELS[name]
    rng = np.random.default_rng(1)
    first, last = model.box("first"), model.box("last")
    x = first + (0.3 + 0.4 * rng.random(first.size)) * (last - first)
    columns = lobe_columns(model, x, True)
    for j in range(x.size):
        shift = np.zeros_like(x)
        shift[j] = 1e-5
        numeric = (lobe_columns(model, x + shift, False)[0] - lobe_columns(model, x - shift, False)[0]) / 2e-5
        scale = np.abs(numeric).max()
        assert np.abs(columns[1 + j] - numeric).max() < 1e-4 * scale, (name, j)


TRUTH = {
    "ashikhmin_shirley": {"f0": [0.3, 0.1, 0.05], "n": [3000.0, 200.0, 10.0]},
    "cook_torrance": {"f0": [0.3, 0.1, 0.05], "m": [0.02, 0.1, 0.4]},
    "edwards": {"f0": [0.3, 0.1, 0.05], "R": [0.2, 0.5, 1.5], "n": [30.0, 8.0, 2.0]},
    "ward": {"alpha": [0.02, 0.1, 0.35]},
    "ward_duer": {"alpha": [0.02, 0.1, 0.35]},
}


def synthetic(name, noise=0.0):
    model = MODELS[name]
    p = {"kd": np.array([0.2, 0.1, 0.05]), "ks": np.array([0.1, 0.08, 0.12])}
    p |= {k: np.array(v) for k, v in TRUTH[name].items()}
    table = model.evaluate_grid(p)
    table *= np.exp(noise * np.random.default_rng(0).standard_normal(table.shape).astype(np.float32))
    table[~above_horizon()] = np.nan
    return Measured(f"synthetic-{name}", table), p


@pytest.mark.parametrize("name", NAMES)
def test_recovers_known_lobes(name):
    """Without noise the fit finds the lobes that made the material, kd and ks included."""
    measured, truth = synthetic(name)
    found = fit(name, measured, starts=64, follow=4)
    assert found.report["converged"]
    assert found.report["objective"] < 1e-7
    np.testing.assert_allclose(found.parameters["kd"], truth["kd"], rtol=1e-2)
    np.testing.assert_allclose(found.parameters["ks"], truth["ks"], rtol=3e-2)
    for key in TRUTH[name]:
        np.testing.assert_allclose(found.parameters[key], truth[key], rtol=5e-2, atol=5e-3)


@pytest.mark.parametrize("name", NAMES)
def test_fit_keeps_its_bounds_and_never_rises(name):
    model = MODELS[name]
    found = fit(name, standin("nickel"), **QUICK)
    for parameter in model.parameters:
        values = found.parameters[parameter.name]
        assert values.dtype == np.float32
        # a bound may round up in float32
        assert (values >= parameter.low * (1 - 1e-6)).all()
        assert (values <= parameter.high * (1 + 1e-6)).all()
    history = np.array(found.report["details"]["history"])
    assert (np.diff(history) <= 0).all()
    assert all(after <= before for before, after in found.report["details"]["starts"])


@pytest.mark.parametrize("objective", ["e2", "cosine"])
def test_each_objective_is_the_best_in_its_own_measure(objective):
    """The fit to a measure beats the fit to the default in that measure, on a material of no model's own."""
    measured = standin("red-specular-plastic")
    measure = {"e2": loew_e2, "cosine": cosine_weighted}[objective]
    own = fit("ward", measured, objective=objective, **QUICK)
    default = fit("ward", measured, **QUICK)
    assert measure(own.table(), measured.table) < measure(default.table(), measured.table)
    # what it says it reached is what it reached, with parameters rounded to float32
    assert own.report["objective"] == pytest.approx(measure(own.table(), measured.table), rel=1e-3)


def test_equal_seeds_give_equal_fits():
    measured = standin("pvc")
    first, second = (fit("ward_duer", measured, seed=4, **QUICK) for _ in range(2))
    for key, values in first.parameters.items():
        assert np.array_equal(values, second.parameters[key])


@cache
def standin(name):
    return make_standin(name)


def bad_material(kind):
    rng = np.random.default_rng(0)
    table = standin("maroon-plastic").table.copy()
    if kind == "dark channel":
        table[..., 1] = np.where(np.isnan(table[..., 1]), np.nan, 0)
    elif kind == "black":
        table = np.where(np.isnan(table), np.nan, 0).astype(np.float32)
    elif kind == "constant":
        table = np.where(np.isnan(table), np.nan, 0.2).astype(np.float32)
    elif kind == "single bright cell":
        table = np.where(np.isnan(table), np.nan, 0).astype(np.float32)
        table[0, 5, 90] = 1e5
    elif kind == "90 % invalid":
        table[rng.random(GRID_SHAPE) < 0.9] = np.nan
    elif kind == "outlier":
        table[20, 30, 90] = 1e6
    elif kind == "one valid cell":
        keep = table[10, 20, 90].copy()
        table[:] = np.nan
        table[10, 20, 90] = keep
    return Measured(kind, table)


KINDS = ("dark channel", "black", "constant", "single bright cell", "90 % invalid", "outlier", "one valid cell")
CASES = [(kind, name, "compressive") for kind in KINDS for name in ("ashikhmin_shirley", "edwards")]
CASES += [(kind, "ward", objective) for kind in KINDS[::3] for objective in ("e2", "cosine")]


@pytest.mark.parametrize(("kind", "name", "objective"), CASES)
def test_bad_input_gives_a_finite_fit_or_a_clear_error(kind, name, objective):
    measured = bad_material(kind)
    try:
        found = fit(name, measured, objective=objective, starts=8, follow=1)
    except FitError as error:
        if kind != "one valid cell" or measured.name not in str(error):
            raise
        return
    assert np.isfinite(found.report["objective"])
    table = fold(found.table())[above_horizon()]
    assert np.isfinite(table).all()
    assert (table >= 0).all()
    if kind == "constant":
        np.testing.assert_allclose(found.parameters["kd"], 0.2 * np.pi, rtol=0.02)
    if kind == "dark channel":
        assert np.abs(table[:, 1]).max() < 1e-6


def test_nothing_within_the_angles_is_a_clear_error():
    table = np.full((*GRID_SHAPE, 3), np.nan, np.float32)
    theta_h, _, _ = np.unravel_index(np.flatnonzero(above_horizon()), GRID_SHAPE)
    cell = np.flatnonzero(above_horizon())[np.argmax(theta_h)]  # the most grazing valid cell
    table.reshape(-1, 3)[cell] = 1.0
    with pytest.raises(FitError, match="ward on grazing"):
        fit("ward", Measured("grazing", table), starts=4, follow=1)


def test_base_class_evaluation_agrees_for_one_row():
    """The general slow evaluation of the base class is the same function."""
    model, p = MODELS["ward"], published_parameters("ward", "brass")
    fast = model.evaluate_grid(p)[3]
    theta_h, theta_d, phi_d = grid_axes()
    wi, wo = directions(theta_h[3], theta_d[0], phi_d[0])
    assert Model.evaluate_grid is not type(model).evaluate_grid
    keep = above_horizon()[3]
    np.testing.assert_allclose(fast[keep], model.evaluate(p, wi, wo)[keep], rtol=2e-5)
