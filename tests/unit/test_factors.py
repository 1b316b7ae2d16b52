"""Laws of the factor microfacet models: exact reductions, monotone objectives, recovery, containment, bad input."""

import importlib.util
import sys
from pathlib import Path

import numpy as np
import pytest

from brdfatlas import microfacet
from brdfatlas.angles import GRID_SHAPE, above_horizon, directions, grid_cosines, theta_d_centres, theta_h_centres
from brdfatlas.constants import MAX_ANGLE
from brdfatlas.fits import fit
from brdfatlas.measured import Measured
from brdfatlas.measures.physics import directional_albedo
from brdfatlas.models import MODELS
from brdfatlas.models.bagher2016 import microfacet_factors
from brdfatlas.models.bagher2016.awls import Channel, Geometry, g_nodes, node_cosines, pair_sums
from brdfatlas.models.bagher2016.factors import grid_microfacet
from brdfatlas.models.bagher2016.microfacet_factors import (
    FactorProblem,
    TableProblem,
    best_rows,
    g_from_d,
    g_from_d_derivative,
    smoothing_matrix,
)
from brdfatlas.models.bagher2016.naive_factors import NaiveProblem
from brdfatlas.models.base import FitError
from brdfatlas.objectives import compressive_weights, relative_objective
from brdfatlas.solvers.acceleration import Trace, accelerate, alternate

PLAIN = Path(__file__).parents[2] / "benchmarks" / "plain_factors.py"
specification = importlib.util.spec_from_file_location("plain_factors", PLAIN)
plain = importlib.util.module_from_spec(specification)
sys.modules["plain_factors"] = plain
specification.loader.exec_module(plain)

ITERATIVE = ("naive", "g_from_d", "independent_g", "bivariate_g", "low_rank_2", "low_rank_4")
ALL = (*ITERATIVE, "bivariate")


def planted(roughness=0.2) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """M (90, 90), G (90), rho_d of a smooth glossy surface."""
    d = microfacet.ggx_ndf(np.cos(theta_h_centres()), roughness)
    f = 0.05 + 0.95 * (1 - np.cos(theta_d_centres())) ** 5
    g = node_cosines() ** 0.3
    return np.outer(d / d.max(), f) * 2, g, 0.05


def material(*, share=0.03, noise=0.05, symmetric=False, seed=1, table=None) -> Measured:
    """A glossy surface that is not quite a product, with multiplicative noise, measured in a share of the cells, so
    that a fit takes a moment."""
    random = np.random.default_rng(seed)
    if table is None:
        m, g, rho_d = planted()
        theta_h, theta_d = theta_h_centres()[:, None], theta_d_centres()[None, :]
        m = m * (1 + 0.3 * np.sin(3 * theta_h) * np.cos(2 * theta_d))
        table = grid_microfacet(np.stack([m, 0.8 * m, 0.5 * m]), np.stack([g] * 3), np.array([rho_d, 0.04, 0.02]))
        table = table * np.exp(noise * random.standard_normal(table.shape))
    keep = random.uniform(size=GRID_SHAPE) < share
    if symmetric:
        keep, table = keep | keep[..., ::-1], 0.5 * (table + table[:, :, ::-1])
    table = np.where((keep & above_horizon())[..., None], table, np.nan).astype(np.float32)
    return Measured("planted", table)


def quick(name: str) -> dict:
    """Options that leave out the eight starts."""
    return {"starts": "slices"} if name == "independent_g" else {}


@pytest.fixture(scope="module")
def fitted(noisy):
    """Fits of ``noisy`` by model, each made once."""
    found = {}

    def of(name):
        if name not in found:
            found[name] = fit(name, noisy, **quick(name))
        return found[name]

    return of


def channel_of(measured: Measured, c=0):
    weights = compressive_weights(measured.table)
    geometry = Geometry.of(weights[..., 0] > 0)
    return weights[..., c], Channel.of(geometry, weights[..., c], measured.table[..., c])


