"""Bounded nonlinear least squares with many starts: Levenberg–Marquardt on normal equations, variable projection.

How to use it
-------------
A problem hands over *inner products*, never residual vectors: a model has few parameters and a material a million
samples, so one compiled pass that accumulates a small matrix is the whole cost of an iteration.

1. Scale parameters that enter linearly and are >= 0 (kd, ks, A): write a :class:`SeparableProblem` and call
   :func:`fit_separable`. With the residual of channel c

       r_c = target_c - sum_l a_cl b_l(x),        a_cl >= 0,  l = 0 .. L-1

   the problem returns, at x, the weighted :class:`Moments` of the columns E = [b_0 .. b_{L-1}, d_0 .. d_{P-1}], where
   d_p = db_l/dx_j for the pair ``derivatives[p] = (l, j)``; pairs whose derivative is identically zero are left out.
   The channels share x. A model whose channels have their own x is one problem a channel, with C = 1.
   The a_cl are solved inside (non-negative least squares) and projected out (Kaufman's form of variable projection).

2. Anything else: write a :class:`Problem` (value, gradient and Gauss–Newton matrix) and call :func:`fit_nonlinear`.

For columns amplitude(theta_h, theta_d; x) · factor(wi, wo) on the MERL grid, ``solvers.moments`` makes the inner
products exactly from sums over phi_d, about a hundred times faster than a pass over the samples.

What holds for both: the result is never worse than the best start; a start or step with a non-finite objective is
refused; everything is deterministic; ``converged`` is False where the iterations ran out.

Sources: Golub and Pereyra 1973; Kaufman 1975 (BIT 15); Moré 1978 (scaling and gain ratio); Lawson and Hanson 1974.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

import numpy as np


class NoFiniteStartError(ArithmeticError):
    """The objective is not finite at any start: there is nothing to fit."""


@dataclass(frozen=True)
class Moments:
    """Weighted inner products of C channels over q columns: <e_p, e_q>, <e_p, target> and <target, target>.

    Of a problem that was asked for no derivatives, q may be L.
    """

    gram: np.ndarray
    """(C, q, q)"""
    cross: np.ndarray
    """(C, q)"""
    power: np.ndarray
    """(C,)"""


class SeparableProblem(Protocol):
    """A problem with linear parameters inside; see the module's text."""

    @property
    def derivatives(self) -> Sequence[tuple[int, int]]:
        """(l, j) of each derivative column: it is db_l / dx_j."""

    def moments(self, x: np.ndarray, *, derivatives: bool) -> Moments:
        """Inner products at x, of the L linear columns, and of the derivative columns after them if asked for."""


