"""The bivariate table times G with the table of low rank: the compression that Bagher et al. 2016 name in section 6.

Weighted low-rank approximation with a weight for every sample, not a truncated singular value decomposition of B,
which the paper found to do poorly.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from brdfatlas.models.bagher2016.awls import CLAMP, Channel
from brdfatlas.models.bagher2016.bivariate_g import fit_table
from brdfatlas.models.bagher2016.factors import (
    AT_D,
    AT_H,
    ITERATIVE,
    RHO_D,
    ChannelFit,
    FactorModel,
    G,
    best_descent,
    curves,
    evaluate_microfacet,
    fitted_cells,
    grid_microfacet,
    interpolated_rows,
    nearest_filled,
)
from brdfatlas.models.bagher2016.independent_g import SMOOTHING, slices_state
from brdfatlas.models.bagher2016.microfacet_factors import FactorProblem
from brdfatlas.models.base import Factors, Function, Option, Parameter, Parameters

#: A cell without samples is held near the value of the nearest cell that has some, by this share of its weight.
HOLD = 1e-2


def low_rank_parameters(rank: int) -> tuple[Parameter, ...]:
    """u, v, g, rho_d: 4 * 3 (180 rank + 91) bytes."""
    u = Parameter("u", (3, rank, 90), f"u_k {AT_H}; linear between, carries the scale", "1/sr")
    v = Parameter("v", (3, rank, 90), f"v_k {AT_D}; linear between, largest absolute value 1", "1", -1.0, 1.0)
    return (RHO_D, u, v, G)


def weighted_svd(table: np.ndarray, weight: np.ndarray, rank: int) -> tuple[np.ndarray, np.ndarray]:
    """u (rank, 90), v (rank, 90) of the best approximation for weights that are a product of a row's and a column's
    share: a start for the true weights."""
    row, column = np.sqrt(weight.sum(axis=1)), np.sqrt(weight.sum(axis=0))
    row, column = np.maximum(row, 1e-6 * row.max()), np.maximum(column, 1e-6 * column.max())
    left, values, right = np.linalg.svd(table * np.outer(row, column))
    root = np.sqrt(values[:rank])
    return (left[:, :rank] * root).T / row, right[:rank] * root[:, None] / column


class LowRank(FactorModel):
    """rho_d + sum_k u_k(theta_h) v_k(theta_d) G(theta_i) G(theta_o) / (cos cos), never below 0.

    Rank 2 takes less than 6 KB a material, rank 4 less than 10 KB.
    """

    name = "low_rank"
    title = "Low-rank table times G"
    status = "ours: weighted low-rank form of the model section 6 of the paper proposes"
    equations = "section 6, weighted low-rank approximation"
    formula = r"\rho_d + \frac{\sum_k u_k(\theta_h) v_k(\theta_d)\, G(\theta_i) G(\theta_o)}{\cos\theta_i \cos\theta_o}"

    options: Mapping[str, Option] = {**ITERATIVE, "rank": Option(2, "products in the sum", low=1, high=90)}
    parameters = low_rank_parameters(2)

    def title_of(self, options: Mapping[str, Any]) -> str:
        """The rank takes part in the name: "Rank-4 table times G"."""
        others = {key: value for key, value in options.items() if key != "rank"}
        title = super().title_of(others)
        return title.replace("Low-rank", f"Rank-{options['rank']}", 1) if "rank" in options else title

    def parameters_of(self, options: Mapping[str, Any]) -> tuple[Parameter, ...]:
        return low_rank_parameters(self.check_options(options)["rank"])

    def fit_channel(self, channel: Channel, seed: int, options, index: int) -> ChannelFit:
        """The better of two runs: from the table of ``bivariate_g``, cut to the rank, and from independent-G with
        the rest of that table as the further products."""
        rank = options["rank"]
        single = slices_state(channel, options)
        _, table, _, _ = fit_table(channel, options, single)
        # Cells that only a part of the material misses: the products that fit the others may be anything there.
        w = channel.sums[0]
        missed = fitted_cells() & (w <= 0)
        filled = np.where(missed, nearest_filled(table.m, w > 0), table.m)
        hold = np.where(missed, HOLD * nearest_filled(table.sums[1], w > 0), 0.0)
        starts = {"bivariate_g": (*weighted_svd(filled, table.sums[1] + hold, rank), table.g, table.rho_d)}
        weight = single.sums[1]
        rest = np.where(weight > 0, self._best_table(single) - single.m, 0.0)
        more_u, more_v = weighted_svd(rest, weight, rank - 1)
        # A small share of the rest: the true weights are not those of the singular value decomposition.
        u, v = np.concatenate([single.u, 1e-3 * more_u]), np.concatenate([single.v, more_v])
        starts["independent_g"] = u, v, single.g, single.rho_d
        runs = []
        for name, start in starts.items():
            problem = FactorProblem(
                channel, rank=rank, clamp=CLAMP, smoothing=SMOOTHING, signed=True, hold=(hold, filled)
            )
            runs.append((name, problem, problem.start(*start, best_scale=False)))
        problem, state, trace, reports = best_descent(runs, options)
        u = np.stack([nearest_filled(row, w.any(axis=1)) for row in state.u])
        v = np.stack([nearest_filled(row, w.any(axis=0)) for row in state.v])
        values = {"rho_d": state.rho_d, "u": u, "v": v, "g": state.g}
        objective = state.objective / channel.power
        return ChannelFit(values, objective, trace, reports, problem.golden_calls, problem.empty_components)

    @staticmethod
    def _best_table(state) -> np.ndarray:
        s1, s2, r1 = state.sums
        return np.where(s2 > 0, (r1 - state.rho_d * s1) / np.where(s2 > 0, s2, 1.0), state.m)

    def factors(self, parameters: Parameters) -> Factors:
        p = {name: np.asarray(parameters[name], float) for name in ("rho_d", "u", "v", "g")}
        return Factors(p["rho_d"], p["u"], p["v"], g=p["g"])

    def functions(self, parameters: Parameters) -> tuple[Function, ...]:
        """u_k and v_k, which may be negative, and G: neither a distribution nor a Fresnel term."""
        return curves(self.factors(parameters), "u", "v")

    def evaluate(self, parameters: Parameters, wi, wo) -> np.ndarray:
        u, v = (np.asarray(parameters[name], float) for name in ("u", "v"))
        return evaluate_microfacet(
            lambda h, d: (interpolated_rows(u, h) * interpolated_rows(v, d)).sum(axis=1),
            parameters["g"], parameters["rho_d"], wi, wo,
        )  # fmt: skip

    def evaluate_grid(self, parameters: Parameters) -> np.ndarray:
        u, v = (np.asarray(parameters[name], float) for name in ("u", "v"))
        return grid_microfacet(np.einsum("ckh,ckd->chd", u, v), parameters["g"], parameters["rho_d"])
