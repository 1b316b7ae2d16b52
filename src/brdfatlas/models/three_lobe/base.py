"""What the five 3-lobe models of Bilgili et al. 2011 share.

rho = kd / pi + ks · sum_j rho_s(wi, wo; p_j), j = 1..3 (supplement, Eq. 3). One kd and one ks RGB; the shape numbers
p_j are per lobe and colourless. Every rho_s of the five separates exactly into

    rho_s = sum_k amplitude_k(theta_h, theta_d; p) · factor_k(wi, wo)

with factors that have no parameters (one of them, or two for Edwards). A subclass states these two functions; the
evaluation, the fit and its derivatives follow.
"""

from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any, ClassVar

import numpy as np

from brdfatlas.angles import GRID_SHAPE, grid_axes, grid_cosines, half_difference
from brdfatlas.constants import OBJECTIVE_NAMES
from brdfatlas.measured import Measured
from brdfatlas.models.base import (
    FitError,
    Model,
    Option,
    Paper,
    Parameter,
    Parameters,
    Result,
    grazing_option,
    objective_option,
    objective_words,
)
from brdfatlas.objectives import e2_weights, graded_weights
from brdfatlas.sampling import Lobe, Mixture, mixture
from brdfatlas.solvers.least_squares import (
    Moments,
    NoFiniteStartError,
    Solution,
    fit_nonlinear,
    fit_separable,
    latin_starts,
)
from brdfatlas.solvers.moments import CellMoments, LogCells

N_LOBES = 3

BILGILI2011 = Paper(
    authors="Ahmet Bilgili, Aydın Öztürk, Murat Kurt",
    title="A General BRDF Representation Based on Tensor Decomposition",
    venue="Computer Graphics Forum 30 (8), supplemental material",
    year=2011,
    doi="10.1111/j.1467-8659.2011.02072.x",
)
KD = Parameter("kd", (3,), "diffuse albedo, rgb", low=0.0, high=np.inf)
KS = Parameter("ks", (3,), "specular reflectivity, rgb, shared by the three lobes", low=0.0, high=np.inf)
F0 = Parameter("f0", (N_LOBES,), "Fresnel reflectance at normal incidence, per lobe", low=0.0, high=1.0)


def beckmann_exponential(m, cos_h, sin_h) -> tuple[np.ndarray, np.ndarray]:
    """exp(-(tan theta_h / m)^2), and its exponent (tan theta_h / m)^2."""
    exponent = (sin_h / (cos_h * m)) ** 2
    return np.exp(-exponent), exponent


@dataclass(frozen=True)
class Unknown:
    """One number a lobe that the fit moves: its bounds, where starts are drawn, and whether by its logarithm."""

    name: str
    low: float
    high: float
    start: tuple[float, float]
    logarithmic: bool = False


UNKNOWN_F0 = Unknown("f0", 0.0, 1.0, (0.0, 0.6))

#: one amplitude with its derivative by each shape parameter
Amplitude = tuple[np.ndarray, dict[str, np.ndarray]]


