"""The naive model of Bagher et al. 2016: an orthogonal factorisation in the coordinates of the measurement."""

import numpy as np

from brdfatlas.angles import GRID_SHAPE, N_PHI_D, half_difference
from brdfatlas.models.bagher2016.factors import (
    RHO_D,
    RHO_S,
    ChannelFit,
    D,
    F,
    FactorModel,
    cell_position,
    curves,
    descend,
    factor,
    interpolated_rows,
    nearest_filled,
    relative,
)
from brdfatlas.models.bagher2016.naive_factors import NaiveProblem
from brdfatlas.models.base import Factors, Function, Parameters
from brdfatlas.solvers.acceleration import Trace


def naive_problem(weights: np.ndarray, rho: np.ndarray) -> tuple[NaiveProblem, tuple[np.ndarray, ...]]:
    """One channel's problem and its start: D from the theta_d = 0 slice, F from theta_h = 0, H constant."""
    problem = NaiveProblem(weights, rho)
    w, wr = problem.w.sum(axis=1).reshape(GRID_SHAPE[:2]), problem.wr.sum(axis=1).reshape(GRID_SHAPE[:2])
    table = nearest_filled(np.where(w > 0, wr / np.where(w > 0, w, 1.0), 0.0), w > 0)
    d, f = (x / x.max() if x.max() > 0 else np.ones(x.size) for x in (table[:, 0], table[0]))
    peak = float(table.max())
    return problem, (np.maximum(d, 1e-6) * peak, np.maximum(f, 1e-6), np.ones(N_PHI_D))


class Naive(FactorModel):
    """rho_d + rho_s D(theta_h) F(theta_d) H(phi_d)."""

    name = "naive"
    title = "Naive factors"
    equations = "Eqs. 4, 7-18"
    formula = r"\rho_d + \rho_s D(\theta_h) F(\theta_d) H(\phi_d)"
    parameters = (RHO_D, RHO_S, D, F, factor("h", "H", "at phi_d = k + 0.5 degrees", 180))

    def fit_channels(self, measured, weights, seed, options) -> list[ChannelFit]:
        fits = []
        for c in range(3):
            problem, start = naive_problem(weights[..., c], measured.table[..., c])
            fits.append(self._descend(problem, start, options) if problem.power > 0 else self.dark(options))
        return fits

    def _descend(self, problem: NaiveProblem, start, options) -> ChannelFit:
        trace = Trace()
        state = descend(problem, problem.start(*start), trace, options)
        trace.history = relative(trace.history, problem.power)
        block = problem.w.reshape(GRID_SHAPE) > 0
        u, v = nearest_filled(state.u, block.any(axis=(1, 2))), nearest_filled(state.v, block.any(axis=(0, 2)))
        h = nearest_filled(state.h, block.any(axis=(0, 1)))
        scales = u.max(), v.max(), h.max()
        values = {"rho_d": state.rho_d, "rho_s": np.prod(scales)}
        values |= {name: x / scale for name, x, scale in zip("dfh", (u, v, h), scales)}
        start_report = {"name": "slices", "objective": state.objective / problem.power, "iterations": trace.iterations}
        return ChannelFit(values, state.objective / problem.power, trace, [start_report], 0, problem.empty_components)

    def factors(self, parameters: Parameters) -> Factors:
        p = {name: np.asarray(parameters[name], float) for name in ("rho_d", "rho_s", "d", "f", "h")}
        return Factors(p["rho_d"], p["d"][:, None], p["f"][:, None], h=p["h"], rho_s=p["rho_s"])

    def functions(self, parameters: Parameters) -> tuple[Function, ...]:
        return curves(self.factors(parameters))

    def evaluate(self, parameters: Parameters, wi, wo) -> np.ndarray:
        wi, wo = np.broadcast_arrays(np.asarray(wi, float), np.asarray(wo, float))
        theta_h, theta_d, phi_d = (a.ravel() for a in half_difference(wi, wo))
        d, f, h, rho_s, rho_d = (np.asarray(parameters[name], float) for name in ("d", "f", "h", "rho_s", "rho_d"))
        place_h, place_d = cell_position(theta_h, theta_d)
        x = (phi_d / np.pi * N_PHI_D - 0.5) % N_PHI_D  # periodic by reciprocity
        low = np.minimum(x.astype(np.int64), N_PHI_D - 1)
        share = x - low
        around = h[:, low] * (1 - share) + h[:, (low + 1) % N_PHI_D] * share
        values = rho_s[:, None] * interpolated_rows(d, place_h) * interpolated_rows(f, place_d) * around
        return np.moveaxis(values + rho_d[:, None], 0, -1).reshape(*wi.shape[:-1], 3)

    def evaluate_grid(self, parameters: Parameters) -> np.ndarray:
        d, f, h, rho_s, rho_d = (np.asarray(parameters[name], float) for name in ("d", "f", "h", "rho_s", "rho_d"))
        out = np.empty((*GRID_SHAPE, 3), np.float32)
        for c in range(3):
            m = (rho_s[c] * np.outer(d[c], f[c])).astype(np.float32)
            out[..., c] = m[:, :, None] * h[c].astype(np.float32) + np.float32(rho_d[c])
        return out
