"""What the models that engines use share: one compiled formula a model, and one fit for all of them.

A subclass states its parameters and ``kernel``, a compiled function of (parameters, samples, out). The same function
evaluates the model, puts it on the grid and, called with complex parameters, gives its derivatives: the imaginary part
of f(p + i h) over h is df/dp to the last digit (complex step; Squire and Trapp 1998, SIAM Review 40). So kernels
branch on real parts only, and a formula is written once.

A fit works on the MERL grid with neighbouring cells of phi_d and theta_d merged: a cell holds the sum of their weights
and the weighted mean of their values, which loses only how the model varies inside it. Many starts descend on coarse
cells, the best ends on fine ones; the objective that is reported is the full grid's.
"""

from abc import abstractmethod
from collections.abc import Callable, Mapping
from copy import copy
from dataclasses import dataclass
from functools import cache
from typing import Any, ClassVar

import numpy as np

from brdfatlas.angles import GRID_SHAPE, grid_cosines, phi_d_centres, theta_d_centres, theta_h_centres
from brdfatlas.compiled import njit
from brdfatlas.constants import MAX_ANGLE, OBJECTIVE_NAMES
from brdfatlas.files import shortest_number
from brdfatlas.measured import Measured
from brdfatlas.models.base import (
    FitError,
    Function,
    Model,
    Option,
    Parameters,
    Result,
    grazing_option,
    objective_option,
    objective_words,
)
from brdfatlas.objectives import e2_weights, graded_weights, within
from brdfatlas.solvers.least_squares import NoFiniteStartError, Solution, fit_nonlinear, latin_starts

#: The complex step. Its error is of the order of its square, so it may be this small, and nothing cancels.
STEP = 1e-30
STARTS = Option(96, "points at which a descent may start", low=1, high=10_000)
MAX_ANGLE_OPTION = Option(
    80.0,
    "theta_i, theta_o in degrees: under e2 samples within count, under compressive they count in full",
    low=1.0,
    high=89.0,
)
CHANNELS = Option(
    "together",
    "compressive only: one weight for rgb, that of the luminance, or the published one of each channel, under which a "
    "dark channel counts as much as a bright one and no highlight that all channels share has room",
    ("together", "apart"),
)
#: Fine cells, and coarse ones made of them: so many neighbours in theta_d are merged, so many cells of phi_d are left.
FINE, COARSER = (2, 9), (3, 3)

Kernel = Callable[[np.ndarray, np.ndarray, np.ndarray], None]


# Compiled pieces of formulas; parameters may be complex ----------------------------------------------------------


@njit(cache=True, nogil=True, error_model="numpy")
def square_root(z):
    """sqrt of a number > 0 that may carry a complex step: to first order in the step, which is all there is of it."""
    r = np.sqrt(z.real)
    return r + (z - z.real) * (0.5 / r)


@njit(cache=True, nogil=True, error_model="numpy")
def inverse(z):
    """1 / z in the same way, z.real not 0; several times faster than the complex division."""
    r = 1 / z.real
    return r - (z - z.real) * (r * r)


@njit(cache=True, nogil=True, error_model="numpy")
def ggx(sin2_h, alpha):
    """GGX's D in 1/sr at sin^2 theta_h (Walter et al. 2007, Eq. 33); exact at the peak of a narrow lobe."""
    base = alpha * alpha * (1 - sin2_h) + sin2_h
    return alpha * alpha * inverse(np.pi * base * base)


@njit(cache=True, nogil=True, error_model="numpy")
def root(cosine, alpha):
    """sqrt(alpha^2 + (1 - alpha^2) cos^2), with which G1 = 2 cos / (cos + root)."""
    squared = cosine * cosine
    return square_root(alpha * alpha * (1 - squared) + squared)


@njit(cache=True, nogil=True, error_model="numpy")
def visible_correlated(cos_i, cos_o, alpha):
    """G2 / (4 cos cos) of height-correlated Smith GGX (Heitz 2014, Eq. 99), without its 0 / 0 at grazing angles."""
    return 0.5 * inverse(cos_o * root(cos_i, alpha) + cos_i * root(cos_o, alpha))


@njit(cache=True, nogil=True, error_model="numpy")
def visible_separable(cos_i, cos_o, alpha):
    """G1 G1 / (4 cos cos) of Smith GGX (Walter et al. 2007, Eq. 34)."""
    return inverse((cos_i + root(cos_i, alpha)) * (cos_o + root(cos_o, alpha)))


@njit(cache=True, nogil=True, error_model="numpy")
def fifth(cosine):
    """(1 - cos)^5, Schlick's weight."""
    m = 1 - cosine
    return m * m * m * m * m