def brute(measured, weights, m, g, rho_d, c=0):
    """sum w (f - rho)^2 over the samples, without merging, cos and G interpolated by NumPy."""
    cos_i, cos_o = (a.astype(float) for a in np.broadcast_arrays(*grid_cosines()))
    keep = weights > 0
    h, d, _ = np.nonzero(keep)
    f = m[h, d]
    for cosine in (cos_i, cos_o):
        theta = np.arccos(cosine[keep])
        f = f * np.interp(theta, g_nodes(), g) / np.interp(theta, g_nodes(), node_cosines())
    return float((weights[keep] * (rho_d + f - measured.table[..., c][keep]) ** 2).sum())


@pytest.fixture(scope="module")
def noisy() -> Measured:
    return material()


# -- the reductions are exact ----------------------------------------------------------------------------------------


def test_merged_objective_is_the_sum_over_samples(noisy):
    weights, channel = channel_of(noisy)
    random = np.random.default_rng(0)
    m, g, rho_d = random.uniform(0, 1, (90, 90)), random.uniform(0.2, 1, 90), 0.03
    expected = brute(noisy, weights, m, g, rho_d)
    problem = TableProblem(channel, clamp=0.0, smoothing=1.0)
    # grid_cosines are float32: angles near the horizon carry 1e-7 / sin
    assert problem.objective(m, rho_d, channel.contract(g)) == pytest.approx(expected, rel=1e-4)
    pairs = channel.collect(m)
    sums = pair_sums(channel.geometry.pair_i, channel.geometry.pair_o, pairs, g)
    s1, s2, r1 = channel.contract(g)
    assert sums == pytest.approx(((m * s1).sum(), (m * m * s2).sum(), (m * r1).sum()), rel=1e-11)


def test_sweep_is_the_published_iteration():
    """On data symmetric in phi_d, merging changes no step: the compiled sweep gives the plain iteration's numbers."""
    measured = material(symmetric=True, share=0.01)
    weights, channel = channel_of(measured)
    samples = plain.Samples(weights, measured.table[..., 0])
    d, f = plain.slices(samples)
    expected = plain.start(samples, d, f)
    problem = FactorProblem(channel, clamp=plain.CLAMP)
    state = problem.start(d, f)
    assert state.objective == pytest.approx(expected.objective, rel=1e-9)
    for _ in range(4):
        expected, state = plain.iterate(samples, expected), problem.sweep(state)
        assert state.objective == pytest.approx(expected.objective, rel=1e-7)
        np.testing.assert_allclose(state.g, expected.g, rtol=1e-5, atol=1e-8)
        np.testing.assert_allclose(state.v[0], expected.f, rtol=1e-5, atol=1e-8)
    assert problem.golden_calls == expected.golden


def test_naive_sweep_is_the_published_iteration(noisy):
    weights, _ = channel_of(noisy)
    samples = plain.Samples(weights, noisy.table[..., 0])
    expected = plain.start(samples, *plain.slices(samples), naive=True)
    problem = NaiveProblem(weights, noisy.table[..., 0])
    state = problem.start(expected.rho_s * expected.d, expected.f, expected.g, expected.rho_d)
    for _ in range(5):
        expected, state = plain.iterate(samples, expected, naive=True), problem.sweep(state)
        assert state.objective == pytest.approx(expected.objective, rel=1e-9)


# -- steps -----------------------------------------------------------------------------------------------------------


def problems(measured):
    weights, channel = channel_of(measured)
    random = np.random.default_rng(3)
    d, f, h = random.uniform(0.1, 1, 90), random.uniform(0.1, 1, 90), random.uniform(0.5, 1, 180)
    g = smoothing_matrix(1.0) @ random.uniform(0.3, 1, 90)
    naive = NaiveProblem(weights, measured.table[..., 0])
    yield "naive", naive, naive.start(d, f, h, 0.01)
    independent = FactorProblem(channel, clamp=1e-6)
    yield "independent_g", independent, independent.start(d, f, g)
    derived = FactorProblem(channel, derived=True)
    yield "g_from_d", derived, derived.start(d, f)
    low_rank = FactorProblem(channel, rank=2, clamp=1e-6, signed=True)
    yield "low_rank", low_rank, low_rank.start(np.stack([d, f - 0.5]), np.stack([f, d - 0.5]), g, 0.01)
    table = TableProblem(channel, clamp=0.0, smoothing=1.0)
    yield "table", table, table.start(np.outer(d, f), g, 0.01)


