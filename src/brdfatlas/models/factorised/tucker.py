"""Twenty rank-one terms of the logarithm of the BRDF (Bilgili et al. 2011), a reconstruction."""

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np

from brdfatlas.angles import GRID_SHAPE
from brdfatlas.measured import Measured, extend, look_up
from brdfatlas.models.base import FitError, Model, Option, Paper, Parameter, Parameters, Result
from brdfatlas.models.factorised.half_outgoing import (
    grid_coordinates,
    half_outgoing,
    node_directions,
    parse_resolution,
    phi_nodes,
    positions,
    resolution_option,
    theta_h_nodes,
    theta_o_nodes,
)
from brdfatlas.solvers.tensor import bilinear_rows, residual_terms, sum_terms

TERMS = 20
RESOLUTION = (90, 36, 37)
#: largest log1p(f) that evaluate returns: f < 5e8, above every measurement. It guards sums where no data were.
LARGEST_LOG = 20.0


def tucker_parameters(terms: int, resolution: tuple[int, int, int]) -> tuple[Parameter, ...]:
    """Four factors a term and channel, in double precision as published."""
    factors = zip(("theta_h", "phi_h", "theta_o"), ("theta_h", "|phi_h - phi_o|", "theta_o"), resolution)
    unit = [
        Parameter(name, (3, terms, n), f"factor along {axis}, unit length", "", -1.0, 1.0, "float64")
        for name, axis, n in factors
    ]
    told = "factor along phi_o, constant for an isotropic BRDF"
    return (*unit, Parameter("phi_o", (3, terms, 1), told, "log(1 + rho sr)", 0.0, np.inf, "float64"))