class LobeModel(Model):
    """A diffuse term and three lobes. A subclass states its citation, its shape parameters and its lobe."""

    paper: ClassVar[Paper] = BILGILI2011
    #: what the fit moves; the shape parameters themselves, but where they are tied to each other
    unknowns: ClassVar[tuple[Unknown, ...]]
    options: ClassVar[Mapping[str, Option]] = {
        "objective": objective_option("compressive"),
        "max_angle": Option(
            80.0,
            "compressive only: theta_i, theta_o in degrees within which the metric counts in full; Bagher 2016 has "
            "80 against 89 (Fig. 15)",
            low=1.0,
            high=89.0,
        ),
        "grazing": grazing_option(0.02),
        "starts": Option(192, "how many starts are tried", low=1, high=10_000),
        "follow": Option(10, "how many of the best starts are followed to their minimum", low=1, high=10_000),
    }

    def fit(
        self,
        measured: Measured,
        *,
        seed: int = 0,
        objective: str = "compressive",
        max_angle: float = 80.0,
        grazing: float = 0.02,
        starts: int = 192,
        follow: int = 10,
    ) -> Result:
        """Least squares with kd, ks >= 0 solved inside, from ``starts`` deterministic starts.

        The sums over phi_d give the exact inner products of all samples (``solvers.moments``). The compressive metric
        counts in full within ``max_angle`` degrees and by ``grazing`` beyond: with the whole range to 89 degrees
        1 / (cos theta_i cos theta_o) makes the last five degrees rule the fit, and on measured materials Ashikhmin–
        Shirley and Cook–Torrance end up half as far again from the material, by mean |log1p| deviation, as the
        authors' fits. Raises FitError where no start has a finite objective.
        """
        lower, upper = self.box("low"), self.box("high")
        try:
            weights = graded_weights(measured.table, objective, np.deg2rad(max_angle), grazing)
            problem = LobeProblem(self, measured.table, weights)
            found = fit_separable(
                problem,
                latin_starts(starts, self.box("first"), self.box("last"), seed),
                lower,
                upper,
                linear=2,
                follow=follow,
                separation=0.02,
                max_iterations=150,
                tolerance=1e-6,
                enough=1e-10 if objective != "cosine" else 0.0,
            )
        except (NoFiniteStartError, ValueError) as error:
            raise FitError(f"{self.name} on {measured.name}: {error}") from None
        x, linear, value = found.x, found.linear, found.objective
        details: dict[str, Any] = {"starts": found.starts}
        if objective == "e2":
            found = self._refine_e2(measured.table, x, linear)
            x, linear, value = found.x[: x.size], found.x[x.size :].reshape(3, 2), found.objective
            details["starts"] = found.starts
        details["history"] = found.history
        shapes = self._sharpest_first([self.shape(values) for values in self.values(x)])
        parameters = {"kd": linear[:, 0] * np.pi, "ks": linear[:, 1]}
        for p in self.shape_parameters:
            parameters[p.name] = np.clip([shape[p.name] for shape in shapes], p.low, p.high)
        told = OBJECTIVE_NAMES[objective]
        if objective == "compressive":
            told = objective_words(objective, max_angle, grazing)
        value = np.sqrt(value) if objective == "cosine" else value
        return Result(parameters, float(value), told, found.iterations, found.converged, found.message, details)

    @abstractmethod
    def lobes(self, parameters: Parameters) -> list[Lobe]:
        """What each lobe is sampled by."""

    def sampler(self, parameters: Parameters) -> Mixture:
        """The mixture of Eqs. 40 to 42: each lobe weighs as much as the sum of ks, the diffuse term as that of kd."""
        kd, ks = (np.asarray(parameters[name], float).sum() for name in ("kd", "ks"))
        return mixture(kd, self.lobes(parameters), np.full(N_LOBES, ks))

    def _refine_e2(self, table: np.ndarray, x: np.ndarray, linear: np.ndarray) -> Solution:
        """Descend in E2 from the compressive optimum: E2 has no linear parameters, and costs a pass a step."""
        problem = _LogProblem(self, table)
        lower = np.concatenate([self.box("low"), np.zeros(6)])
        upper = np.concatenate([self.box("high"), np.full(6, np.inf)])
        start = np.concatenate([x, linear.ravel()])
        return fit_nonlinear(problem, start, lower, upper, follow=1, max_iterations=60, tolerance=1e-4)

    def shape(self, values: Mapping[str, float]) -> dict[str, float]:
        """The shape parameters of one lobe from its unknowns. Override where the two differ."""
        return dict(values)

    def slopes(self, shape: Mapping[str, float], slopes: Mapping[str, np.ndarray]) -> Mapping[str, np.ndarray]:
        """Derivatives by the unknowns from those by the shape parameters. Override where the two differ."""
        return slopes

    def box(self, side: str) -> np.ndarray:
        """ "low", "high", or a side of the box of starts: unknown by unknown, three lobes each."""
        pick = {"low": lambda u: u.low, "high": lambda u: u.high}
        pick |= {"first": lambda u: u.start[0], "last": lambda u: u.start[1]}
        bounds = [np.log(pick[side](u)) if u.logarithmic else pick[side](u) for u in self.unknowns]
        return np.repeat(np.array(bounds, float), N_LOBES)

    def values(self, x: np.ndarray) -> list[dict[str, float]]:
        """The unknowns of each lobe, from the fitted vector."""
        rows = x.reshape(-1, N_LOBES)
        return [
            {u.name: float(np.exp(row[j]) if u.logarithmic else row[j]) for u, row in zip(self.unknowns, rows)}
            for j in range(N_LOBES)
        ]

    def _sharpest_first(self, shapes: list[dict[str, float]]) -> list[dict[str, float]]:
        """The lobes have no order: the one with the highest peak comes first."""

        def peak(shape: dict[str, float]) -> float:
            return sum(float(value) for value, _ in self.amplitudes(shape, np.float64(1), np.float64(0), 1.0))

        return sorted(shapes, key=peak, reverse=True)

    @property
    def shape_parameters(self) -> tuple[Parameter, ...]:
        """The parameters of the lobes alone, each of shape (3,)."""
        return tuple(p for p in self.parameters if p.name not in ("kd", "ks"))

    @abstractmethod
    def amplitudes(self, shape: Mapping[str, Any], cos_h, sin_h, cos_d) -> list[Amplitude]:
        """amplitude_k of one lobe with the shape numbers ``shape`` and its derivatives, at broadcastable angles."""

    @abstractmethod
    def direction_factors(self, cos_i, cos_o, cos_h, cos_d) -> list[np.ndarray]:
        """factor_k at positive cosines: what does not depend on the parameters."""

    def lobe_sum(self, parameters: Parameters, cos_h, sin_h, cos_d) -> list[np.ndarray]:
        """sum_j amplitude_k(p_j) for every k."""
        total: list[np.ndarray] = []
        for j in range(N_LOBES):
            shape = {p.name: float(parameters[p.name][j]) for p in self.shape_parameters}
            found = [amplitude for amplitude, _ in self.amplitudes(shape, cos_h, sin_h, cos_d)]
            total = [a + b for a, b in zip(total, found)] if total else found
        return total

    def evaluate(self, parameters: Parameters, wi: np.ndarray, wo: np.ndarray) -> np.ndarray:
        """rgb (..., 3) in 1/sr at unit vectors (..., 3) above the surface (Eq. 3)."""
        wi, wo = np.broadcast_arrays(np.asarray(wi, float), np.asarray(wo, float))
        theta_h, theta_d, _ = half_difference(wi, wo)
        cos_h, sin_h, cos_d = np.cos(theta_h), np.sin(theta_h), np.cos(theta_d)
        amplitudes = self.lobe_sum(parameters, cos_h, sin_h, cos_d)
        factors = self.direction_factors(wi[..., 2], wo[..., 2], cos_h, cos_d)
        specular = sum(a * g for a, g in zip(amplitudes, factors))
        kd, ks = np.asarray(parameters["kd"], float), np.asarray(parameters["ks"], float)
        return kd / np.pi + ks * specular[..., None]

    def evaluate_grid(self, parameters: Parameters) -> np.ndarray:
        """As :meth:`Model.evaluate_grid`, by the separation above: the lobes cost 90 x 90 cells only."""
        theta_h, theta_d, _ = grid_axes()
        amplitudes = self.lobe_sum(parameters, np.cos(theta_h), np.sin(theta_h), np.cos(theta_d))
        factors = grid_factors(type(self))
        specular = sum(a.astype(np.float32) * g for a, g in zip(amplitudes, factors))
        table = np.empty((*GRID_SHAPE, 3), np.float32)
        for c in range(3):
            np.multiply(specular, np.float32(parameters["ks"][c]), out=table[..., c])
            table[..., c] += np.float32(parameters["kd"][c] / np.pi)
        return table