def test_objective_never_rises(noisy):
    """Every sweep and every joint step, from random starts, for every kind of problem; and the sums that a state
    carries are those of its factors."""
    for name, problem, state in problems(noisy):
        trace = Trace([state.objective])
        state = alternate(problem, state, trace, sweeps=3, tolerance=0.0)
        state = accelerate(problem, state, trace, steps=5, tolerance=0.0)
        state = alternate(problem, state, trace, sweeps=1, tolerance=0.0)
        assert len(trace.history) > 5, name
        assert (np.diff(trace.history) <= 0).all(), name
        assert trace.history[-1] < 0.5 * trace.history[0], name
        if hasattr(state, "sums"):
            assert problem.objective(state.m, state.rho_d, problem.channel.contract(state.g)) == pytest.approx(
                state.objective, rel=1e-9
            ), name


def test_gradient_of_the_joint_step(noisy):
    """The joint step's gradient is minus half the derivative of the objective, also through Smith's integral."""
    random = np.random.default_rng(5)
    for name, problem, state in problems(noisy):
        if name in ("naive", "table"):
            continue
        _, gradient = problem.linearise(state)
        step = random.standard_normal(gradient.size) * 1e-6
        n = problem.rank * 90
        if problem.derived:
            step[:n] *= state.u[0]
        values = []
        for sign in (1, -1):
            u = state.u + sign * step[:n].reshape(-1, 90)
            v = state.v + sign * step[n : 2 * n].reshape(-1, 90)
            rho_d = state.rho_d + sign * step[-1]
            g = g_from_d(u[0]) if problem.derived else state.g + sign * problem.smoothing @ step[2 * n : -1]
            values.append(problem.objective(u.T @ v, rho_d, problem.channel.contract(g)))
        assert (values[0] - values[1]) / 2 == pytest.approx(-2 * gradient @ step, rel=1e-3), name


def test_after_a_joint_step_the_factors_follow_g(noisy, monkeypatch):
    """u, v and rho_d take better values for the same G, never worse ones; rho_d, the last, the best there is."""
    for name, problem, state in problems(noisy):
        if not isinstance(problem, FactorProblem) or problem.derived:
            continue
        linear = problem.linearise(state)
        found = problem.propose(state, linear, 1e-3)
        monkeypatch.setattr(microfacet_factors, "ROUNDS", 0)
        plain_step = problem.propose(state, linear, 1e-3)
        monkeypatch.undo()
        assert found.objective < plain_step.objective, name
        assert np.array_equal(found.g, plain_step.g), name
        slope = problem.wr - found.rho_d * problem.w - np.vdot(found.m, found.sums[0])
        assert slope <= 1e-9 * problem.wr, name
        assert found.rho_d == 0 or slope >= -1e-9 * problem.wr, name


def test_the_best_rows_are_those_of_weighted_least_squares():
    random = np.random.default_rng(3)
    weight, value, old = random.uniform(size=(7, 9)), random.standard_normal((7, 9)), random.standard_normal((3, 7))
    weight[2] = 0.0  # a row without samples keeps its values
    v = random.standard_normal((3, 9))
    found = best_rows(weight, weight * value, v, old)
    root = np.sqrt(weight)
    for n in range(7):
        best = np.linalg.lstsq((root[n] * v).T, root[n] * value[n])[0] if n != 2 else old[:, 2]
        np.testing.assert_allclose(found[:, n], best, rtol=1e-6)
    # Of the values that equal products leave open the nearest to the old ones.
    equal = best_rows(np.ones((7, 9)), value, np.stack([v[0], v[0]]), old[:2])
    np.testing.assert_allclose(equal[0] - equal[1], old[0] - old[1], rtol=1e-5)


