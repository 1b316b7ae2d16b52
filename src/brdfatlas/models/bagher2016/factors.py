"""What the non-parametric factor models share: weights, starts, storage and evaluation (Bagher et al. 2016).

Every colour channel is fitted by itself. D and F are tabulated at the centres of the 90 theta_h and 90 theta_d cells
(exact on the MERL grid, linear between the centres in cell coordinates, constant beyond the outer ones). G is linear
between 90 nodes spaced evenly over [0, pi/2] with both ends, and so are the two cosines of Eq. 3, as in the paper.
Nothing beyond 89 degrees is fitted: for a direction there, G / cos at 89 degrees stands.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any, ClassVar

import numpy as np

from brdfatlas.angles import (
    GRID_SHAPE,
    N_PHI_D,
    N_THETA_D,
    N_THETA_H,
    grid_axes,
    grid_cosines,
    half_difference,
    phi_d_centres,
    theta_d_centres,
    theta_h_centres,
)
from brdfatlas.compiled import njit
from brdfatlas.constants import MAX_ANGLE
from brdfatlas.measured import Measured
from brdfatlas.models.bagher2016.awls import (
    CLAMP,
    Channel,
    Geometry,
    g_nodes,
    interpolated,
    node_cosines,
    node_position,
)
from brdfatlas.models.bagher2016.microfacet_factors import FactorProblem
from brdfatlas.models.base import Factors, FitError, Function, Model, Option, Paper, Parameter, Parameters, Result
from brdfatlas.objectives import compressive_weights, relative_objective
from brdfatlas.solvers.acceleration import Problem, Trace, accelerate, alternate, thinned

BAGHER_2016 = Paper(
    "Bagher, Snyder, Nowrouzezahrai",
    "A Non-Parametric Factor Microfacet Model for Isotropic BRDFs",
    "ACM Transactions on Graphics 35(5)",
    2016,
    "10.1145/2907941",
)
OBJECTIVE = "compressive (relative)"
OPTIONS: Mapping[str, Option] = {
    "power": Option(1.4, "exponent p of the compressive weight; 0 fits without it", low=0.0, high=10.0),
    "max_angle": Option(89.0, "samples with theta_i or theta_o beyond this many degrees are left out", (89.0, 80.0)),
    "measure": Option("slice", "w_V as published, or the exact measure of direction pairs", ("slice", "pairs")),
}
ITERATIVE: Mapping[str, Option] = {
    **OPTIONS,
    "accelerate": Option(True, "joint steps between the published iterations; false: published iterations only"),
}
PLAIN_SWEEPS, PLAIN_TOLERANCE = 2000, 1e-6
COS_LIMIT = np.cos(MAX_ANGLE)
#: A channel is done when joint steps gain less than this share of the objective.
TOLERANCE = 2e-5


#: Where tables have their values, in words: who writes a shader has no more than these.
AT_H, AT_D = "at theta_h = 90 ((i + 0.5) / 90)^2 degrees", "at theta_d = i + 0.5 degrees"
AT_G = "at theta_i or theta_o = 90 i / 89 degrees, above 89 degrees with its cosine as at 89"


def factor(name: str, symbol: str, where: str, count: int = 90) -> Parameter:
    """A tabulated factor, linear between its values, one row a colour channel."""
    return Parameter(name, (3, count), f"{symbol} {where}; linear between, largest component 1", "1", 0.0, 1.0)


RHO_D = Parameter("rho_d", (3,), "diffuse coefficient, division by pi included", "1/sr", 0.0)
RHO_S = Parameter("rho_s", (3,), "specular coefficient, division by pi included", "1/sr", 0.0)
D, F, G = factor("d", "D", AT_H), factor("f", "F", AT_D), factor("g", "G", AT_G)
#: Parameters that are 1 where there is nothing to fit; coefficients and tables are 0 there.
FACTORS_OF_ONE = ("d", "f", "g", "h")


@dataclass
class ChannelFit:
    """What one channel's fit gives: parameters without the channel axis and how they were found."""

    parameters: dict[str, np.ndarray | float]
    objective: float
    trace: Trace
    starts: list[dict[str, Any]]
    golden_calls: int = 0
    empty_components: int = 0


