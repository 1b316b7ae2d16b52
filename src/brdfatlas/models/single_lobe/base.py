"""What the one-lobe models with V-groove shadowing share (Ngan 2005, Löw 2012).

rho = kd / pi + scale_rgb · amplitude(theta_h, theta_d; shape) · G / (pi cos theta_i cos theta_o), G the V-groove.
The last factor has no parameters, so the inner products of a fit need the sums over phi_d once (``solvers.moments``):
exact, and a step costs 8,100 cells. A subclass states its parameters and the amplitude with its derivatives.
"""

from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from typing import Any, ClassVar

import numpy as np

from brdfatlas.angles import GRID_SHAPE, grid_axes, grid_cosines, half_difference
from brdfatlas.constants import OBJECTIVE_NAMES
from brdfatlas.measured import Measured
from brdfatlas.microfacet import v_groove
from brdfatlas.models.base import FitError, Model, Option, Parameters, Result, objective_words
from brdfatlas.objectives import e2_weights, least_squares_weights, within
from brdfatlas.solvers.least_squares import (
    Moments,
    NoFiniteStartError,
    Solution,
    fit_nonlinear,
    fit_separable,
    latin_starts,
)
from brdfatlas.solvers.moments import CellMoments, LogCells

#: Löw's E2 reaches to theta_h and theta_d of 80 degrees, Ngan's metric to the horizon. Without this limit the samples
#: beyond 80 degrees of theta_i or theta_o, which measurements know least, can make most of the objective: against
#: published parameters the fits of 24 materials were then worse by more than half on up to 7, with it on none.
MAX_ANGLE_OPTION = Option(
    80.0,
    "theta_i, theta_o in degrees within which samples count; 90: the metric up to the horizon",
    low=1.0,
    high=90.0,
)