def test_smith_integral():
    """Against the closed form: 15 nodes give G within 0.012; the derivative is that of the function."""
    cosine = node_cosines()
    for alpha in (0.3, 0.5, 0.8):
        d = microfacet.ggx_ndf(np.cos(theta_h_centres()), alpha)
        np.testing.assert_allclose(g_from_d(d)[:-1], microfacet.ggx_g1(cosine, alpha)[:-1], atol=0.02)
        step = 1e-6 * d * np.random.default_rng(0).standard_normal(90)
        change = (g_from_d(d + step) - g_from_d(d - step)) / 2
        np.testing.assert_allclose(g_from_d_derivative(d) @ step, change, atol=1e-12)
    assert g_from_d(7 * d) == pytest.approx(g_from_d(d), rel=1e-12)


def test_empty_components_keep_their_value_and_are_counted(noisy):
    table = noisy.table.copy()
    table[40:43] = np.nan  # no sample at three theta_h
    _, channel = channel_of(Measured("gap", table))
    problem = FactorProblem(channel, clamp=1e-6)
    ones = np.ones(90)
    start = problem.start(ones, ones)
    state = problem.sweep(start)
    full = FactorProblem(channel_of(noisy)[1], clamp=1e-6)
    full.sweep(full.start(ones, ones))
    assert problem.empty_components == full.empty_components + 3
    scale = state.u[0, 40] / start.u[0, 40]
    np.testing.assert_allclose(state.u[0, 40:43], scale * start.u[0, 40:43])


# -- models ----------------------------------------------------------------------------------------------------------


def test_recovery():
    """Data made by a model of Eq. 3 on the fit's own grid come back to single precision of the data."""
    m, g, rho_d = planted()
    table = grid_microfacet(np.stack([m] * 3), np.stack([g] * 3), np.full(3, rho_d))
    measured = material(table=table, share=0.02)
    for name in ("independent_g", "bivariate_g"):
        fitted = fit(name, measured)
        assert fitted.report["objective"] < 1e-6, name
    found = fit("independent_g", measured, starts="slices")
    np.testing.assert_allclose(found.parameters["rho_d"], rho_d, rtol=2e-2)


@pytest.mark.parametrize("name", ALL)
def test_grid_and_directions_agree(name, noisy, fitted):
    """evaluate at cell centres is evaluate_grid, evaluate is reciprocal, and the objective is that of the stored
    numbers."""
    model, fitted = MODELS[name], fitted(name)
    grid = model.evaluate_grid(fitted.parameters)
    random = np.random.default_rng(2)
    cells = np.argwhere(above_horizon() & (np.minimum(*grid_cosines()) > 0.02))
    h, d, p = cells[random.integers(0, len(cells), 500)].T
    wi, wo = directions(theta_h_centres()[h], theta_d_centres()[d], (p + 0.5) * np.pi / 180)
    expected = grid[h, d, p]
    there = model.evaluate(fitted.parameters, wi, wo)
    np.testing.assert_allclose(there, expected, rtol=1e-4, atol=1e-6)
    np.testing.assert_allclose(model.evaluate(fitted.parameters, wo, wi), there, rtol=1e-9, atol=1e-12)
    assert (there >= 0).all()
    weights = compressive_weights(noisy.table)
    assert fitted.report["objective"] == pytest.approx(relative_objective(grid, noisy.table, weights), rel=1e-5)


def test_storage_is_the_papers():
    sizes = {name: MODELS[name].bytes for name in ALL}
    assert (sizes["independent_g"], sizes["g_from_d"], sizes["naive"], sizes["bivariate"]) == (3264, 3264, 4344, 97200)
    assert sizes["low_rank_2"] < 6000
    assert sizes["low_rank_4"] < 10000
    assert all(MODELS[name].status.startswith("ours") for name in ("bivariate_g", "low_rank_2", "low_rank_4"))


def test_bivariate_g_contains_both(fitted):
    """At least as good as the bivariate and the independent-G fit, to the precision of the stored numbers; and more
    rank is no worse."""
    value = {name: fitted(name).report["objective"] for name in ALL}
    assert value["bivariate_g"] <= min(value["bivariate"], value["independent_g"]) * (1 + 1e-5)
    assert value["bivariate_g"] <= value["low_rank_4"] * (1 + 1e-3)
    assert value["low_rank_4"] <= value["low_rank_2"] * (1 + 1e-3)
    assert value["low_rank_2"] <= value["independent_g"] * (1 + 1e-3)