class FactorModel(Model):
    """A model fitted channel by channel with the compressive objective."""

    paper: ClassVar[Paper] = BAGHER_2016
    options: ClassVar[Mapping[str, Option]] = ITERATIVE

    def weights(self, measured: Measured, options: Mapping[str, Any]) -> np.ndarray:
        """Weights of the objective, (90, 90, 180, 3). FitError if no sample has any."""
        limit = np.deg2rad(options["max_angle"])
        try:
            return compressive_weights(
                measured.table, power=options["power"], measure=options["measure"], max_angle=limit
            )
        except ValueError:
            raise FitError(f"{self.name} on {measured.name}: no valid sample below the angular limit") from None

    def fit(self, measured: Measured, *, seed: int = 0, **options: Any) -> Result:
        options = self.check_options(options)
        weights = self.weights(measured, options)
        fits = self.fit_channels(measured, weights, seed, options)
        parameters = {
            p.name: np.stack([np.asarray(fit.parameters[p.name]) for fit in fits]).astype(p.dtype)
            for p in self.parameters_of(options)
        }
        objective = relative_objective(self.evaluate_grid(parameters), measured.table, weights)
        if not np.isfinite(objective):
            raise FitError(f"{self.name} on {measured.name}: the objective is not finite")
        return Result(
            parameters,
            objective,
            OBJECTIVE,
            iterations=sum(fit.trace.iterations for fit in fits),
            converged=all(fit.trace.converged for fit in fits),
            details={
                "channels": [
                    {
                        "objective": fit.objective,
                        "sweeps": fit.trace.sweeps,
                        "joint_steps": fit.trace.joint_steps,
                        "golden_section_calls": fit.golden_calls,
                        "empty_components": fit.empty_components,
                        "starts": fit.starts,
                        "history": thinned(fit.trace.history),
                    }
                    for fit in fits
                ],
                "golden_section_calls": sum(fit.golden_calls for fit in fits),
            },
        )

    def fit_channels(
        self, measured: Measured, weights: np.ndarray, seed: int, options: Mapping[str, Any]
    ) -> list[ChannelFit]:
        """One fit a channel, from merged samples; a channel that is 0 everywhere has no factors to find."""
        return [
            self.fit_channel(channel, seed, options, c) if channel.power > 0 else self.dark(options)
            for c, channel in enumerate(merged_channels(measured, weights))
        ]

    def fit_channel(self, channel: Channel, seed: int, options: Mapping[str, Any], index: int) -> ChannelFit:
        raise NotImplementedError

    def dark(self, options: Mapping[str, Any]) -> ChannelFit:
        """The fit of a channel that is 0 everywhere: coefficients and tables 0, factors 1."""
        values: dict[str, np.ndarray | float] = {
            p.name: np.full(p.shape[1:], float(p.name in FACTORS_OF_ONE)) for p in self.parameters_of(options)
        }
        return ChannelFit(values, 0.0, Trace([0.0], converged=True), [])


def merged_channels(measured: Measured, weights: np.ndarray) -> list[Channel]:
    """The three channels with phi_d and pi - phi_d merged."""
    geometry = Geometry.of(weights[..., 0] > 0)
    return [Channel.of(geometry, weights[..., c], measured.table[..., c]) for c in range(3)]


def descend(problem: Problem, state: Any, trace: Trace, options: Mapping[str, Any], *, sweeps=5, steps=60) -> Any:
    """From a start to the end: published iterations, then joint steps, then published iterations that check the end;
    or published iterations only."""
    if not trace.history:
        trace.note(state)
    if not options["accelerate"]:
        return alternate(problem, state, trace, sweeps=PLAIN_SWEEPS, tolerance=PLAIN_TOLERANCE)
    state = alternate(problem, state, trace, sweeps=sweeps, tolerance=1e-8)
    trace.converged = False
    return accelerate(problem, state, trace, steps=steps, tolerance=TOLERANCE)


def best_descent(runs: list[tuple[str, Any, Any]], options: Mapping[str, Any], *, steps=60):
    """From several starts (name, problem, state): each followed a little, the best to its end; (problem, state,
    trace, reports)."""
    traces = [Trace() for _ in runs]
    states = [descend(problem, state, trace, options, sweeps=3, steps=10)
              for (_, problem, state), trace in zip(runs, traces)]  # fmt: skip
    best = min(range(len(runs)), key=lambda k: states[k].objective)
    problem, trace = runs[best][1], traces[best]
    if options["accelerate"] and not trace.converged:
        states[best] = accelerate(problem, states[best], trace, steps=steps, tolerance=TOLERANCE)
    power = problem.power
    reports = [
        {
            "name": name,
            "start_objective": trace.history[0] / power,
            "objective": state.objective / power,
            "iterations": trace.iterations,
            "history": thinned(relative(trace.history, power)),
        }
        for (name, _, _), state, trace in zip(runs, states, traces)
    ]
    trace.history = relative(trace.history, power)
    return problem, states[best], trace, reports


def relative(history: list[float], power: float) -> list[float]:
    """A convergence curve as shares of sum w rho^2."""
    return [value / power for value in history]


