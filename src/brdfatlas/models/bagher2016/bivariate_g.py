"""The model that Bagher et al. 2016 propose in section 6 and could not yet fit: a bivariate table times G."""

import numpy as np

from brdfatlas.models.bagher2016.awls import Channel, g_nodes, node_cosines
from brdfatlas.models.bagher2016.factors import (
    AT_D,
    AT_H,
    RHO_D,
    ChannelFit,
    FactorModel,
    G,
    best_descent,
    bilinear,
    evaluate_microfacet,
    grid_microfacet,
    mean_table,
    nearest_filled,
    table_factors,
)
from brdfatlas.models.bagher2016.independent_g import SMOOTHING, slices_state
from brdfatlas.models.bagher2016.microfacet_factors import FactorState, TableProblem, TableState
from brdfatlas.models.base import Factors, Function, Parameter, Parameters
from brdfatlas.solvers.acceleration import Trace


def fit_table(channel: Channel, options, single: FactorState) -> tuple[TableProblem, TableState, Trace, list[dict]]:
    """The better of two runs: from the bivariate fit, which is G = cos, and from ``single``, a fit with independent G.

    The model contains both, and no step raises the objective, so the result is at least as good as either start.
    """
    starts = {
        "bivariate": (mean_table(channel), node_cosines(), 0.0),
        "independent_g": (single.m, single.g, single.rho_d),
    }
    runs = []
    for name, start in starts.items():
        problem = TableProblem(channel, clamp=0.0, smoothing=SMOOTHING)
        runs.append((name, problem, problem.start(*start)))
    return best_descent(runs, options)


class BivariateG(FactorModel):
    """rho_d + B(theta_h, theta_d) G(theta_i) G(theta_o) / (cos theta_i cos theta_o)."""

    name = "bivariate_g"
    title = "Bivariate table times G"
    equations = "section 6, fitted with Eqs. 7-14"
    formula = r"\rho_d + \frac{B(\theta_h, \theta_d) G(\theta_i) G(\theta_o)}{\cos\theta_i \cos\theta_o}"
    status = "ours: the model section 6 of the paper proposes; the fit is ours"
    parameters = (RHO_D, Parameter("b", (3, 90, 90), f"B {AT_H} and {AT_D}, linear between", "1/sr", 0.0), G)

    def fit_channel(self, channel: Channel, seed: int, options, index: int) -> ChannelFit:
        problem, state, trace, reports = fit_table(channel, options, slices_state(channel, options))
        w = channel.sums[0]
        values = {"rho_d": state.rho_d, "b": nearest_filled(state.m, w > 0), "g": state.g}
        objective = state.objective / channel.power
        return ChannelFit(values, objective, trace, reports, problem.golden_calls, problem.empty_components)

    def factors(self, parameters: Parameters) -> Factors:
        d, f = table_factors(parameters["b"])
        return Factors(np.asarray(parameters["rho_d"], float), d, f, g=np.asarray(parameters["g"], float))

    def functions(self, parameters: Parameters) -> tuple[Function, ...]:
        """G; B is a table."""
        return (Function("G", "theta", g_nodes(), np.asarray(parameters["g"], float).T),)

    def evaluate(self, parameters: Parameters, wi, wo) -> np.ndarray:
        b = np.asarray(parameters["b"], float)
        return evaluate_microfacet(lambda h, d: bilinear(b, h, d), parameters["g"], parameters["rho_d"], wi, wo)

    def evaluate_grid(self, parameters: Parameters) -> np.ndarray:
        return grid_microfacet(parameters["b"], parameters["g"], parameters["rho_d"])