def test_eight_starts_are_reported_and_a_seed_gives_one_fit():
    measured = material(share=0.004)
    first, second = (fit("independent_g", measured, seed=4) for _ in range(2))
    assert all(np.array_equal(first.parameters[name], second.parameters[name]) for name in first.parameters)
    for channel in first.report["details"]["channels"]:
        names = [start["name"] for start in channel["starts"]]
        assert sorted(names) == sorted(
            ["ones", "sgd", "g_from_d", "slices", "random 1", "random 2", "random 3", "random 4"]
        )
        assert channel["objective"] <= min(start["objective"] for start in channel["starts"]) * (1 + 1e-12)
        assert all(len(start["history"]) <= 200 for start in channel["starts"])
        assert (np.diff(channel["history"]) <= 0).all()


@pytest.mark.slow
@pytest.mark.parametrize("name", ITERATIVE)
def test_acceleration_changes_nothing_but_time(name):
    measured = material(share=0.004)
    fast = fit(name, measured, **quick(name)).report["objective"]
    slow = fit(name, measured, accelerate=False, **quick(name)).report["objective"]
    assert fast <= slow * (1 + 1e-3)


@pytest.mark.parametrize("options", [{"power": 0.0}, {"max_angle": 80.0}, {"measure": "pairs"}])
def test_each_switch_is_minimised(options, noisy):
    """A fit with a switch is better in that metric than the fit without it."""
    limit = np.deg2rad(options.get("max_angle", 89.0))
    weights = compressive_weights(
        noisy.table, power=options.get("power", 1.4), measure=options.get("measure", "slice"), max_angle=limit
    )
    for name in ("bivariate", "naive"):
        own, published = fit(name, noisy, **options), fit(name, noisy)
        of = lambda f: relative_objective(MODELS[f.model].evaluate_grid(f.parameters), noisy.table, weights)  # noqa: E731
        assert of(own) < of(published), name
        assert own.report["objective"] == pytest.approx(of(own), rel=1e-5)


def test_values_at_the_published_bound_are_told():
    """A highlight of more than six decades cannot be held by a D that is clamped at 1e-6 of its largest value."""
    m, g, rho_d = planted()
    steep = m * np.exp(-np.linspace(0, 20, 90))[:, None]
    table = grid_microfacet(np.stack([steep] * 3), np.stack([g] * 3), np.full(3, 0 * rho_d))
    fitted = fit("independent_g", material(table=table, share=0.02), starts="slices")
    held = (fitted.parameters["d"] <= 1.001e-6).sum()
    assert held > 10
    assert fitted.report["message"].startswith(f"{held} of 270 values of D lie at the published lower bound")
    assert fitted.report["details"]["bound"] == {"factor": "D", "value": 1e-6, "held": held, "count": 270}
    free = fit("independent_g", material(table=table, share=0.02), starts="slices", clamp=0.0)
    assert free.report["objective"] < fitted.report["objective"], "without the bound the range is held"
    d = free.parameters["d"]
    assert (d[d > 0].min() / d.max()) < 1e-7


def test_nothing_runs_away_beyond_a_smaller_range():
    """No sample beyond 80 degrees is fitted: G / cos stays there what it is at the last node within."""
    noisy, cosine = material(share=0.004), node_cosines()
    for name in ("independent_g", "bivariate_g", "low_rank_2"):
        g = fit(name, noisy, max_angle=80.0, **quick(name)).parameters["g"].astype(float)
        ratio = g[:, 79:89] / cosine[79:89]
        np.testing.assert_allclose(ratio, ratio[:, :1] * np.ones(10), rtol=1e-5, err_msg=name)
    g = fit("g_from_d", noisy, max_angle=80.0).parameters
    np.testing.assert_allclose(g["g"][0], g_from_d(g["d"][0].astype(float)), rtol=1e-5)


#: One entry of each class with a hundred numbers or more: tables, entries of which a material may leave open.
TABULATED = {type(MODELS[name]): name for name in reversed(list(MODELS)) if MODELS[name].free_parameters >= 100}


