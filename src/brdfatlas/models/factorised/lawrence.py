"""Non-negative factors of the BRDF times the cosine (Lawrence et al. 2004), a reconstruction."""

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np

from brdfatlas.angles import GRID_SHAPE, directions, grid_cosines, phi_d_centres, theta_d_centres
from brdfatlas.constants import LUMINANCE, MAX_ANGLE
from brdfatlas.measured import Measured, extend
from brdfatlas.models.base import FitError, Model, Option, Paper, Parameter, Parameters, Result
from brdfatlas.models.factorised.half_outgoing import (
    grid_coordinates,
    half_outgoing,
    parse_resolution,
    positions,
    resolution_option,
    theta_h_nodes,
)
from brdfatlas.solvers.nmf import Factors, Samples, factorize
from brdfatlas.solvers.tensor import bilinear_rows, sum_terms

RESOLUTION = (128, 16, 16)
#: J of each class, Table 2 of the supplement of Bilgili et al. 2011; K is 1 for all
TERMS_OF_CLASS = {"diffuse": 4, "glossy": 4, "specular": 2, "highly specular": 3}
MOST_TERMS = 4


class Lawrence(Model):
    """f(wi, wo) cos theta_i as a sum of J terms F_j(wo) sum_k u_jk(theta_h) v_jk(phi_h), all non-negative.

    phi_h is measured from the azimuth of wo (see :mod:`half_outgoing`), so for an isotropic BRDF the published 16 x 16
    nodes of wo shrink to 16 of theta_o. Colour is in F: factors of theta_h and phi_h are shared by the channels. All
    factors are fitted together by multiplicative updates; directions below the horizon are missing data.
    """

    name = "lawrence"
    title = "Lawrence non-negative factors"
    paper = Paper(
        authors="Jason Lawrence, Szymon Rusinkiewicz, Ravi Ramamoorthi",
        title="Efficient BRDF Importance Sampling Using a Factored Representation",
        venue="ACM Transactions on Graphics 23 (3)",
        year=2004,
        doi="10.1145/1015706.1015751",
    )
    equations = "resolution and terms: Bilgili et al. 2011, supplemental material, Table 2"
    formula = "rho (n·wi) = sum_{j=1..J} F_j(wo) sum_{k=1..K} u_jk(theta_h) v_jk(phi_h)"
    status = (
        "reconstruction: resolution and numbers of terms are those of Bilgili et al. 2011, Table 2; the class of a "
        "material is read from its highlight; the azimuth measured from wo, the weights and the joint solution are our "
        "choice"
    )
    reciprocal = False
    variable_size = True
    parameters = (
        Parameter("f", (RESOLUTION[2], 3, MOST_TERMS), "F_j along theta_o, rgb; one column a term", "1/sr", 0.0),
        Parameter("u", (RESOLUTION[0], MOST_TERMS), "u_j along theta_h, maximum 1", "", 0.0, 1.0),
        Parameter("v", (RESOLUTION[1], MOST_TERMS), "v_j along |phi_h - phi_o|, maximum 1", "", 0.0, 1.0),
    )
    options: ClassVar = {
        "terms": Option("auto", "J: by the class of the material (4, 2 or 3), or how many", ("auto", *range(1, 17))),
        "inner_terms": Option(1, "K, terms of theta_h and phi_h that share one F", low=1, high=8),
        "resolution": resolution_option(RESOLUTION),
    }

    def fit(self, measured: Measured, *, seed: int = 0, **options: Any) -> Result:
        """Fit from three starts, two of them random by ``seed``; the best goes on. FitError without a valid cell."""
        options = self.check_options(options)
        resolution = parse_resolution(options["resolution"], self.name)
        outer, inner = options["terms"], options["inner_terms"]
        if not measured.valid.any():
            raise FitError(f"{self.name} on {measured.name}: no valid cell")
        table = extend(measured.table, measured.valid)
        kind = highlight_class(table)
        if outer == "auto":
            outer = TERMS_OF_CLASS[kind]
        samples = outgoing_samples(measured, table, resolution)
        thin = samples.thinned(5)
        starts = [factorize(thin, start, max_iterations=40) for start in _starts(samples, outer, inner, seed)]
        best = min(range(len(starts)), key=lambda n: starts[n][1][-1])
        factors, history, converged = factorize(samples, starts[best][0], max_iterations=50, tolerance=5e-4)
        power = float((samples.weight * samples.value**2).sum())
        history = [error / power if power > 0 else error for error in history]
        return Result(
            {"f": factors.f, "u": factors.u, "v": factors.v},
            objective=history[-1],
            objective_name="relative square of f cos theta_i, weighted by 1 / (1 + f cos theta_i)^2",
            iterations=len(history),
            converged=converged,
            message=f"{kind}: {outer} x {inner} terms",
            details={
                "history": history,
                "class": kind,
                "terms": outer,
                "inner_terms": inner,
                "starts": [start[1][-1] for start in starts],
                "resolution": list(resolution),
            },
        )

    def shape_fault(self, parameters: Parameters, options: Mapping[str, Any]) -> str:
        n_h, n_p, n_o = parse_resolution(options["resolution"], self.name)
        outer = parameters["f"].shape[2] if options["terms"] == "auto" else options["terms"]
        columns = outer * options["inner_terms"]
        for name, shape in {"f": (n_o, 3, outer), "u": (n_h, columns), "v": (n_p, columns)}.items():
            if parameters[name].shape != shape:
                return f"{name} has shape {parameters[name].shape}, not {shape}"
        return ""

    def evaluate(self, parameters: Parameters, wi: np.ndarray, wo: np.ndarray) -> np.ndarray:
        wi, wo = np.broadcast_arrays(np.asarray(wi, float), np.asarray(wo, float))
        coordinates = half_outgoing(wi, wo)
        f, u, v = _by_channel(parameters)
        x, y, z = (p.ravel() for p in positions(*coordinates, (u.shape[-1], v.shape[-1], f.shape[-1])))
        out = np.empty((x.size, 3))
        sum_terms(np.ones(f.shape[:2]), u, v, f, x, y, z, out)
        return out.reshape(*coordinates[0].shape, 3) / _divisor(wi[..., 2])[..., None]

    def evaluate_grid(self, parameters: Parameters) -> np.ndarray:
        f, u, v = _by_channel(parameters)
        resolution = u.shape[-1], v.shape[-1], f.shape[-1]
        phi, theta_o = grid_coordinates()
        x, y, z = positions(theta_h_nodes(GRID_SHAPE[0]), phi, theta_o, resolution)
        low = np.minimum(x.astype(int), resolution[0] - 2)
        rows = u[..., low] + (x - low) * (u[..., low + 1] - u[..., low])
        tensor = np.stack([np.einsum("th,tp,to->hpo", rows[k], v[k], f[k], optimize=True) for k in range(3)], -1)
        out = np.empty((GRID_SHAPE[0], GRID_SHAPE[1] * GRID_SHAPE[2], 3), np.float32)
        bilinear_rows(tensor, y.reshape(out.shape[:2]), z.reshape(out.shape[:2]), out)
        return out.reshape(*GRID_SHAPE, 3) / _divisor(grid_cosines()[0])[..., None]