def nearest_filled(values: np.ndarray, known: np.ndarray) -> np.ndarray:
    """``values`` with every entry outside ``known`` replaced by the nearest known one."""
    from scipy.ndimage import distance_transform_edt

    if known.all() or not known.any():
        return values
    index = distance_transform_edt(~known, return_distances=False, return_indices=True)
    return values[tuple(index)]


@cache
def fitted_cells() -> np.ndarray:
    """Whether a full table has samples of the objective in a cell (theta_h, theta_d) at any phi_d, bool (90, 90)."""
    cos_i, cos_o = grid_cosines()
    return (np.minimum(cos_i, cos_o) >= COS_LIMIT).any(-1)


def mean_table(channel: Channel) -> np.ndarray:
    """The weighted mean over phi_d in each (theta_h, theta_d) cell (90, 90), cells without samples as the nearest."""
    w, wr = channel.sums
    return nearest_filled(np.where(w > 0, wr / np.where(w > 0, w, 1.0), 0.0), w > 0)


def slices(channel: Channel) -> tuple[np.ndarray, np.ndarray]:
    """D from the theta_d = 0 slice and F from theta_h = 0 (the paper's text swaps the two), each with largest 1."""
    table = mean_table(channel)
    d, f = table[:, 0], table[0]
    d, f = (x / x.max() if x.max() > 0 else np.ones(x.size) for x in (d, f))
    return np.maximum(d, CLAMP), np.maximum(f, CLAMP)


def factor_parameters(problem: FactorProblem, state: Any) -> dict[str, np.ndarray | float]:
    """rho_d, rho_s, d, f, g of a rank-1 state; D and F where no sample lies as at the nearest sample (but a D from
    which G derives has a say everywhere)."""
    w = problem.channel.sums[0]
    u = state.u[0] if problem.derived else nearest_filled(state.u[0], w.any(axis=1))
    v = nearest_filled(state.v[0], w.any(axis=0))
    scale_u, scale_v = u.max(), v.max()
    return {"rho_d": state.rho_d, "rho_s": scale_u * scale_v, "d": u / scale_u, "f": v / scale_v, "g": state.g}


# -- evaluation ------------------------------------------------------------------------------------------------------


def cell_position(angle_h: np.ndarray, angle_d: np.ndarray):
    """(low cell, share of the next) along theta_h and along theta_d, constant beyond the outer centres."""
    place = []
    for x, n in (
        (np.sqrt(angle_h / (np.pi / 2)) * N_THETA_H - 0.5, N_THETA_H),
        (angle_d / (np.pi / 2) * N_THETA_D - 0.5, N_THETA_D),
    ):
        x = np.clip(x, 0, n - 1)
        low = np.minimum(x.astype(np.int64), n - 2)
        place.append((low, x - low))
    return place


