"""The microfacet factors of Bagher et al. 2016 with an independent G, from eight starts."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from brdfatlas.angles import theta_d_centres, theta_h_centres
from brdfatlas.measured import Measured
from brdfatlas.models.bagher2016.awls import CLAMP, N_NODES, Channel, node_cosines
from brdfatlas.models.bagher2016.factors import (
    ITERATIVE,
    TOLERANCE,
    ChannelFit,
    MicrofacetFactors,
    descend,
    factor_parameters,
    merged_channels,
    relative,
    slices,
)
from brdfatlas.models.bagher2016.g_from_d import fit_g_from_d
from brdfatlas.models.bagher2016.microfacet_factors import FactorProblem, FactorState, smoothing_matrix
from brdfatlas.models.base import FitError, Option, Result
from brdfatlas.models.sgd import N_AREA, SGD, distribution, fresnel, shadowing
from brdfatlas.solvers.acceleration import Trace, accelerate, alternate, thinned

#: Gaussian filter of G in nodes. The paper gives no width; 1 is the least that removes what it describes.
SMOOTHING = 1.0
RANDOM_STARTS = 4
#: A start is followed this far before the best are followed to the end.
FIRST_SWEEPS, FIRST_STEPS = 4, 14
#: Starts within this share of the best objective are followed to the end, at most so many that did not meet.
CLOSE, FOLLOWED = 0.02, 2
#: (d, f, g) of one channel as a start.
Factors = tuple[np.ndarray, np.ndarray, np.ndarray | None]


@dataclass
class Run:
    """One start of one channel."""

    name: str
    problem: FactorProblem
    state: FactorState
    trace: Trace = field(default_factory=Trace)


def slices_state(channel: Channel, options: Mapping[str, Any]) -> FactorState:
    """The fit from the slices with G = 1 alone: a start of larger models."""
    problem = FactorProblem(channel, clamp=CLAMP, smoothing=SMOOTHING)
    return descend(problem, problem.start(*slices(channel)), Trace(), options, steps=FIRST_STEPS)


def starting_factors(
    channel: Channel, seed: int, index: int, options: Mapping[str, Any], sgd: Factors | None
) -> dict[str, Factors]:
    """The starts of section 5: four random ones, ones, SGD (if there is such a model), G-from-D and the slices.

    The random G passes the filter that every G passes, so that it holds no oscillation which no update removes.
    """
    starts: dict[str, Factors] = {"slices": (*slices(channel), None)}
    _, state, _ = fit_g_from_d(channel, options)
    starts["g_from_d"] = (state.u[0], state.v[0], state.g)
    if sgd is not None:
        starts["sgd"] = sgd
    ones = np.ones(90)
    starts["ones"] = (ones, ones, None)
    random = np.random.default_rng([seed, index])
    for k in range(RANDOM_STARTS):
        d, f, g = random.uniform(CLAMP, 1.0, (3, N_NODES))
        starts[f"random {k + 1}"] = (d, f, smoothing_matrix(SMOOTHING) @ g)
    return starts


def follow_starts(
    channel: Channel, starts: Mapping[str, Factors], options: Mapping[str, Any], *, keep: bool = False
) -> list[Run]:
    """Follow every start, then the best and those close to it to the end; ``keep``: with the states on the way."""
    runs = []
    for name, (d, f, g) in starts.items():
        problem = FactorProblem(channel, clamp=options.get("clamp", CLAMP), smoothing=SMOOTHING)
        run = Run(name, problem, problem.start(d, f, g), Trace(states=[] if keep else None))
        run.trace.note(run.state)
        if options["accelerate"]:
            run.state = alternate(problem, run.state, run.trace, sweeps=FIRST_SWEEPS, tolerance=1e-8)
            run.state = accelerate(problem, run.state, run.trace, steps=FIRST_STEPS, tolerance=1e-4)
            run.trace.converged = False
        else:
            run.state = descend(problem, run.state, run.trace, options)
        runs.append(run)
    if options["accelerate"]:
        limit = min(run.state.objective for run in runs) * (1 + CLOSE)
        ends: list[float] = []
        for run in sorted(runs, key=lambda run: run.state.objective):
            # Starts that met at one point have one end.
            met = any(abs(run.state.objective - end) <= 1e-4 * end for end in ends)
            if run.state.objective <= limit and not met and len(ends) < FOLLOWED:
                ends.append(run.state.objective)
                run.state = alternate(run.problem, run.state, run.trace, sweeps=1, tolerance=0.0)
                run.state = accelerate(run.problem, run.state, run.trace, steps=60, tolerance=TOLERANCE)
    return runs


def fit_from_starts(channel: Channel, starts: Mapping[str, Factors], options: Mapping[str, Any]) -> ChannelFit:
    """The best of the ends of :func:`follow_starts`."""
    runs = follow_starts(channel, starts, options)
    best = min(runs, key=lambda run: run.state.objective)
    best.trace.history = relative(best.trace.history, channel.power)
    reports = [
        {
            "name": run.name,
            "objective": run.state.objective / channel.power,
            "iterations": run.trace.iterations,
            "golden_section_calls": run.problem.golden_calls,
            "history": thinned(run.trace.history if run is best else relative(run.trace.history, channel.power)),
        }
        for run in runs
    ]
    return ChannelFit(
        factor_parameters(best.problem, best.state), best.state.objective / channel.power, best.trace, reports,
        sum(run.problem.golden_calls for run in runs), best.problem.empty_components,
    )  # fmt: skip


def sgd_factors(measured: Measured, seed: int) -> list[Factors] | None:
    """D, F, G of a fit of the SGD model (Bagher et al. 2012) a channel; None if SGD has no fit for the material."""
    try:
        fitted = SGD().fit(measured, seed=seed).parameters
    except FitError:
        return None
    tan2, cos_d, cosine = np.tan(theta_h_centres()) ** 2, np.cos(theta_d_centres()), node_cosines()
    factors: list[Factors] = []
    for c in range(3):
        alpha, p, f0, f1 = (float(fitted[name][c]) for name in ("alpha", "p", "F0", "F1"))
        inverse_area, log_k = shadowing(alpha, p)[:2]
        g = cosine * np.interp(np.sqrt(cosine) * N_AREA, np.arange(N_AREA + 1), inverse_area[0])
        start = distribution(tan2, alpha, p, log_k[0])[0], fresnel(cos_d, f0, f1), g
        if not all(np.isfinite(x).all() and x.max() > 0 for x in start):
            return None
        factors.append(start)
    return factors


class IndependentG(MicrofacetFactors):
    """Independent D, F and G."""

    name = "independent_g"
    title = "Microfacet factors, independent G"
    equations = "Eqs. 3, 7-18"
    options: Mapping[str, Option] = {
        **ITERATIVE,
        "starts": Option("eight", "the paper's eight starts, or the slices only", ("eight", "slices")),
        "clamp": Option(
            CLAMP,
            "least value of D, F and G as a share of their largest; 1e-6 is published, too much for a peak 1e6 times "
            "as high as its surroundings, 0 leaves them free",
            low=0.0,
            high=0.1,
        ),
    }

    def fit(self, measured: Measured, *, seed: int = 0, **options: Any) -> Result:
        """As :meth:`MicrofacetFactors.fit`; ``details["bound"]`` counts the values of D that lie at the lower bound."""
        clamp = self.check_options(options)["clamp"]
        result = super().fit(measured, seed=seed, **options)
        d = result.parameters["d"]
        lit = d[d.max(1) > 0]  # a dark channel has no D
        held = int((lit <= clamp * (1 + 1e-3)).sum())
        result.details["bound"] = {"factor": "D", "value": clamp, "held": held, "count": d.size}
        if held:
            whose = "published lower bound" if clamp == CLAMP else "lower bound"
            result.message = f"{held} of {d.size} values of D lie at the {whose}, {clamp:g} of its largest"
        return result

    def convergence(self, measured: Measured, *, channel: int = 1, seed: int = 0, **options: Any) -> list[Run]:
        """How a fit with these options came to its end in one colour channel: its starts, each with the states after
        every iteration in ``trace.states``. FitError for a channel without light."""
        options = self.check_options(options)
        merged = merged_channels(measured, self.weights(measured, options))[channel]
        if not merged.power > 0:
            raise FitError(f"{self.name} on {measured.name}: channel {channel} is dark")
        sgd = sgd_factors(measured, seed)
        starts = starting_factors(merged, seed, channel, options, sgd[channel] if sgd else None)
        return follow_starts(merged, starts, options, keep=True)

    def fit_channels(self, measured, weights, seed, options):
        eight = options["starts"] == "eight"
        sgd = sgd_factors(measured, seed) if eight else None
        fits = []
        for c, channel in enumerate(merged_channels(measured, weights)):
            if not channel.power > 0:
                fits.append(self.dark(options))
                continue
            starts: Mapping[str, Factors] = {"slices": (*slices(channel), None)}
            if eight:
                starts = starting_factors(channel, seed, c, options, sgd[c] if sgd else None)
            fits.append(fit_from_starts(channel, starts, options))
        return fits