class Tucker(Model):
    """log1p f(theta_h, phi_h, theta_o, phi_o) as a sum of 20 products of four one-dimensional factors per channel.

    Each term is the best rank-(1,1,1,1) approximation, by higher-order power iteration, of what the terms before leave
    over. phi_h is measured from the azimuth of wo (see :mod:`half_outgoing`), so the fourth factor, along phi_o, has
    one entry: the scale of the term. Directions below the horizon and unmeasured cells are missing data, not zeros.
    """

    name = "tucker"
    title = "Tucker factors, 20 terms"
    paper = Paper(
        authors="Ahmet Bilgili, Aydın Öztürk, Murat Kurt",
        title="A General BRDF Representation Based on Tensor Decomposition",
        venue="Computer Graphics Forum 30 (8)",
        year=2011,
        doi="10.1111/j.1467-8659.2011.02072.x",
    )
    equations = "rank-(1,1,1,1) terms of successive residuals"
    formula = "log(1 + rho) = sum_{t=1..20} f_t(theta_h) g_t(phi_h) h_t(theta_o) k_t(phi_o)"
    status = (
        "reconstruction: the paper's programs and sampling are not public. 20 terms and 77 KB are as published; the "
        "resolution of each axis, the azimuth measured from wo, and the weights are our choice"
    )
    reciprocal = False
    parameters = tucker_parameters(TERMS, RESOLUTION)
    options: ClassVar = {
        "terms": Option(TERMS, "number of rank-one terms", low=1, high=200),
        "resolution": resolution_option(RESOLUTION),
    }

    def parameters_of(self, options: Mapping[str, Any]) -> tuple[Parameter, ...]:
        chosen = self.check_options(options)
        return tucker_parameters(chosen["terms"], parse_resolution(chosen["resolution"], self.name))

    def fit(self, measured: Measured, *, seed: int = 0, **options: Any) -> Result:
        """Fit by residual terms. Deterministic, ``seed`` is not used. FitError without a valid cell."""
        options = self.check_options(options)
        terms = options["terms"]
        resolution = parse_resolution(options["resolution"], self.name)
        if not measured.valid.any():
            raise FitError(f"{self.name} on {measured.name}: no valid cell")
        tensor, weight = log_tensor(measured, resolution)
        found = [residual_terms(tensor[..., c], weight[..., c], terms) for c in range(3)]
        history = np.array([channel[-1] for channel in found])
        power = history[:, :1]
        relative = np.mean(history / np.where(power > 0, power, 1.0), 0)
        names = ("theta_h", "phi_h", "theta_o")
        parameters = {name: np.stack([channel[1 + n] for channel in found]) for n, name in enumerate(names)}
        parameters["phi_o"] = np.stack([channel[0] for channel in found])[..., None]
        return Result(
            parameters,
            objective=float(relative[-1]),
            objective_name="relative square of log1p f, weighted by the slope of log1p(f cos)",
            iterations=terms,
            converged=True,
            message=f"{terms} terms leave {relative[-1]:.2e} of the square",
            details={"history": relative.tolist(), "resolution": [*resolution, 1]},
        )

    def evaluate(self, parameters: Parameters, wi: np.ndarray, wo: np.ndarray) -> np.ndarray:
        coordinates = half_outgoing(wi, wo)
        factors = [np.asarray(parameters[name], float) for name in ("theta_h", "phi_h", "theta_o")]
        resolution = tuple(factor.shape[-1] for factor in factors)
        x, y, z = (p.ravel() for p in positions(*coordinates, resolution))
        out = np.empty((x.size, 3))
        sum_terms(np.asarray(parameters["phi_o"], float)[..., 0], *factors, x, y, z, out)
        return np.expm1(np.clip(out, 0, LARGEST_LOG)).reshape(*coordinates[0].shape, 3)

    def evaluate_grid(self, parameters: Parameters) -> np.ndarray:
        a, b, c = (np.asarray(parameters[name], float) for name in ("theta_h", "phi_h", "theta_o"))
        resolution = a.shape[-1], b.shape[-1], c.shape[-1]
        phi, theta_o = grid_coordinates()
        x, y, z = positions(theta_h_nodes(GRID_SHAPE[0]), phi, theta_o, resolution)
        low = np.minimum(x.astype(int), resolution[0] - 2)
        rows = a[..., low] + (x - low) * (a[..., low + 1] - a[..., low])
        scaled = rows * np.asarray(parameters["phi_o"], float)
        tensor = np.stack([np.einsum("th,tp,to->hpo", scaled[k], b[k], c[k], optimize=True) for k in range(3)], -1)
        out = np.empty((GRID_SHAPE[0], GRID_SHAPE[1] * GRID_SHAPE[2], 3), np.float32)
        bilinear_rows(tensor, y.reshape(out.shape[:2]), z.reshape(out.shape[:2]), out)
        return np.expm1(np.clip(out, 0, LARGEST_LOG)).reshape(*GRID_SHAPE, 3)


def log_tensor(measured: Measured, resolution: tuple[int, int, int]) -> tuple[np.ndarray, np.ndarray]:
    """log1p f at the nodes and its weights, two arrays (n_h, n_phi, n_o, 3).

    The weight is the squared slope of log1p(f cos) to log1p(f), so that the fit is judged by light that arrives, times
    the share of measured cells around the node; cos is the larger of the two cosines, since a renderer swaps the
    directions. A hole above the horizon keeps a thousandth of its weight with the extended value, so that no entry of
    a factor is undetermined; below the horizon it is 0.
    """
    n_h, n_p, n_o = resolution
    theta_h = theta_h_nodes(n_h)[:, None, None]
    wi, wo = node_directions(theta_h, phi_nodes(n_p)[None, :, None], theta_o_nodes(n_o)[None, None, :])
    valid = measured.valid
    f = np.maximum(look_up(extend(measured.table, valid), wi, wo), 0)
    share = look_up(valid[..., None].astype(np.float32), wi, wo)
    above = wi[..., 2] > 0
    # pairs that graze on either side are measured badly, yet must not run away
    graze = np.clip(np.minimum(wi[..., 2:], wo[..., 2:]) / 0.1, 0, 1)
    cosine = np.maximum(wi[..., 2:], wo[..., 2:])
    slope = cosine * (1 + f) / (1 + f * cosine)
    return np.log1p(f), (slope**2 * graze * (share + 1e-3)) * above[..., None]