class SingleLobeModel(Model):
    """A diffuse term and one lobe of three scales. A subclass states its shape parameters, each of shape (1,)."""

    #: the name of the lobe's rgb scale
    scale: ClassVar[str]
    #: parameter -> offset: fitted as log(value - offset), because it spans decades above the offset
    logarithmic: ClassVar[Mapping[str, float]] = {}
    #: parameter -> other: fitted as the product of both, where single values say little; start range of the product
    products: ClassVar[Mapping[str, str]] = {}
    #: where starts are drawn, inside the ranges of the parameters
    start_ranges: ClassVar[Mapping[str, tuple[float, float]]]
    n_starts: ClassVar[int] = 64
    follow: ClassVar[int] = 5

    @abstractmethod
    def amplitude(self, shape: Mapping[str, float], theta_h, cos_d) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """The amplitude at broadcastable angles, and its derivative by each shape parameter."""

    @property
    def shape_names(self) -> tuple[str, ...]:
        return tuple(p.name for p in self.parameters if p.name not in ("kd", self.scale))

    def evaluate(self, parameters: Parameters, wi: np.ndarray, wo: np.ndarray) -> np.ndarray:
        wi, wo = np.broadcast_arrays(np.asarray(wi, float), np.asarray(wo, float))
        theta_h, theta_d, _ = half_difference(wi, wo)
        cos_i, cos_o, cos_d = wi[..., 2], wo[..., 2], np.maximum(np.cos(theta_d), 1e-12)
        shape = {name: float(parameters[name][0]) for name in self.shape_names}
        factor = v_groove(np.cos(theta_h), cos_i, cos_o, cos_d) / (np.pi * cos_i * cos_o)
        lobe = self.amplitude(shape, theta_h, cos_d)[0] * factor
        return parameters["kd"].astype(float) / np.pi + parameters[self.scale].astype(float) * lobe[..., None]

    def evaluate_grid(self, parameters: Parameters) -> np.ndarray:
        theta_h, theta_d, _ = grid_axes()
        shape = {name: float(parameters[name][0]) for name in self.shape_names}
        amplitude = self.amplitude(shape, theta_h, np.cos(theta_d))[0].astype(np.float32)
        lobe = amplitude * grid_factor()
        kd = (parameters["kd"] / np.pi).astype(np.float32)
        return kd + parameters[self.scale].astype(np.float32) * lobe[..., None]

    def fit(self, measured: Measured, *, seed: int = 0, **options: Any) -> Result:
        """Least squares with kd and the scales >= 0. All samples of the objective count.

        Raises FitError where no start has a finite objective.
        """
        chosen = self.check_options(options)
        objective, limit = chosen["objective"], chosen["max_angle"]
        table = within(measured.table, np.deg2rad(limit)) if limit < 90 else measured.table
        try:
            if objective == "e2":
                found, starts = self._fit_e2(table, seed)
                x, linear = found.x[:-6], found.x[-6:].reshape(3, 2)
            else:
                found = self._fit_squares(least_squares_weights(table, objective), table, seed)
                x, linear, starts = found.x, found.linear, found.starts
        except (NoFiniteStartError, ValueError) as error:
            raise FitError(f"{self.name} on {measured.name}: {error}") from None
        parameters: dict[str, np.ndarray] = {"kd": linear[:, 0] * np.pi, self.scale: linear[:, 1]}
        parameters |= {name: np.array([value]) for name, value in self._natural(x).items()}
        value = np.sqrt(found.objective) if objective == "cosine" else found.objective
        return Result(
            parameters,
            float(value),
            objective_words(objective, limit) if limit < 90 else OBJECTIVE_NAMES[objective],
            found.iterations,
            found.converged,
            found.message,
            {"starts": starts, "history": found.history},
        )

    # The fitted vector ------------------------------------------------------------------------------------------

    def bounds(self, narrow: bool = False) -> tuple[np.ndarray, np.ndarray]:
        ranges = {p.name: (p.low, p.high) for p in self.parameters if p.name in self.shape_names}
        for name, other in self.products.items():  # such that both factors stay inside their own ranges
            ranges[name] = (ranges[name][0] * ranges[other][1], ranges[name][1] * ranges[other][0])
        pairs = []
        for name in self.shape_names:
            low, high = self.start_ranges[name] if narrow else ranges[name]
            offset = self.logarithmic.get(name)
            pairs.append((low, high) if offset is None else (np.log(low - offset), np.log(high - offset)))
        lower, upper = np.array(pairs).T
        return lower, upper

    def _natural(self, x: np.ndarray) -> dict[str, float]:
        shape = {}
        for name, value in zip(self.shape_names, x):
            shape[name] = float(self.logarithmic[name] + np.exp(value) if name in self.logarithmic else value)
        for name, other in self.products.items():
            shape[name] /= shape[other]
        # rounding at a bound must not leave the range
        ranges = {p.name: (p.low, p.high) for p in self.parameters}
        return {name: min(max(value, ranges[name][0]), ranges[name][1]) for name, value in shape.items()}

    def columns(self, x: np.ndarray, derivatives: bool) -> np.ndarray:
        """The amplitude on the grid, then its derivative by each entry of x: (1 [+ n], 1, 90, 90)."""
        theta_h, theta_d, _ = grid_axes()
        shape = self._natural(x)
        value, slopes = self.amplitude(shape, theta_h[..., 0], np.cos(theta_d[..., 0]))
        columns = np.empty((1 + (x.size if derivatives else 0), 1, *GRID_SHAPE[:2]))
        columns[0, 0] = value
        if derivatives:
            for name in self.logarithmic:
                slopes[name] = slopes[name] * (shape[name] - self.logarithmic[name])
            for name, other in self.products.items():  # at a fixed product, the other's growth shrinks this one
                slopes[other] = slopes[other] - slopes[name]
            for row, name in enumerate(self.shape_names):
                columns[1 + row, 0] = slopes[name]
        return columns

    # Fits -------------------------------------------------------------------------------------------------------

    def _fit_squares(self, weights: np.ndarray, table: np.ndarray, seed: int) -> Solution:
        """The best of many starts for a weighted sum of squares."""
        problem = _Squares(self, CellMoments(weights, table, [grid_factor()]))
        lower, upper = self.bounds()
        starts = latin_starts(self.n_starts, *self.bounds(narrow=True), seed)
        rough = fit_separable(
            problem, starts, lower, upper, follow=self.follow, separation=0.05, max_iterations=30, tolerance=1e-4
        )
        found = fit_separable(problem, rough.x, lower, upper, follow=1, max_iterations=200, tolerance=1e-7)
        return replace(found, starts=rough.starts, history=rough.history + found.history[1:])

    def _fit_e2(self, table: np.ndarray, seed: int) -> tuple[Solution, list[tuple[float, float]]]:
        """Löw's E2 has no linear parameters and takes a pass over the samples a step. So all starts are followed in its
        linearisation about the material, a weighted sum of squares with w = share of the pairs (cos / (1 + rho cos))^2;
        the best end then descends in E2, first on every tenth phi_d, then on all samples."""
        share = e2_weights(~np.isnan(table[..., 0]))
        cosine = np.maximum(grid_cosines()[0], np.float32(0))
        slope = cosine[..., None] / (1 + np.nan_to_num(table) * cosine[..., None])
        linearised = self._fit_squares(share[..., None] * slope.astype(float) ** 2, table, seed)
        start = np.concatenate([linearised.x, linearised.linear.ravel()])
        lower, upper = (np.concatenate([b, np.full(6, c)]) for b, c in zip(self.bounds(), (0.0, np.inf)))
        thin = _E2(self, table, share, slice(5, None, 10))
        rough = fit_nonlinear(thin, start, lower, upper, max_iterations=40, tolerance=1e-4)
        full = _E2(self, table, share, slice(None))
        candidates = np.array([rough.x, start])
        found = fit_nonlinear(full, candidates, lower, upper, follow=1, max_iterations=60, tolerance=1e-5)
        return found, linearised.starts


