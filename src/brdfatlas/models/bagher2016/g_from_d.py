"""The microfacet factors of Bagher et al. 2016 with G derived from D by Smith's integral."""

from brdfatlas.models.bagher2016.awls import Channel
from brdfatlas.models.bagher2016.factors import (
    ChannelFit,
    MicrofacetFactors,
    descend,
    factor_parameters,
    relative,
    slices,
)
from brdfatlas.models.bagher2016.microfacet_factors import FactorProblem, g_from_d
from brdfatlas.solvers.acceleration import Trace


def fit_g_from_d(channel: Channel, options) -> tuple[FactorProblem, object, Trace]:
    """One run from the slices, as published: the model hardly depends on its start."""
    problem = FactorProblem(channel, derived=True)
    trace = Trace()
    state = descend(problem, problem.start(*slices(channel)), trace, options)
    return problem, state, trace


class GFromD(MicrofacetFactors):
    """Independent D and F; G = 1 / (1 + Lambda) with Lambda an integral of D."""

    name = "g_from_d"
    title = "Microfacet factors, G from D"
    equations = "Eqs. 3, 7-19"

    def fit_channel(self, channel: Channel, seed: int, options, index: int) -> ChannelFit:
        problem, state, trace = fit_g_from_d(channel, options)
        trace.history = relative(trace.history, channel.power)
        values = factor_parameters(problem, state)
        values["g"] = g_from_d(values["d"])
        start = {"name": "slices", "objective": state.objective / channel.power, "iterations": trace.iterations}
        return ChannelFit(
            values, state.objective / channel.power, trace, [start], problem.golden_calls, problem.empty_components
        )
