"""The solver: laws that hold for any problem, and exactness of the sums over phi_d."""

import numpy as np
import pytest
from scipy.optimize import nnls

from brdfatlas.objectives import e2_weights, loew_e2
from brdfatlas.solvers.least_squares import (
    Moments,
    NoFiniteStartError,
    fit_nonlinear,
    fit_separable,
    latin_starts,
    nonnegative_linear,
)
from brdfatlas.solvers.moments import CellMoments, LogCells


class Exponentials:
    """target_c = a_c0 + a_c1 (exp(-t / x_0) + exp(-t / x_1)): two rates shared by the channels, columns kept whole."""

    derivatives = ((1, 0), (1, 1))

    def __init__(self, target, weights=None):
        self.t = np.linspace(0, 5, target.shape[1])
        self.target, self.weights = target, np.ones_like(target) if weights is None else weights

    def columns(self, x):
        bases = [np.exp(-self.t / rate) for rate in x]
        slopes = [base * self.t / rate**2 for base, rate in zip(bases, x)]
        return np.stack([np.ones_like(self.t), sum(bases), *slopes])

    def moments(self, x, *, derivatives):
        E = self.columns(x)[: 4 if derivatives else 2]
        gram = np.einsum("pt,ct,qt->cpq", E, self.weights, E)
        cross = np.einsum("pt,ct,ct->cp", E, self.weights, self.target)
        return Moments(gram, cross, (self.weights * self.target**2).sum(1))


LOW, HIGH = np.array([0.05, 0.05]), np.array([20.0, 20.0])
TRUE_X, TRUE_A = np.array([0.3, 2.0]), np.array([[0.5, 1.0], [0.1, 3.0], [0.0, 0.7]])


def exact_target(x=TRUE_X, a=TRUE_A):
    columns = Exponentials(np.zeros((3, 200))).columns(x)
    return a @ columns[:2]


def test_recovers_known_parameters_from_every_start():
    problem = Exponentials(exact_target())
    for start in latin_starts(6, LOW, np.array([5.0, 5.0]), seed=3):
        found = fit_separable(problem, start, LOW, HIGH, max_iterations=200, tolerance=1e-14)
        np.testing.assert_allclose(np.sort(found.x), TRUE_X, rtol=1e-5)
        np.testing.assert_allclose(found.linear, TRUE_A, rtol=1e-5, atol=1e-6)
        assert found.converged


def test_objective_never_rises_and_beats_every_start():
    rng = np.random.default_rng(0)
    problem = Exponentials(exact_target() + 0.1 * rng.standard_normal((3, 200)))
    starts = latin_starts(30, LOW, HIGH, seed=1)
    found = fit_separable(problem, starts, LOW, HIGH, follow=5)
    assert (np.diff(found.history) <= 0).all()
    assert found.history[-1] == found.objective
    assert all(after <= before for before, after in found.starts)
    best_start = min(fit_separable(problem, s, LOW, HIGH, max_iterations=0).objective for s in starts)
    assert found.objective <= best_start


def test_minimum_is_that_of_scipy_on_residuals():
    """The same noisy problem, solved by scipy over all parameters at once from the true ones."""
    from scipy.optimize import least_squares

    rng = np.random.default_rng(1)
    target, weights = exact_target() + 0.05 * rng.standard_normal((3, 200)), rng.random((3, 200))
    problem = Exponentials(target, weights)
    found = fit_separable(problem, TRUE_X, LOW, HIGH, tolerance=1e-12)

    def residual(p):
        return (np.sqrt(weights) * (p[2:].reshape(3, 2) @ problem.columns(p[:2])[:2] - target)).ravel()

    lower = np.concatenate([LOW, np.zeros(6)])
    start = np.concatenate([TRUE_X, TRUE_A.ravel()])
    peer = least_squares(residual, np.maximum(start, 1e-3), bounds=(lower, np.full(8, 20.0)), xtol=1e-14, ftol=1e-14)
    assert found.objective <= 2 * peer.cost * (1 + 1e-6)
    np.testing.assert_allclose(found.objective, 2 * peer.cost, rtol=1e-4)


def test_bounds_hold_and_the_solution_stops_at_them():
    found = fit_separable(Exponentials(exact_target()), [1.0, 1.0], [0.5, 0.5], [20.0, 1.5], max_iterations=300)
    assert (found.x >= 0.5).all()
    assert found.x[1] <= 1.5
    assert 0.5 in found.x  # the true rate 0.3 is out of reach


def test_equal_calls_give_equal_bits():
    problem = Exponentials(exact_target())
    first, second = (fit_separable(problem, latin_starts(9, LOW, HIGH, seed=5), LOW, HIGH) for _ in range(2))
    assert np.array_equal(first.x, second.x)
    assert first.history == second.history


def test_says_when_it_ran_out_of_iterations():
    found = fit_separable(Exponentials(exact_target()), [5.0, 10.0], LOW, HIGH, max_iterations=2)
    assert not found.converged
    assert "2 iterations" in found.message


def test_no_finite_start_is_an_error_and_a_bad_one_is_skipped():
    target = exact_target()
    target[0, 0] = np.nan
    with pytest.raises(NoFiniteStartError):
        fit_separable(Exponentials(target), [1.0, 2.0], LOW, HIGH)

    class Partly:
        def value(self, x):
            return np.nan if x[0] > 1 else float((x[0] - 0.5) ** 2)

        def normal_equations(self, x):
            return self.value(x), np.array([x[0] - 0.5]), np.array([[1.0]])

    found = fit_nonlinear(Partly(), [[3.0], [0.9]], np.array([0.0]), np.array([5.0]))
    assert abs(found.x[0] - 0.5) < 1e-6


