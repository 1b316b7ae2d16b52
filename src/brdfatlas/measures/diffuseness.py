"""How diffuse a material is: D-bar of Bagher et al. 2016 (Eq. 19) of the naive model's D."""

import numpy as np

from brdfatlas.angles import cell_widths, theta_h_centres
from brdfatlas.constants import LUMINANCE
from brdfatlas.measured import Measured
from brdfatlas.models.bagher2016.naive import naive_problem
from brdfatlas.objectives import compressive_weight, importance_weight
from brdfatlas.solvers.acceleration import Trace, accelerate, alternate


def mean_of_d(d: np.ndarray) -> float:
    """2 pi int D cos sin dtheta of D with largest value 1 at the centres of the theta_h cells; pi if D is constant."""
    theta_h = theta_h_centres()
    weight = 2 * np.pi * np.cos(theta_h) * np.sin(theta_h) * cell_widths()[0]
    peak = float(np.max(d))
    return float(weight @ d / peak) if peak > 0 else 0.0


def diffuseness(measured: Measured) -> float:
    """D-bar of the luminance, in (0, pi]: small for a mirror, large for felt; NaN for a material without light.

    The naive model is fitted to the luminance alone (the paper averages three such fits), coarsely: D's shape is
    settled long before the last digit of the objective.
    """
    luminance = measured.table @ LUMINANCE.astype(np.float32)
    importance = importance_weight(measured.valid)
    if not importance.any():
        return float("nan")
    problem, start = naive_problem(compressive_weight(luminance, importance), luminance)
    if not problem.power > 0:
        return float("nan")
    state = problem.start(*start)
    trace = Trace([state.objective])
    state = alternate(problem, state, trace, sweeps=8, tolerance=1e-4)
    state = accelerate(problem, state, trace, steps=8, tolerance=1e-3)
    return mean_of_d(state.u)


#: Upper limits of D-bar for the classes, from 24 materials: chrome to brass and the hard plastics lie below 0.0008,
#: metallic paints, nickel, nylon and rubber between 0.0024 and 0.6, fabric, latex and felt above 1.2.
SPECULAR_LIMIT, GLOSSY_LIMIT = 0.0015, 0.9


def material_class(value: float) -> str:
    """ "specular", "glossy" or "diffuse" by :func:`diffuseness`; a material without light counts as diffuse."""
    if not np.isfinite(value):
        return "diffuse"
    return "specular" if value < SPECULAR_LIMIT else "glossy" if value < GLOSSY_LIMIT else "diffuse"