@cache
def grid_factors(model: type[LobeModel]) -> tuple[np.ndarray, ...]:
    """factor_k of a model on the MERL grid, read-only float32 of GRID_SHAPE; finite below the horizon too."""
    theta_h, theta_d, _ = grid_axes()
    cos_i, cos_o = (np.maximum(c, np.float32(1e-6)) for c in grid_cosines())
    factors = model().direction_factors(cos_i, cos_o, np.cos(theta_h), np.cos(theta_d))
    found = tuple(np.broadcast_to(g, GRID_SHAPE).astype(np.float32) for g in factors)
    for g in found:
        g.flags.writeable = False
    return found


class LobeProblem:
    """A weighted sum of squares of a lobe model, by exact sums over phi_d; see ``solvers.least_squares``."""

    def __init__(self, model: LobeModel, table: np.ndarray, weights: np.ndarray) -> None:
        self.model = model
        self.cells = CellMoments(weights, table, grid_factors(type(model)))
        self.derivatives = [(1, j) for j in range(len(model.unknowns) * N_LOBES)]

    def moments(self, x: np.ndarray, *, derivatives: bool) -> Moments:
        return self.cells.moments(lobe_columns(self.model, x, derivatives))


class _LogProblem:
    """Löw's E2 of a lobe model in (shapes, then kd/pi and ks of each channel)."""

    def __init__(self, model: LobeModel, table: np.ndarray) -> None:
        self.model = model
        weights = e2_weights(~np.isnan(table[..., 0]))
        self.cells = LogCells(table, weights, grid_cosines()[0], grid_factors(type(model)))

    def value(self, x: np.ndarray) -> float:
        return self.cells.value(lobe_columns(self.model, x[:-6], False)[0], x[-6:].reshape(3, 2))

    def normal_equations(self, x: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
        return self.cells.normal_equations(lobe_columns(self.model, x[:-6], True), x[-6:].reshape(3, 2))


def lobe_columns(model: LobeModel, x: np.ndarray, derivatives: bool) -> np.ndarray:
    """sum_j amplitude_k on the grid, then its derivative by each entry of the fitted vector: (1 [+ n], K, 90, 90)."""
    theta_h, theta_d, _ = grid_axes()
    cos_h, sin_h, cos_d = np.cos(theta_h[..., 0]), np.sin(theta_h[..., 0]), np.cos(theta_d[..., 0])
    columns = np.zeros((1 + (x.size if derivatives else 0), len(grid_factors(type(model))), *GRID_SHAPE[:2]))
    for j, values in enumerate(model.values(x)):
        shape = model.shape(values)
        for k, (value, by_shape) in enumerate(model.amplitudes(shape, cos_h, sin_h, cos_d)):
            columns[0, k] += value
            if derivatives:
                slopes = model.slopes(shape, by_shape)
                for row, unknown in enumerate(model.unknowns):
                    chain = values[unknown.name] if unknown.logarithmic else 1.0
                    columns[1 + row * N_LOBES + j, k] = slopes[unknown.name] * chain
    return columns