def _divisor(cosine: np.ndarray) -> np.ndarray:
    """cos theta_i, held at 89 degrees beyond them, where the quotient would explode and nothing was fitted."""
    return np.maximum(cosine, np.cos(MAX_ANGLE))


def _by_channel(parameters: Parameters) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """f, u, v as (channel, term, node), float64, with f repeated for its inner terms."""
    f, u, v = (np.asarray(parameters[name], float) for name in ("f", "u", "v"))
    f = np.repeat(f, u.shape[1] // f.shape[2], axis=2).transpose(1, 2, 0)
    return f, np.repeat(u.T[None], 3, 0), np.repeat(v.T[None], 3, 0)


def highlight_class(table: np.ndarray) -> str:
    """diffuse, glossy, specular or highly specular: by the height and the half width of the highlight over theta_h.

    ``table`` (90, 90, 180, 3) without NaN. The profile is the median luminance over phi_d and theta_d of 5 to 45
    degrees. Below ten times its level beyond 40 degrees a material is diffuse; else the theta_h at which the highlight
    halves tells: from 2 degrees glossy, from 0.5 specular. Nickel is then specular, as in Bilgili et al. 2011.
    """
    theta_h = theta_h_nodes(GRID_SHAPE[0])
    profile = np.median(table[:, 5:45, ::4] @ LUMINANCE.astype(np.float32), axis=(1, 2))
    base = np.median(profile[theta_h > np.deg2rad(40)])
    peak = profile[: GRID_SHAPE[0] // 2].max()
    if peak <= 10 * base or peak <= 0:
        return "diffuse"
    width = np.rad2deg(theta_h[np.flatnonzero(profile >= 0.5 * (peak + base)).max()])
    return "glossy" if width >= 2.0 else "specular" if width >= 0.5 else "highly specular"


def outgoing_samples(measured: Measured, table: np.ndarray, resolution: tuple[int, int, int]) -> Samples:
    """f cos theta_i at the theta_h nodes, every second theta_d and every fifth phi_d cell of the MERL grid.

    The weight 1 / (1 + y)^2 makes the square error that of log1p(y) for small errors. A hole above the horizon keeps a
    thousandth of it with its extended value, so that every entry of a factor is determined.
    """
    theta_h = theta_h_nodes(resolution[0])
    # some 200,000 pairs of directions for a few hundred numbers
    rows, columns = slice(None, None, 2), slice(2, None, 5)
    at = np.clip(np.sqrt(theta_h / (np.pi / 2)) * GRID_SHAPE[0] - 0.5, 0, GRID_SHAPE[0] - 1)
    low = np.minimum(at.astype(int), GRID_SHAPE[0] - 2)
    t = (at - low).astype(np.float32)[:, None, None]
    cells, known = table[:, rows, columns], measured.valid[:, rows, columns]
    f = (1 - t)[..., None] * cells[low] + t[..., None] * cells[low + 1]
    share = np.where(known[low], 1 - t, 0) + np.where(known[low + 1], t, 0)
    wi, wo = directions(
        theta_h[:, None, None], theta_d_centres()[None, rows, None], phi_d_centres()[None, None, columns]
    )
    above = np.minimum(wi[..., 2], wo[..., 2]) > np.cos(MAX_ANGLE)
    value = np.maximum(f, 0) * np.maximum(wi[..., 2:], 0)
    weight = np.where(above, share + 1e-3, 0.0)[..., None] / (1 + value) ** 2
    _, y, z = positions(*half_outgoing(wi, wo), resolution)
    n = len(theta_h)
    return Samples(
        value.reshape(n, -1, 3).astype(np.float64),
        weight.reshape(n, -1, 3).astype(np.float64),
        y.reshape(n, -1),
        z.reshape(n, -1),
        resolution[1],
        resolution[2],
    )


def _starts(samples: Samples, outer: int, inner: int, seed: int) -> list[Factors]:
    """Powers of the mean profile over theta_h, from the highlight to a constant, and two random variants of them."""
    n = outer * inner
    weight = samples.weight.sum((1, 2))
    profile = (samples.weight * samples.value).sum((1, 2)) / np.where(weight > 0, weight, 1)
    profile = np.maximum(profile / max(profile.max(), 1e-30), 1e-6)
    powers = np.linspace(1, 0, n) if n > 1 else np.ones(1)
    u = profile[:, None] ** powers
    size = max(float(samples.value.mean()), 1e-30)
    plain = Factors(u, np.ones((samples.n_v, n)), np.full((samples.n_f, 3, outer), size))
    rng = np.random.default_rng(seed)
    random = [
        Factors(*(array * rng.uniform(0.5, 1.5, array.shape) for array in (plain.u, plain.v, plain.f)))
        for _ in range(2)
    ]
    # no two columns alike, or they would stay alike for ever
    plain.v *= 1 + 0.1 * np.cos(np.outer(np.linspace(0, np.pi, samples.n_v), np.arange(n)))
    return [plain, *random]