@pytest.mark.parametrize("name", sorted(TABULATED.values()))
def test_nothing_runs_away_where_a_material_was_not_measured(name):
    """Only samples within 70 degrees, of a surface that reflects a fifth of the light: a fit does not reflect more than
    arrives anywhere, and where values are products of table entries, none is far above those of the measured range."""
    measured = material(share=0.004)
    grazing = np.minimum(*grid_cosines())
    within = grazing > np.cos(np.deg2rad(70))
    fitted = fit(name, Measured("part", np.where(within[..., None], measured.table, np.nan)), **quick(name))
    albedo = directional_albedo(fitted.evaluate, np.deg2rad([0, 30, 60, 75, 80, 85]))
    assert albedo.max() < 1
    if name in ALL and MODELS[name].factors(fitted.parameters) is not None:
        table = MODELS[name].evaluate_grid(fitted.parameters).max(-1)
        outside = above_horizon() & ~within
        # G of g_from_d follows from D, and a Smith G lets f rise towards the horizon
        assert table[outside].max() < (4 if name == "g_from_d" else 1.2) * table[within].max()


def test_a_full_material_is_fitted_as_if_nothing_were_held():
    """G keeps every node and no cell is held where samples reach 89 degrees."""
    cos_i, cos_o = grid_cosines()
    assert np.array_equal(Geometry.of(np.minimum(cos_i, cos_o) >= np.cos(MAX_ANGLE)).held, np.eye(90))
    sparse = Geometry.of((np.minimum(cos_i, cos_o) > np.cos(np.deg2rad(70))) & (np.maximum(cos_i, cos_o) < 0.95))
    ratio = (sparse.held @ node_cosines() ** 2)[:-1] / node_cosines()[:-1]
    np.testing.assert_allclose(ratio[:18], ratio[18], rtol=1e-12)
    np.testing.assert_allclose(ratio[69:], ratio[69], rtol=1e-12)
    np.testing.assert_allclose(ratio[18:70], node_cosines()[18:70], rtol=1e-12)


def test_unknown_option():
    with pytest.raises(ValueError, match=r"naive.*unknown option 'kernel'"):
        fit("naive", material(), kernel=3)


# -- bad input -------------------------------------------------------------------------------------------------------


def bad_material(kind: str) -> Measured:
    shape, share = (*GRID_SHAPE, 3), 0.004
    if kind == "dark":
        return material(share=share, table=np.zeros(shape, np.float32))
    if kind == "constant":
        return material(share=share, table=np.full(shape, 0.2, np.float32))
    if kind == "mirror":
        m = np.zeros((3, 90, 90))
        m[:, :2] = 1e4
        return material(share=share, table=grid_microfacet(m, np.ones((3, 90)), np.full(3, 1e-4)))
    if kind == "few":
        table = np.full(shape, np.nan, np.float32)
        table[10, 20, 30] = table[11, 25, 40] = table[0, 0, 90] = (0.1, 0.2, 0.3)
        return Measured(kind, table)
    table = material(share=share).table
    if kind == "outlier":
        table[tuple(np.argwhere(~np.isnan(table[..., 0]))[::500].T)] = 1e7
    if kind == "one dark channel":
        table[..., 2] *= 0
    return Measured(kind, table)


@pytest.mark.parametrize("kind", ["dark", "constant", "few", "mirror", "outlier", "one dark channel"])
def test_bad_materials_give_finite_factors(kind):
    measured = bad_material(kind)
    for name in ("bivariate", "naive", "g_from_d", "independent_g", "bivariate_g", "low_rank_2"):
        fitted = fit(name, measured, **quick(name))
        grid = MODELS[name].evaluate_grid(fitted.parameters)[above_horizon()]
        assert np.isfinite(grid).all(), name
        assert (grid >= 0).all(), name
        if kind == "dark":
            assert grid.max() == 0, name
        if kind == "constant":
            assert fitted.report["objective"] < 1e-5, name


def test_no_valid_sample_is_a_clear_failure():
    table = np.full((*GRID_SHAPE, 3), np.nan, np.float32)
    table[0, 89, 0] = 0.1  # beyond 89 degrees
    for name in ALL:
        with pytest.raises(FitError, match="no valid sample"):
            fit(name, Measured("nothing", table))