class Problem(Protocol):
    """A general least-squares problem: minimise value(x) = sum r^2."""

    def value(self, x: np.ndarray) -> float:
        """The objective, sum of r^2."""

    def normal_equations(self, x: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
        """value, J^T r (n,), J^T J (n, n) with J = dr/dx."""


@dataclass(frozen=True)
class Solution:
    """The best minimum found."""

    x: np.ndarray
    """(n,) nonlinear parameters, inside the bounds"""
    linear: np.ndarray
    """(C, L) linear parameters, >= 0; empty for :func:`fit_nonlinear`"""
    objective: float
    """sum of the weighted squared residuals"""
    converged: bool
    iterations: int
    """of the start that won"""
    message: str
    history: list[float] = field(default_factory=list)
    """objective after every accepted step of the start that won, not rising"""
    starts: list[tuple[float, float]] = field(default_factory=list)
    """objective before and after for every start that was followed"""


def nonnegative_linear(gram: np.ndarray, cross: np.ndarray) -> np.ndarray:
    """argmin over a >= 0 of a^T gram a - 2 a^T cross, per channel; gram (C, L, L), cross (C, L) -> (C, L).

    Columns that are (nearly) dependent get a solution with one of them 0.
    """
    channels, count = cross.shape
    a = np.zeros((channels, count))
    if count > 2:
        from scipy.optimize import nnls  # late: its import takes longer than many a fit

        for c in range(channels):
            scale = np.sqrt(np.maximum(np.diag(gram[c]), 1e-300))
            values, vectors = np.linalg.eigh(gram[c] / np.outer(scale, scale))
            root = np.sqrt(np.maximum(values, 1e-13))
            a[c] = nnls(root[:, None] * vectors.T, (vectors.T @ (cross[c] / scale)) / root)[0] / scale
        return a
    for c in range(channels):
        single = [
            max(float(cross[c, i]), 0.0) / float(gram[c, i, i]) if gram[c, i, i] > 0 else 0.0 for i in range(count)
        ]
        if count == 1:
            a[c, 0] = single[0]
            continue
        m00, m01, m11 = float(gram[c, 0, 0]), float(gram[c, 0, 1]), float(gram[c, 1, 1])
        v0, v1 = float(cross[c, 0]), float(cross[c, 1])
        determinant = m00 * m11 - m01 * m01
        if determinant > 1e-12 * m00 * m11:
            both = ((m11 * v0 - m01 * v1) / determinant, (m00 * v1 - m01 * v0) / determinant)
            if both[0] >= 0 and both[1] >= 0:
                a[c] = both
                continue
        gain0, gain1 = single[0] * v0, single[1] * v1  # what each column alone explains
        if gain0 >= gain1:
            a[c, 0] = single[0]
        else:
            a[c, 1] = single[1]
    return a


def _separable_value(moments: Moments, count: int) -> tuple[float, np.ndarray]:
    gram, cross = moments.gram[:, :count, :count], moments.cross[:, :count]
    if not (np.isfinite(gram).all() and np.isfinite(cross).all() and np.isfinite(moments.power).all()):
        return np.inf, np.zeros_like(cross)
    a = nonnegative_linear(gram, cross)
    residual = moments.power - 2 * (a * cross).sum(1) + np.einsum("cl,clm,cm->c", a, gram, a)
    return float(np.maximum(residual, 0.0).sum()), a


class _Projected:
    """A SeparableProblem with its linear parameters projected out, as a Problem in x alone."""

    def __init__(self, problem: SeparableProblem, count: int) -> None:
        self.problem, self.count = problem, count

    def value(self, x: np.ndarray) -> float:
        return _separable_value(self.problem.moments(x, derivatives=False), self.count)[0]

    def normal_equations(self, x: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
        moments = self.problem.moments(x, derivatives=True)
        count, pairs = self.count, self.problem.derivatives
        value, a = _separable_value(moments, count)
        gradient, matrix = np.zeros(x.size), np.zeros((x.size, x.size))
        if not np.isfinite(value):
            return value, gradient, matrix
        for c in range(a.shape[0]):
            gram, cross = moments.gram[c], moments.cross[c]
            # the derivative of the model at fixed a, as combinations of the columns
            combine = np.zeros((x.size, gram.shape[0]))
            for p, (column, j) in enumerate(pairs):
                combine[j, count + p] += a[c, column]
            gradient += combine @ (gram[:, :count] @ a[c] - cross)
            product = combine @ gram @ combine.T
            active = np.flatnonzero(a[c] > 0)
            if active.size:
                inner = gram[np.ix_(active, active)]
                mixed = combine @ gram[:, active]
                ridge = 1e-13 * np.diag(np.diag(inner))
                product -= mixed @ np.linalg.solve(inner + ridge, mixed.T)
            matrix += product
        return value, gradient, matrix


def _descend(problem: Problem, start, lower, upper, max_iterations: int, tolerance: float, enough: float):
    """Levenberg–Marquardt in a box. Returns x, value, converged, iterations, message, history."""
    x = np.clip(start, lower, upper)
    value, gradient, matrix = problem.normal_equations(x)
    history = [value]
    damping, growth = 1e-3, 2.0
    longest = np.where(np.isfinite(upper - lower), 0.25 * (upper - lower), np.inf)
    tiny_value = max(1e-15 * value, enough, 1e-300)
    quiet = 0
    largest = np.zeros(x.size)
    for iteration in range(1, max_iterations + 1):
        if value <= tiny_value:
            return x, value, True, iteration - 1, "objective is as good as zero", history
        blocked = ((x <= lower) & (gradient > 0)) | ((x >= upper) & (gradient < 0))
        free = np.flatnonzero(~blocked)
        diagonal = np.diag(matrix)
        floor = max(1e-12 * float(diagonal.max(initial=0.0)), 1e-300)
        if (
            free.size == 0
            or not (np.abs(gradient[free]) > 1e-14 * np.sqrt(value * np.maximum(diagonal[free], floor))).any()
        ):
            return x, value, True, iteration - 1, "gradient is zero", history
        largest = np.maximum(largest, diagonal)  # Moré's scaling
        scale = np.maximum(largest[free], 1e-8 * float(largest.max()))
        accepted = False
        while damping < 1e14:
            system = matrix[np.ix_(free, free)] + damping * np.diag(scale)
            try:
                step = np.linalg.solve(system, -gradient[free])
            except np.linalg.LinAlgError:
                damping, growth = damping * growth, growth * 2
                continue
            trial, predicted = _stepped(x, step, free, longest, (lower, upper), gradient, matrix)
            reached = problem.value(trial)
            if np.isfinite(reached) and reached < value:
                gain = (value - reached) / predicted if predicted > 0 else 0.0
                damping = max(damping * max(1 / 3, 1 - (2 * gain - 1) ** 3), 1e-12) if gain > 0 else damping * 2
                growth = 2.0
                accepted = True
                break
            if 0 <= predicted <= 1e-3 * tolerance * value and np.isfinite(reached):
                break  # nothing left that the tolerance could show
            damping, growth = damping * growth, growth * 2
        if not accepted:
            return x, value, True, iteration, "no step lowers the objective", history
        relative = (value - reached) / value
        x = trial
        value, gradient, matrix = problem.normal_equations(x)
        history.append(value)
        quiet = quiet + 1 if relative < tolerance else 0
        if quiet >= 2:
            return x, value, True, iteration, "objective has settled", history
    return x, value, False, max_iterations, f"not converged in {max_iterations} iterations", history


def _stepped(x, step, free, longest, box, gradient, matrix) -> tuple[np.ndarray, float]:
    """x after a step of its free entries, kept in the box and no longer than ``longest``, and by how much the quadratic
    model falls."""
    # clip each entry: a flat direction asks for a huge step and must not shorten those of the others
    clipped = np.clip(step, -longest[free], longest[free])
    for bounded in (clipped, step / max(1.0, np.max(np.abs(step) / longest[free]))):
        trial = x.copy()
        trial[free] = np.clip(x[free] + bounded, box[0][free], box[1][free])
        move = trial - x
        predicted = -(2 * gradient @ move + move @ matrix @ move)
        if predicted > 0:
            break
    return trial, predicted


def fit_nonlinear(
    problem: Problem,
    starts: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    *,
    follow: int = 8,
    separation: float = 0.0,
    max_iterations: int = 100,
    tolerance: float = 1e-7,
    enough: float = 0.0,
) -> Solution:
    """Minimise ``problem.value`` in the box from many starts.

    ``starts`` (S, n): all are evaluated, the ``follow`` best are followed to their minimum; of starts closer than
    ``separation`` (largest difference in units of the box) only the best is. ``tolerance``: relative decrease of the
    objective below which, twice running, a descent has settled. ``enough``: an objective that counts as zero; no
    further start is followed then. NoFiniteStartError if no start has a finite objective.
    """
    starts = np.clip(np.atleast_2d(np.asarray(starts, float)), lower, upper)
    lower, upper = np.broadcast_to(lower, starts.shape[1:]).astype(float), np.broadcast_to(upper, starts.shape[1:])
    values = np.array([problem.value(x) for x in starts])
    if not np.isfinite(values).any():
        raise NoFiniteStartError("the objective is not finite at any start")
    chosen: list[int] = []
    for s in np.argsort(np.where(np.isfinite(values), values, np.inf), kind="stable"):
        near = (np.max(np.abs(starts[s] - starts[t]) / (upper - lower)) < separation for t in chosen)
        if np.isfinite(values[s]) and len(chosen) < follow and not any(near):
            chosen.append(int(s))
    found = []
    for s in chosen:
        found.append(_descend(problem, starts[s], lower, upper, max_iterations, tolerance, enough))
        if found[-1][1] <= enough:
            break
    best = min(range(len(found)), key=lambda i: found[i][1])
    x, value, converged, iterations, message, history = found[best]
    ends = [(float(values[s]), float(end[1])) for s, end in zip(chosen, found)]
    return Solution(x, np.empty((0, 0)), float(value), converged, iterations, message, history, ends)


def fit_separable(
    problem: SeparableProblem,
    starts: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    *,
    linear: int = 2,
    **settings: Any,
) -> Solution:
    """As :func:`fit_nonlinear`, with its ``settings``, for a problem with ``linear`` non-negative linear parameters a
    channel inside.

    The objective is sum_c |target_c - sum_l a_cl b_l(x)|^2 in the problem's weights. Solution.linear is (C, linear).
    """
    found = fit_nonlinear(_Projected(problem, linear), starts, lower, upper, **settings)
    return replace(found, linear=_separable_value(problem.moments(found.x, derivatives=False), linear)[1])


def latin_starts(count: int, lower: np.ndarray, upper: np.ndarray, seed: int = 0) -> np.ndarray:
    """``count`` starts spread evenly over the box (Latin hypercube, deterministic for a seed); (count, n).

    The numbers are those of scipy.stats.qmc.LatinHypercube, whose import takes longer than many a fit.
    """
    lower, upper = np.asarray(lower, float), np.asarray(upper, float)
    rng = np.random.default_rng(seed).spawn(1)[0]
    within = rng.uniform(size=(count, lower.size))
    strata = np.tile(np.arange(1, count + 1), (lower.size, 1))
    for row in strata:
        rng.shuffle(row)
    return lower + (strata.T - within) / count * (upper - lower)