@pytest.mark.parametrize("count", [1, 2, 3, 5])
def test_linear_part_is_the_nonnegative_optimum(count):
    """Against Lawson and Hanson's algorithm on the residuals themselves."""
    rng = np.random.default_rng(count)
    columns = rng.random((50, count))
    targets = columns @ rng.standard_normal((count, 20)) + 0.1 * rng.standard_normal((50, 20))
    gram = np.repeat((columns.T @ columns)[None], 20, 0)
    found = nonnegative_linear(gram, (columns.T @ targets).T)
    for c in range(20):
        np.testing.assert_allclose(found[c], nnls(columns, targets[:, c])[0], atol=1e-5)


def test_dependent_columns_get_a_finite_solution():
    column = np.linspace(1, 2, 10)
    for columns in (np.stack([column, 2 * column]), np.stack([column, 0 * column]), np.zeros((2, 10))):
        a = nonnegative_linear((columns @ columns.T)[None], (columns @ column)[None])
        assert np.isfinite(a).all()
        left = np.sum((column - a[0] @ columns) ** 2)
        assert left < 1e-20 or not columns.any()


@pytest.fixture
def small():
    """A small made-up material: weights with holes, NaN where the weight is 0, two factors."""
    rng = np.random.default_rng(2)
    weights, target = rng.random((6, 5, 12, 3)), rng.random((6, 5, 12, 3)) * 5
    hole = rng.random((6, 5, 12)) < 0.2
    weights[hole], target[hole] = 0, np.nan
    factors = [rng.random((6, 5, 12)), rng.random((6, 5, 12))]
    return weights, target, factors


def test_sums_over_phi_are_the_full_sums(small):
    weights, target, factors = small
    columns = np.random.default_rng(3).random((4, 2, 6, 5))
    found = CellMoments(weights, target, factors).moments(columns)
    full = sum(columns[:, k][..., None] * factors[k] for k in range(2))
    E = np.concatenate([np.ones((1, 6, 5, 12)), full])
    rho = np.nan_to_num(target)
    np.testing.assert_allclose(found.gram, np.einsum("phdk,hdkc,qhdk->cpq", E, weights, E), rtol=1e-12)
    np.testing.assert_allclose(found.cross, np.einsum("phdk,hdkc,hdkc->cp", E, weights, rho), rtol=1e-12)
    np.testing.assert_allclose(found.power, np.einsum("hdkc,hdkc->c", weights, rho**2), rtol=1e-12)


def test_log_pass_has_the_value_and_gradient_of_its_definition(small):
    _, target, factors = small
    keep = ~np.isnan(target[..., 0])
    cosine = np.random.default_rng(4).random((6, 5, 12)).astype(np.float32) + 0.1
    cells = LogCells(target, keep, cosine, factors)
    columns, a = np.random.default_rng(5).random((3, 2, 6, 5)), np.array([[0.3, 1.0], [0.1, 2.0], [0.0, 0.5]])

    def residual(x, a):
        """(samples,), the columns being linear in x here"""
        amplitude = columns[0] + x[0] * columns[1] + x[1] * columns[2]
        specular = sum(amplitude[k][..., None] * factors[k] for k in range(2))
        model = a[:, 0] + specular[..., None] * a[:, 1]
        c = cosine.astype(float)[..., None]
        return (np.log1p(model * c) - np.log1p(target * c))[keep].ravel() / np.sqrt(keep.sum())

    value, gradient, matrix = cells.normal_equations(columns, a)
    zero = residual(np.zeros(2), a)
    # the stored logarithms are float32
    assert value == pytest.approx(zero @ zero, rel=1e-5)
    assert cells.value(columns[0], a) == pytest.approx(value, rel=1e-12)
    J, step = [], 1e-6
    for j in range(2):
        shift = np.eye(2)[j] * step
        J.append((residual(shift, a) - residual(-shift, a)) / (2 * step))
    for c in range(3):
        for column in range(2):
            shift = np.zeros((3, 2))
            shift[c, column] = step
            J.append((residual(np.zeros(2), a + shift) - residual(np.zeros(2), a - shift)) / (2 * step))
    J = np.array(J)
    np.testing.assert_allclose(gradient, J @ zero, rtol=1e-4, atol=1e-5)
    np.testing.assert_allclose(matrix, J @ J.T, rtol=1e-4, atol=1e-7)


def test_log_value_is_loew_e2_on_the_grid():
    """Against objectives.loew_e2, on the grid proper."""
    from brdfatlas.angles import GRID_SHAPE, above_horizon, grid_cosines

    rng = np.random.default_rng(6)
    table = np.where(above_horizon()[..., None], rng.random((*GRID_SHAPE, 3)).astype(np.float32), np.nan)
    amplitude = rng.random((1, *GRID_SHAPE[:2]))
    cells = LogCells(table, e2_weights(above_horizon()), grid_cosines()[0], [np.ones(GRID_SHAPE, np.float32)])
    a = np.array([[0.2, 1.0], [0.3, 0.5], [0.0, 0.1]])
    model = a[:, 0] + amplitude[0][..., None, None] * a[:, 1] + 0 * table
    assert cells.value(amplitude, a) == pytest.approx(loew_e2(model, table), rel=1e-5)