@cache
def grid_factor() -> np.ndarray:
    """G / (pi cos theta_i cos theta_o) on the MERL grid, read-only float32 of GRID_SHAPE; finite everywhere."""
    theta_h, theta_d, _ = grid_axes()
    cos_i, cos_o = (np.maximum(c, np.float32(1e-6)) for c in grid_cosines())
    groove = v_groove(np.cos(theta_h).astype(np.float32), cos_i, cos_o, np.cos(theta_d).astype(np.float32))
    factor = (groove / (np.float32(np.pi) * cos_i * cos_o)).astype(np.float32)
    factor.flags.writeable = False
    return factor


class _Squares:
    """A weighted sum of squares as a SeparableProblem: columns 1 and the lobe."""

    def __init__(self, model: SingleLobeModel, cells: CellMoments) -> None:
        self.model, self.cells = model, cells
        self.derivatives = [(1, j) for j in range(len(model.shape_names))]

    def moments(self, x: np.ndarray, *, derivatives: bool) -> Moments:
        return self.cells.moments(self.model.columns(x, derivatives))


class _E2:
    """Löw's E2 on a part of phi_d, in (shape, then kd/pi and the scale of each channel)."""

    def __init__(self, model: SingleLobeModel, table: np.ndarray, weights: np.ndarray, part: slice) -> None:
        self.model = model
        table, weights = np.ascontiguousarray(table[:, :, part]), np.ascontiguousarray(weights[:, :, part])
        self.cells = LogCells(table, weights, grid_cosines()[0][:, :, part], [grid_factor()[:, :, part]])

    def value(self, x: np.ndarray) -> float:
        return self.cells.value(self.model.columns(x[:-6], False)[0], x[-6:].reshape(3, 2))

    def normal_equations(self, x: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
        return self.cells.normal_equations(self.model.columns(x[:-6], True), x[-6:].reshape(3, 2))