@njit(cache=True, nogil=True, error_model="numpy")
def fresnel(cosine, eta):
    """Unpolarised Fresnel reflectance of a dielectric, relative index eta >= 1."""
    g = square_root(eta * eta - 1 + cosine * cosine)
    above, below = g + cosine, g - cosine
    upper, lower = cosine * above - 1, cosine * below + 1
    ratio = below * inverse(above * lower)  # one division: of complex numbers it is what takes the time
    return 0.5 * ratio * ratio * (lower * lower + upper * upper)


# Samples ---------------------------------------------------------------------------------------------------------


def geometry(wi: np.ndarray, wo: np.ndarray) -> np.ndarray:
    """cos theta_i, cos theta_o, sin^2 theta_h, cos theta_d of unit vectors (..., 3); (n, 4), what kernels take."""
    wi, wo = np.broadcast_arrays(np.asarray(wi, float), np.asarray(wo, float))
    total = wi + wo
    squared = np.maximum(np.sum(total * total, -1), 1e-300)
    sin2_h = (total[..., 0] ** 2 + total[..., 1] ** 2) / squared
    columns = (wi[..., 2], wo[..., 2], sin2_h, np.minimum(0.5 * np.sqrt(squared), 1.0))
    return np.stack([np.maximum(c, 1e-12).ravel() if i != 2 else c.ravel() for i, c in enumerate(columns)], -1)


@cache
def grid_geometry() -> np.ndarray:
    """:func:`geometry` of the first half of the grid, phi_d < 90 degrees: (90, 90, 90, 4), read-only. The other half
    has theta_i and theta_o swapped."""
    theta_h, theta_d, phi_d = theta_h_centres()[:, None, None], theta_d_centres()[None, :, None], phi_d_centres()[:90]
    middle, swing = np.cos(theta_h) * np.cos(theta_d), np.sin(theta_h) * np.sin(theta_d) * np.cos(phi_d)
    columns = middle - swing, middle + swing, np.sin(theta_h) ** 2, np.cos(theta_d)
    out = np.stack([np.broadcast_to(c, middle.shape[:2] + (90,)) for c in columns], -1)
    out[..., :2] = np.maximum(out[..., :2], 1e-12)
    out.flags.writeable = False
    return out


@dataclass(frozen=True)
class Samples:
    """Merged cells: ``geometry`` (n, 4), ``weights`` and ``target`` (n, 3); the objective is
    ``rest`` + sum weights (g(f) - target)^2 with g(f) = f, or ln(1 + f cos theta_i) where ``logarithm``."""

    geometry: np.ndarray
    weights: np.ndarray
    target: np.ndarray
    rest: float
    logarithm: bool