def interpolated_rows(rows: np.ndarray, place: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """Rows (..., n) at a place: (..., samples)."""
    low, share = place
    return rows[..., low] * (1 - share) + rows[..., low + 1] * share


def bilinear(tables: np.ndarray, place_h, place_d) -> np.ndarray:
    """Tables (3, 90, 90) between cell centres: (3, samples)."""
    (i, u), (j, v) = place_h, place_d
    low = tables[:, i, j] * (1 - v) + tables[:, i, j + 1] * v
    high = tables[:, i + 1, j] * (1 - v) + tables[:, i + 1, j + 1] * v
    return low * (1 - u) + high * u


def shadowing(g: np.ndarray, cosine: np.ndarray) -> np.ndarray:
    """G / cos, both linear between the nodes, of g (3, 90): (3, samples). Beyond 89 degrees, where no sample is
    fitted and G / cos may run away, the ratio at 89 degrees stands."""
    interval, place = node_position(np.maximum(cosine, COS_LIMIT))
    below = interpolated(node_cosines(), interval, place)
    return (g[:, interval] * (1 - place) + g[:, interval + 1] * place) / below


def evaluate_microfacet(m, g: np.ndarray, rho_d: np.ndarray, wi, wo) -> np.ndarray:
    """max(0, rho_d + M G G / (cos cos)) with ``m(place_h, place_d)`` -> (3, samples)."""
    wi, wo = np.broadcast_arrays(np.asarray(wi, float), np.asarray(wo, float))
    theta_h, theta_d, _ = (a.ravel() for a in half_difference(wi, wo))
    g = np.asarray(g, float)
    values = m(*cell_position(theta_h, theta_d))
    values = values * shadowing(g, wi[..., 2].ravel()) * shadowing(g, wo[..., 2].ravel())
    values = np.maximum(values + np.asarray(rho_d, float)[:, None], 0.0)
    return np.moveaxis(values, 0, -1).reshape(*wi.shape[:-1], 3)


@cache
def _half_grid() -> tuple[np.ndarray, ...]:
    """Interval and place of theta_i and theta_o, and 1 / (cos cos) (0 below the horizon), for phi_d < pi / 2."""
    theta_h, theta_d, phi_d = grid_axes()
    middle = np.cos(theta_h) * np.cos(theta_d)
    swing = np.sin(theta_h) * np.sin(theta_d) * np.cos(phi_d[..., : N_PHI_D // 2])
    ki, u = node_position(np.maximum(middle - swing, COS_LIMIT))
    ko, v = node_position(np.maximum(middle + swing, COS_LIMIT))
    below = interpolated(node_cosines(), ki, u) * interpolated(node_cosines(), ko, v)
    q = np.where(middle - swing > 0, 1.0 / below, 0.0)
    return ki.astype(np.uint8), ko.astype(np.uint8), u, v, q


@njit(cache=True, nogil=True)
def _fill_grid(ki, ko, u, v, q, m, g, rho_d, out):
    n_h, n_d, half = q.shape
    for h in range(n_h):
        for d in range(n_d):
            for p in range(half):
                i, o = ki[h, d, p], ko[h, d, p]
                x, y, factor = u[h, d, p], v[h, d, p], q[h, d, p]
                for c in range(3):
                    gi = g[c, i] + x * (g[c, i + 1] - g[c, i])
                    go = g[c, o] + y * (g[c, o + 1] - g[c, o])
                    value = max(rho_d[c] + m[c, h, d] * (gi * go * factor), 0.0)
                    out[h, d, p, c] = value
                    out[h, d, 2 * half - 1 - p, c] = value


def grid_microfacet(m: np.ndarray, g: np.ndarray, rho_d: np.ndarray) -> np.ndarray:
    """:func:`evaluate_microfacet` at every cell centre, m (3, 90, 90): (90, 90, 180, 3) float32."""
    out = np.empty((*GRID_SHAPE, 3), np.float32)
    _fill_grid(*_half_grid(), np.asarray(m, float), np.asarray(g, float), np.asarray(rho_d, float), out)
    return out


def curves(factors: Factors, over_h: str = "D", over_d: str = "F") -> tuple[Function, ...]:
    """The factors as functions, one of theta_h and one of theta_d a product, so named; what is 1 everywhere is left
    out."""
    found = []
    for d, f in zip(np.moveaxis(factors.d, 1, 0), np.moveaxis(factors.f, 1, 0)):
        found.append(Function(over_h, "theta_h", theta_h_centres(), d.T))
        found.append(Function(over_d, "theta_d", theta_d_centres(), f.T))
    if factors.g is not None:
        found.append(Function("G", "theta", g_nodes(), factors.g.T))
    if factors.h is not None:
        found.append(Function("H", "phi_d", phi_d_centres(), factors.h.T))
    return tuple(found)


def table_factors(table: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A table (3, 90, 90) over (theta_h, theta_d) as 90 products, d and f (3, 90, 90): row by row, d being 1 in one."""
    return np.broadcast_to(np.eye(N_THETA_H), table.shape), np.asarray(table, float)


class MicrofacetFactors(FactorModel):
    """rho_d + rho_s D(theta_h) F(theta_d) G(theta_i) G(theta_o) / (cos theta_i cos theta_o) (Eq. 3)."""

    parameters = (RHO_D, RHO_S, D, F, G)
    formula = r"\rho_d + \rho_s \frac{D(\theta_h) F(\theta_d) G(\theta_i) G(\theta_o)}{\cos\theta_i \cos\theta_o}"

    def evaluate(self, parameters: Parameters, wi, wo) -> np.ndarray:
        d, f, rho_s = (np.asarray(parameters[name], float) for name in ("d", "f", "rho_s"))
        return evaluate_microfacet(
            lambda h, x: rho_s[:, None] * interpolated_rows(d, h) * interpolated_rows(f, x),
            parameters["g"], parameters["rho_d"], wi, wo,
        )  # fmt: skip

    def evaluate_grid(self, parameters: Parameters) -> np.ndarray:
        d, f, rho_s = (np.asarray(parameters[name], float) for name in ("d", "f", "rho_s"))
        return grid_microfacet(np.einsum("c,ch,cd->chd", rho_s, d, f), parameters["g"], parameters["rho_d"])

    def factors(self, parameters: Parameters) -> Factors:
        p = {name: np.asarray(parameters[name], float) for name in ("rho_d", "rho_s", "d", "f", "g")}
        return Factors(p["rho_d"], p["d"][:, None], p["f"][:, None], g=p["g"], rho_s=p["rho_s"])

    def functions(self, parameters: Parameters) -> tuple[Function, ...]:
        return curves(self.factors(parameters))