class Grid:
    """A material's samples on the grid with an objective's weights, as they are or merged to fewer cells."""

    def __init__(
        self,
        table: np.ndarray,
        objective: str,
        max_angle: float = MAX_ANGLE,
        grazing: float = 0.0,
        *,
        together: bool = False,
    ) -> None:
        """``max_angle`` (radians), ``grazing`` and ``together``: of the compressive metric (:func:`graded_weights`).
        Raises ValueError where no sample counts."""
        half = grid_geometry()
        self.logarithm = objective == "e2"
        if self.logarithm:
            # its cos theta_i differs between a cell and its mirror image: both halves are kept
            mirrored = half[:, :, ::-1, [1, 0, 2, 3]]
            self.geometry = np.concatenate([half, mirrored], 2)
            self.weights, self.sums, self.power = _e2_sums(table)
            return
        weights = graded_weights(table, objective, max_angle, grazing, together=together)
        sums = weights * np.nan_to_num(table)
        self.power = float(np.einsum("hdpc,hdpc->", sums, np.nan_to_num(table)))
        self.geometry = half
        self.weights, self.sums = (a[:, :, :90] + a[:, :, : 90 - 1 : -1] for a in (weights, sums))

    def merged(self, theta_d: int, phi_d: int) -> "Grid":
        """``theta_d`` neighbours merged into one, and phi_d into ``phi_d`` cells: a cell's directions are the weighted
        mean of those that it replaces."""
        n_h, n_d, n_p = self.geometry.shape[:3]
        shape = (n_h, n_d // theta_d, theta_d, phi_d, n_p // phi_d, -1)
        each = self.weights.sum(-1, keepdims=True)
        merged = copy(self)
        merged.weights, merged.sums, places, total = (
            a.reshape(shape).sum((2, 4)) for a in (self.weights, self.sums, self.geometry * each, each)
        )
        merged.geometry = places / np.where(total > 0, total, 1)
        return merged

    @property
    def samples(self) -> Samples:
        """The cells that count."""
        keep = self.weights.sum(-1) > 0
        weights = self.weights[keep]
        target = self.sums[keep] / np.where(weights > 0, weights, 1)
        rest = self.power - float((weights * target**2).sum())
        return Samples(self.geometry[keep], weights, target, max(rest, 0.0), self.logarithm)


def _e2_sums(table: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """Weights, weights times ln(1 + rho cos theta_i), and the sum of weights times its square, of Löw 2012's E2."""
    cosine = np.maximum(grid_cosines()[0], 0)[..., None]
    value = np.log1p(np.maximum(np.nan_to_num(table) * cosine, 0)).astype(float)
    weights = np.repeat(e2_weights(~np.isnan(table[..., 0]))[..., None], 3, -1)
    return weights, weights * value, float((weights * value**2).sum())


# Models ----------------------------------------------------------------------------------------------------------


class EngineModel(Model):
    """A model of few parameters inside boxes, given by a compiled formula."""

    #: (p, samples (n, 4), out (n, 3)): rgb in 1/sr at :func:`geometry`; p and out float64, or complex128 both
    kernel: ClassVar[Kernel]
    options: ClassVar[Mapping[str, Option]] = {
        "objective": objective_option("compressive"),
        "max_angle": MAX_ANGLE_OPTION,
        "grazing": grazing_option(0.1),
        "channels": CHANNELS,
        "starts": STARTS,
    }
    #: parameters fitted by their logarithm, because they span decades
    logarithmic: ClassVar[tuple[str, ...]] = ()
    #: rgb parameters of which a channel changes the others' values
    coupled: ClassVar[tuple[str, ...]] = ()
    #: where starts are drawn, if not in the parameter's whole range
    start_ranges: ClassVar[Mapping[str, tuple[float, float]]] = {}
    #: how many starts descend on coarse cells, how many of their ends on fine ones
    follow: ClassVar[tuple[int, int]] = (8, 3)

    def fixed(self, options: Mapping[str, Any]) -> Mapping[str, float]:
        """Parameters that a fit with these options holds, and their values."""
        return {}

    def flat(self, parameters: Parameters) -> np.ndarray:
        """All numbers of a fit in the order of ``parameters``, float64."""
        return np.concatenate([np.asarray(parameters[p.name], float).ravel() for p in self.parameters])

    def named(self, flat: np.ndarray) -> dict[str, np.ndarray]:
        """The inverse of :meth:`flat`."""
        ends = np.cumsum([p.count for p in self.parameters])
        return {p.name: part for p, part in zip(self.parameters, np.split(flat, ends[:-1]))}

    def values(self, p: np.ndarray, samples: np.ndarray, out: np.ndarray) -> None:
        """The compiled formula, see ``kernel``."""
        type(self).kernel(p, samples, out)

    def folded(self, p: np.ndarray, samples: np.ndarray, out: np.ndarray) -> None:
        """The values as the grid holds them, where swapping the directions changes nothing: what is fitted."""
        self.values(p, samples, out)

    def evaluate(self, parameters: Parameters, wi: np.ndarray, wo: np.ndarray) -> np.ndarray:
        samples = geometry(wi, wo)
        out = np.empty((len(samples), 3))
        self.values(self.flat(parameters), samples, out)
        return out.reshape(*np.broadcast_shapes(np.shape(wi), np.shape(wo)))

    def evaluate_grid(self, parameters: Parameters) -> np.ndarray:
        table, p = np.empty((*GRID_SHAPE, 3), np.float32), self.flat(parameters)
        out = np.empty((90 * 90, 3))
        for row, samples in enumerate(grid_geometry()):
            self.folded(p, samples.reshape(-1, 4), out)
            table[row, :, :90] = out.reshape(90, 90, 3)
        table[:, :, 90:] = table[:, :, :90][:, :, ::-1]  # theta_i and theta_o swapped
        return table

    def fit(self, measured: Measured, *, seed: int = 0, **options: Any) -> Result:
        """The best of many starts inside the parameters' ranges. Raises FitError where no sample counts, or the
        objective is finite nowhere."""
        chosen = self.check_options(options)
        together = chosen["channels"] == "together"
        try:
            limit = np.deg2rad(chosen["max_angle"])
            table = within(measured.table, limit) if chosen["objective"] == "e2" else measured.table
            grid = Grid(table, chosen["objective"], limit, chosen["grazing"], together=together)
            space = Space(self, self.fixed(chosen))
            found, ends = self.best(space, grid, measured, chosen, seed)
        except (NoFiniteStartError, ValueError) as error:
            raise FitError(f"{self.name} on {measured.name}: {error}") from None
        parameters = self.named(space.natural(found.x))
        value = Problem(space, grid.samples).value(found.x)
        if chosen["objective"] == "cosine":
            value = float(np.sqrt(value))
        name = OBJECTIVE_NAMES[chosen["objective"]]
        if chosen["objective"] != "cosine":
            grazing = chosen["grazing"] if chosen["objective"] == "compressive" else None
            name = objective_words(chosen["objective"], chosen["max_angle"], grazing)
            name += ", one weight for rgb" if grazing is not None and together else ""
        message = "; ".join(filter(None, [found.message, *self.warnings(parameters, chosen)]))
        details = {"starts": ends, "history": found.history, "bounds": self.at_bounds(parameters, chosen)}
        return Result(parameters, value, name, found.iterations, found.converged, message, details)

    def starts(self, space: "Space", measured: Measured, options: Mapping[str, Any], seed: int) -> np.ndarray:
        """Starts spread over the ranges; an rgb parameter has the material's own hue, brightness is drawn."""
        drawn = latin_starts(options["starts"], np.zeros(space.size), np.ones(space.size), seed)
        mean = np.nan_to_num(np.nanmean(measured.table, axis=(0, 1, 2)))
        tint = np.clip(mean / mean.max(), 0.02, 1) if mean.max() > 0 else np.ones(3)
        lower, upper = space.bounds(narrow=True)
        starts = lower + drawn * (upper - lower)
        for first in space.colours:
            starts[:, first : first + 3] = lower[first] + drawn[:, first, None] * tint * (upper[first] - lower[first])
        return starts

    def best(
        self, space: "Space", grid: Grid, measured: Measured, options: Mapping[str, Any], seed: int
    ) -> tuple[Solution, list[tuple[float, float]]]:
        """The best minimum found, and the objective before and after the descent of every start on coarse cells."""
        return self._descend(space, grid, self.starts(space, measured, options, seed))

    def _descend(self, space: "Space", grid: Grid, starts: np.ndarray) -> tuple[Solution, list[tuple[float, float]]]:
        lower, upper = space.bounds()
        merged = grid.merged(*FINE)
        coarse, fine = Problem(space, merged.merged(*COARSER).samples), Problem(space, merged.samples)
        values = np.array([coarse.value(x) for x in starts])
        order = np.argsort(np.where(np.isfinite(values), values, np.inf), kind="stable")[: self.follow[0]]
        settings = {"follow": 1, "max_iterations": 40, "tolerance": 1e-4}
        rough = [fit_nonlinear(coarse, starts[s], lower, upper, **settings) for s in order]
        ends = [(float(values[s]), solution.objective) for s, solution in zip(order, rough)]
        best = sorted(rough, key=lambda solution: solution.objective)[: self.follow[1]]
        settings = {"follow": 1, "max_iterations": 25, "tolerance": 1e-4}
        close = [fit_nonlinear(fine, solution.x, lower, upper, **settings) for solution in best]
        start = min(close, key=lambda solution: solution.objective)
        found = fit_nonlinear(fine, start.x, lower, upper, follow=1, max_iterations=100, tolerance=1e-6)
        return found, ends

    # What a fit says of itself ------------------------------------------------------------------------------------

    def at_bounds(self, parameters: Parameters, options: Mapping[str, Any]) -> list[str]:
        """Fitted parameters at an end of their range, such as "metallic = 1" or "base_color (green) = 0"."""
        held, found = self.fixed(options), []
        for p in self.parameters:
            if p.name in held:
                continue
            for channel, value in zip(("red", "green", "blue"), parameters[p.name].ravel()):
                span = p.high - p.low
                for end in (p.low, p.high):
                    if abs(value - end) <= 1e-6 * span:
                        found.append(f"{p.name}{f' ({channel})' if p.count == 3 else ''} = {end:g}")
        return found

    def warnings(self, parameters: Parameters, options: Mapping[str, Any]) -> list[str]:
        """What a reader of the fit must know."""
        bounds = self.at_bounds(parameters, options)
        return [f"at a bound: {', '.join(bounds)}"] if bounds else []

    @abstractmethod
    def functions(self, parameters: Parameters) -> tuple[Function, ...]:
        """D, F and G1 where the model has them."""


class Space:
    """The vector that a fit moves: parameters that are not held, logarithms of some."""

    def __init__(self, model: EngineModel, fixed: Mapping[str, float]) -> None:
        self.model = model
        names = np.repeat([p.name for p in model.parameters], [p.count for p in model.parameters])
        self.free = np.flatnonzero([name not in fixed for name in names])
        self.base = np.array([fixed.get(name, 0.0) for name in names])
        self.log = np.isin(names[self.free], model.logarithmic)
        self.names = names[self.free]
        #: lower and upper ends of all numbers of the model, (2, n)
        self.ends = np.array([(p.low, p.high) for p in model.parameters for _ in range(p.count)]).T
        rgb = [p.name for p in model.parameters if p.count == 3 and p.name not in fixed]
        #: first entry of each colour in the vector
        self.colours = [int(np.flatnonzero(self.names == name)[0]) for name in rgb]
        separate = {int(np.flatnonzero(self.names == name)[0]) for name in rgb if name not in model.coupled}
        inside = {first + c for first in separate for c in range(3)}
        #: entries that are moved together for a derivative: channels that do not see each other
        self.groups = [(first, first + 1, first + 2) for first in sorted(separate)]
        self.groups += [(j,) for j in range(self.size) if j not in inside]

    @property
    def size(self) -> int:
        return len(self.free)

    def bounds(self, narrow: bool = False) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper ends; ``narrow``: of the starts."""
        ranges = {p.name: (p.low, p.high) for p in self.model.parameters}
        if narrow:
            ranges |= self.model.start_ranges
        lower, upper = np.array([ranges[name] for name in self.names], float).T
        return tuple(np.where(self.log, np.log(np.where(self.log, b, 1)), b) for b in (lower, upper))  # type: ignore

    def natural(self, x: np.ndarray) -> np.ndarray:
        """All numbers of the model; complex where x is."""
        p = self.base.astype(x.dtype)
        p[self.free] = np.where(self.log, np.exp(np.where(self.log, x, 0)), x)
        if x.dtype == float:  # rounding at a bound must not leave the range
            p = np.clip(p, *self.ends)
        return p


class Problem:
    """An objective on merged cells, for ``fit_nonlinear``."""

    def __init__(self, space: Space, samples: Samples) -> None:
        self.space, self.samples = space, samples
        self.root = np.sqrt(samples.weights)
        self.out = np.empty_like(samples.target)

    def _residual(self, x: np.ndarray) -> np.ndarray:
        s = self.samples
        self.space.model.folded(self.space.natural(x), s.geometry, self.out)
        value = np.log1p(np.maximum(self.out, 0) * s.geometry[:, :1]) if s.logarithm else self.out
        return self.root * (value - s.target)

    def value(self, x: np.ndarray) -> float:
        residual = self._residual(x).ravel()
        return float(residual @ residual) + self.samples.rest

    def jacobian(self, x: np.ndarray) -> np.ndarray:
        """d residual / dx, (size of x, n, 3)."""
        s = self.samples
        scale = self.root * (s.geometry[:, :1] / (1 + self.out * s.geometry[:, :1]) if s.logarithm else 1.0) / STEP
        rows, out = np.zeros((x.size, *s.target.shape)), np.empty(s.target.shape, complex)
        for group in self.space.groups:
            moved = x.astype(complex)
            moved[list(group)] += 1j * STEP
            self.space.model.folded(self.space.natural(moved), s.geometry, out)
            if len(group) == 1:
                rows[group[0]] = out.imag * scale
            else:
                for channel, j in enumerate(group):
                    rows[j, :, channel] = out.imag[:, channel] * scale[:, channel]
        return rows

    def normal_equations(self, x: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
        residual = self._residual(x).ravel()
        rows = self.jacobian(x).reshape(x.size, -1)
        return float(residual @ residual) + self.samples.rest, rows @ residual, rows @ rows.T


def shortest(values: np.ndarray) -> list[float]:
    """Numbers with the fewest decimals that give back the stored ones."""
    return [shortest_number(value) for value in np.asarray(values).ravel()]


def microfacet_functions(alphas: Mapping[str, float], fresnel_values: np.ndarray) -> tuple[Function, ...]:
    """D and G1 of GGX lobes, symbol suffix -> alpha, and F at the grid's theta_d, (90,) or (90, 3)."""
    theta_h, theta_d = theta_h_centres(), theta_d_centres()
    theta = np.linspace(0, np.pi / 2, 91)
    cosine = np.cos(theta)
    made = []
    for suffix, alpha in alphas.items():
        made.append(Function(f"D{suffix}", "theta_h", theta_h, ggx(np.sin(theta_h) ** 2, alpha), "1/sr"))
        made.append(Function(f"G1{suffix}", "theta", theta, 2 * cosine / (cosine + root(cosine, alpha))))
    return (*made, Function("F", "theta_d", theta_d, fresnel_values))
