"""The shifted gamma distribution (SGD) microfacet model (Bagher, Soler, Holzschuch 2012), per colour channel.

rho = (1/pi) [rho_d + rho_s D(theta_h) F(theta_d) G1(theta_i) G1(theta_o) / (cos theta_i cos theta_o)]
t = alpha + tan^2(theta_h) / alpha;   D = K exp(-t) t^(-p) / (pi cos^4 theta_h),   K = 1 / (alpha Gamma(1 - p, alpha))
F = F0 - F1 cos theta_d + (1 - F0) (1 - cos theta_d)^5

G1 is the Smith shadowing of that D. The authors publish a curve fitted to it (theta0, c, k, lambda; median error 6e-4),
so a fit has six free numbers a channel. They fitted D to the slice theta_d = 0 and F to theta_h = 0, up to 70 degrees;
here all six are fitted to all samples at once.

With G1 = cos / sigma, sigma the projected area, G1 G1 / (cos cos) is 1 / (sigma_i sigma_o), which is what the code
uses. F times rho_s is linear in three numbers: (1 - cos)^5, cos, and 1 - cos - (1 - cos)^5, the coefficients being
rho_s, rho_s (F0 - F1) and rho_s F0. All three functions are >= 0 on [0, 1], so coefficients >= 0 are what keeps the
lobe from being negative, and the fit solves them and rho_d linearly inside: only alpha and p are searched for.
"""

from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from typing import Any, ClassVar

import numpy as np

from brdfatlas.angles import GRID_SHAPE, grid_cosines, half_difference, theta_d_centres, theta_h_centres
from brdfatlas.compiled import njit
from brdfatlas.constants import MAX_ANGLE, OBJECTIVE_NAMES
from brdfatlas.measured import Measured
from brdfatlas.microfacet import schlick_weight
from brdfatlas.models.base import (
    FitError,
    Function,
    Model,
    Option,
    Paper,
    Parameter,
    Parameters,
    Result,
    objective_option,
)
from brdfatlas.objectives import e2_weights, least_squares_weights
from brdfatlas.sampling import Mixture, SgdLobe, mixture
from brdfatlas.solvers.least_squares import Moments, NoFiniteStartError, Solution, fit_separable, latin_starts

#: F stays below this at any angle: the least share of (1 - cos)^5 in every Fresnel term is its inverse.
MAX_FRESNEL = 100.0
#: Nodes of 1 / sigma, at cosines (k / N_AREA)^2: dense at grazing angles, where it bends.
N_AREA = 128
N_HALF = GRID_SHAPE[2] // 2
#: How many neighbouring phi_d are taken together while starts are tried.
GROUP = 10
QUADRATURE = np.polynomial.legendre.leggauss(64)


class SGD(Model):
    """Six numbers a channel; G1 follows from alpha and p by the Smith integral."""

    name = "sgd"
    title = "Shifted gamma distribution"
    paper = Paper(
        "Mahdi M. Bagher, Cyril Soler, Nicolas Holzschuch",
        "Accurate fitting of measured reflectances using a Shifted Gamma micro-facet distribution",
        "Computer Graphics Forum 31 (4)",
        2012,
        "10.1111/j.1467-8659.2012.03147.x",
    )
    equations = "Sections 3 and 4"
    formula = (
        "rho = (1/pi) (rho_d + rho_s D F G1(theta_i) G1(theta_o) / (cos theta_i cos theta_o)); "
        "D = K exp(-t) t^-p / (pi cos^4 theta_h), t = alpha + tan^2(theta_h)/alpha; "
        "F = F0 - F1 cos theta_d + (1 - F0)(1 - cos theta_d)^5"
    )
    parameters = (
        Parameter("rho_d", (3,), "diffuse albedo, rgb", "", 0.0),
        Parameter("rho_s", (3,), "specular scale, rgb", "", 0.0),
        Parameter("alpha", (3,), "width of the distribution, rgb", "", 1e-7, 20.0),
        Parameter("p", (3,), "fall-off of the distribution, rgb (published up to 1.78)", "", 0.0, 4.0),
        Parameter("F0", (3,), "constant part of the Fresnel term, rgb", "", 0.0, MAX_FRESNEL),
        Parameter("F1", (3,), "part of the Fresnel term with cos theta_d, rgb", "", -MAX_FRESNEL, MAX_FRESNEL),
    )
    #: theta0, c, k, lambda are left: they approximate the Smith G1 of D, which is what is evaluated here
    public_names: ClassVar[Mapping[str, tuple[str, float]]] = {
        "rho_d": ("Lambertian.albedo", 1.0),
        "rho_s": ("Bagher.albedo", 1.0),
        "alpha": ("Bagher.alpha", 1.0),
        "p": ("Bagher.p", 1.0),
        "F0": ("Bagher.eta.0", 1.0),
        "F1": ("Bagher.eta.1", 1.0),
    }
    options: ClassVar[Mapping[str, Option]] = {
        "objective": objective_option("compressive"),
        "starts": Option(48, "how many starts are tried in each channel", low=1, high=10_000),
    }

    def fit(self, measured: Measured, *, seed: int = 0, **options: Any) -> Result:
        """Least squares over alpha and p in each channel, everything else linear inside.

        All samples of the objective count; phi_d and pi - phi_d share one model value and merge exactly. Raises
        FitError where no sample lies within 89 degrees.
        """
        chosen = self.check_options(options)
        parameters = {parameter.name: np.zeros(3) for parameter in self.parameters}
        found: list[Solution] = []
        try:
            weights = None
            if chosen["objective"] != "e2":
                weights = least_squares_weights(measured.table, chosen["objective"])
            for c in range(3):
                rho = measured.table[..., c]
                if weights is None:
                    solution = fit_channel_e2(rho, chosen["starts"], seed + c)
                else:
                    solution = fit_channel(weights[..., c], rho, chosen["starts"], seed + c)
                found.append(solution)
                alpha, p = np.exp(solution.x[0]), solution.x[1]
                numbers = natural(solution.linear[0])
                for name, value in zip(parameters, (*numbers[:2], alpha, p, *numbers[2:])):
                    parameters[name][c] = value
        except (NoFiniteStartError, ValueError) as error:
            raise FitError(f"{self.name} on {measured.name}: {error}") from None
        value = sum(solution.objective for solution in found)
        failed = [f"{name}: {s.message}" for name, s in zip(("red", "green", "blue"), found) if not s.converged]
        return Result(
            parameters,
            float(np.sqrt(value) if chosen["objective"] == "cosine" else value),
            OBJECTIVE_NAMES[chosen["objective"]],
            sum(solution.iterations for solution in found),
            not failed,
            "; ".join(failed),
            {"starts": [s.starts for s in found], "history": [s.history for s in found]},
        )

    def evaluate(self, parameters: Parameters, wi: np.ndarray, wo: np.ndarray) -> np.ndarray:
        wi, wo = np.broadcast_arrays(np.asarray(wi, float), np.asarray(wo, float))
        theta_h, theta_d, _ = half_difference(wi, wo)
        tan2 = np.tan(theta_h) ** 2
        rgb = np.empty((*theta_h.shape, 3))
        for c in range(3):
            rho_d, rho_s, alpha, p, f0, f1 = (float(parameters[q.name][c]) for q in self.parameters)
            inverse, log_k = shadowing(alpha, p)[:2]
            nodes = np.arange(N_AREA + 1)
            q_i, q_o = (np.interp(np.sqrt(np.clip(w[..., 2], 0, 1)) * N_AREA, nodes, inverse[0]) for w in (wi, wo))
            lobe = rho_s * distribution(tan2, alpha, p, log_k[0])[0] * fresnel(np.cos(theta_d), f0, f1) * q_i * q_o
            rgb[..., c] = (rho_d + lobe) / np.pi
        return rgb

    def evaluate_grid(self, parameters: Parameters) -> np.ndarray:
        table = np.empty((*GRID_SHAPE, 3), np.float32)
        tan2, cos_d = np.tan(theta_h_centres()) ** 2, np.cos(theta_d_centres())
        for c in range(3):
            rho_d, rho_s, alpha, p, f0, f1 = (float(parameters[q.name][c]) for q in self.parameters)
            inverse, log_k = shadowing(alpha, p)[:2]
            shape = rho_s * distribution(tan2, alpha, p, log_k[0])[0][:, None] * fresnel(cos_d, f0, f1)
            _fill(shape / np.pi, rho_d / np.pi, inverse[0], *area_positions(), table, c)
        return table

    def sampler(self, parameters: Parameters) -> Mixture:
        """One lobe a channel. Its albedo at normal incidence is 4/pi rho_s F(0), shadowing left out; F is averaged over
        the hemisphere instead, because fits may have F(0) = 0."""
        rho_d, rho_s, alpha, p, f0, f1 = (np.asarray(parameters[q.name], float) for q in self.parameters)
        fresnel_mean = f0 - f1 * (2 / 3) + (1 - f0) / 21  # int 2 cos F dcos
        weights = 4 / np.pi * rho_s * np.maximum(fresnel_mean, 0)
        return mixture(rho_d.sum(), [SgdLobe(float(a), float(b)) for a, b in zip(alpha, p)], weights)

    def functions(self, parameters: Parameters) -> tuple[Function, ...]:
        """D with int D cos = 1, F and the Smith G1, rgb."""
        theta_h, theta_d, theta = theta_h_centres(), theta_d_centres(), np.linspace(0, MAX_ANGLE, 90)
        d, f, g1 = np.empty((90, 3)), np.empty((90, 3)), np.empty((90, 3))
        for c in range(3):
            _, _, alpha, p, f0, f1 = (float(parameters[q.name][c]) for q in self.parameters)
            inverse, log_k = shadowing(alpha, p)[:2]
            d[:, c] = distribution(np.tan(theta_h) ** 2, alpha, p, log_k[0])[0]
            f[:, c] = fresnel(np.cos(theta_d), f0, f1)
            area = np.interp(np.sqrt(np.cos(theta)) * N_AREA, np.arange(N_AREA + 1), inverse[0])
            g1[:, c] = np.minimum(np.cos(theta) * area, 1)
        return (
            Function("D", "theta_h", theta_h, d, "1/sr"),
            Function("F", "theta_d", theta_d, f),
            Function("G1", "theta", theta, g1),
        )


def fresnel(cos_d, f0, f1):
    """F0 - F1 cos + (1 - F0)(1 - cos)^5."""
    return f0 - f1 * cos_d + (1 - f0) * schlick_weight(cos_d)


def fresnel_basis(cos_d: np.ndarray) -> np.ndarray:
    """Three functions >= 0 of cos theta_d whose combinations with coefficients >= 0 are rho_s F, with F >= 0 and
    F0, F0 - F1 <= MAX_FRESNEL; (3, n)."""
    grazing = schlick_weight(cos_d)
    least = grazing / MAX_FRESNEL
    return np.stack([grazing, cos_d + least, 1 - cos_d - grazing + least])


def natural(linear: np.ndarray) -> tuple[float, float, float, float]:
    """rho_d, rho_s, F0, F1 of the four linear coefficients (of columns with the 1/pi inside)."""
    rho_d, grazing, normal, middle = (float(value) for value in linear)
    rho_s = grazing + (normal + middle) / MAX_FRESNEL
    if rho_s <= 0:
        return rho_d, 0.0, 0.0, 0.0
    return rho_d, rho_s, middle / rho_s, (middle - normal) / rho_s


def distribution(tan2, alpha: float, p: float, log_k: float):
    """D, and ln D differentiated by ln alpha and by p but for the derivatives of ln K."""
    t = alpha + tan2 / alpha
    d = np.exp(log_k - t - p * np.log(t)) * (1 + tan2) ** 2 / np.pi
    return d, (alpha - tan2 / alpha) * (-1 - p / t), -np.log(t)


def shadowing(alpha: float, p: float) -> tuple[np.ndarray, np.ndarray]:
    """1 / sigma at cosines (k / N_AREA)^2 and ln K, each with derivatives by ln alpha and p: (3, N_AREA + 1), (3,).

    sigma = int max(0, k·h) D dw_h. In t, D cos dw = K alpha exp(-t) t^-p dt dphi / 2 pi, which is integrated in ln t
    from ln alpha up to where exp(-t) has vanished (Gauss-Legendre); the integral over phi is closed.
    """
    top = np.log1p(60.0 / alpha)
    v = 0.5 * top * (QUADRATURE[0] + 1)
    t = alpha * np.exp(v)
    tangent = alpha * np.sqrt(np.expm1(v))
    log_mass = np.log(0.5 * top * QUADRATURE[1]) - t - (p - 1) * np.log(t)
    peak = log_mass.max()
    mass = np.exp(log_mass - peak)
    total = mass.sum()
    mass /= total
    log_k = -np.log(alpha) - peak - np.log(total)
    _, by_alpha, by_p = distribution(tangent**2, alpha, p, log_k)
    k_alpha, k_p = -(mass @ by_alpha), -(mass @ by_p)
    inverse = np.empty((3, N_AREA + 1))
    _inverse_area(mass, by_alpha + k_alpha, by_p + k_p, tangent, inverse)
    return inverse, np.array([log_k, k_alpha, k_p])


@njit(cache=True, nogil=True)
def _inverse_area(mass, by_alpha, by_p, tangent, inverse):
    last = inverse.shape[1] - 1
    for k in range(last + 1):
        cosine = (k / last) ** 2
        sine = np.sqrt(max(1 - cosine * cosine, 0.0))
        sigma, slope_a, slope_p = 0.0, 0.0, 0.0
        for j in range(mass.size):
            swing = sine * tangent[j]
            if swing <= cosine:
                area = cosine
            else:
                root = np.sqrt(swing * swing - cosine * cosine)
                area = (cosine * (np.pi - np.arccos(cosine / swing)) + root) / np.pi
            part = mass[j] * area
            sigma += part
            slope_a += part * by_alpha[j]
            slope_p += part * by_p[j]
        inverse[0, k] = 1 / sigma
        inverse[1, k] = -slope_a / (sigma * sigma)
        inverse[2, k] = -slope_p / (sigma * sigma)


@cache
def area_positions() -> tuple[np.ndarray, np.ndarray]:
    """Where cos theta_i and cos theta_o of the grid's cells lie among the nodes of 1 / sigma, for phi_d in the first
    half: N_AREA sqrt(cos), each (90, 90, 90) float32, read-only. phi_d -> pi - phi_d swaps them."""
    positions = tuple(
        (N_AREA * np.sqrt(np.clip(cosine[:, :, :N_HALF], 0, 1))).astype(np.float32) for cosine in grid_cosines()
    )
    for values in positions:
        values.flags.writeable = False
    return positions  # type: ignore[return-value]


@njit(cache=True, nogil=True)
def _fill(shape, diffuse, inverse, position_i, position_o, table, c):
    n_h, n_d, n_p = position_i.shape
    last = inverse.size - 2
    for h in range(n_h):
        for d in range(n_d):
            for k in range(n_p):
                x, y = position_i[h, d, k], position_o[h, d, k]
                i, j = min(int(x), last), min(int(y), last)
                q = inverse[i] + (x - i) * (inverse[i + 1] - inverse[i])
                q *= inverse[j] + (y - j) * (inverse[j + 1] - inverse[j])
                table[h, d, k, c] = table[h, d, 2 * n_p - 1 - k, c] = diffuse + shape[h, d] * q


@njit(cache=True, nogil=True)
def _merge(weights, rho, merged, target):
    """w_1 + w_2 and w_1 rho_1 + w_2 rho_2 of phi_d and pi - phi_d; returns the sums of w, w rho and w rho^2."""
    n_h, n_d, n_p = merged.shape
    total, linear, power = 0.0, 0.0, 0.0
    for h in range(n_h):
        for d in range(n_d):
            for k in range(n_p):
                w, wr = 0.0, 0.0
                for q in (k, 2 * n_p - 1 - k):
                    if weights[h, d, q] > 0:
                        w += weights[h, d, q]
                        wr += weights[h, d, q] * rho[h, d, q]
                        power += weights[h, d, q] * rho[h, d, q] * rho[h, d, q]
                merged[h, d, k], target[h, d, k] = w, wr
                total += w
                linear += wr
    return total, linear, power


@njit(cache=True, nogil=True)
def _add_products(e, s, inner):
    """Adds e_a S e_b to ``inner``, b <= a."""
    for a in range(3):
        for b in range(a + 1):
            total = 0.0
            for k in range(3):
                for m in range(3):
                    total += e[a, k] * s[k, m] * e[b, m]
            inner[a, b] += total


@njit(cache=True, nogil=True)
def _pass(merged, target, position_i, position_o, inverse, e, count, inner, mixed, cross):
    """Adds up, per theta_d, the inner products of the columns e[u] · (g, dg/d ln alpha, dg/dp) with each other (inner),
    with 1 (mixed) and with the material (cross); g = 1 / (sigma_i sigma_o), u runs over the lobe and its derivatives.
    """
    n_h, n_d, n_p = merged.shape
    last = inverse.shape[1] - 2
    s = np.empty((3, 3))
    for h in range(n_h):
        for d in range(n_d):
            m0 = m1 = m2 = c0 = c1 = c2 = 0.0
            s00 = s01 = s02 = s11 = s12 = s22 = 0.0
            some = False
            for k in range(n_p):
                w = merged[h, d, k]
                if not w > 0:
                    continue
                some = True
                x, y = position_i[h, d, k], position_o[h, d, k]
                i, j = min(int(x), last), min(int(y), last)
                u, v = x - i, y - j
                qi = inverse[0, i] + u * (inverse[0, i + 1] - inverse[0, i])
                qo = inverse[0, j] + v * (inverse[0, j + 1] - inverse[0, j])
                g, r = qi * qo, target[h, d, k]
                m0 += w * g
                c0 += r * g
                s00 += w * g * g
                if count == 1:
                    continue
                ai = inverse[1, i] + u * (inverse[1, i + 1] - inverse[1, i])
                ao = inverse[1, j] + v * (inverse[1, j + 1] - inverse[1, j])
                pi = inverse[2, i] + u * (inverse[2, i + 1] - inverse[2, i])
                po = inverse[2, j] + v * (inverse[2, j + 1] - inverse[2, j])
                ga, gp = ai * qo + qi * ao, pi * qo + qi * po
                m1 += w * ga
                m2 += w * gp
                c1 += r * ga
                c2 += r * gp
                s01 += w * g * ga
                s02 += w * g * gp
                s11 += w * ga * ga
                s12 += w * ga * gp
                s22 += w * gp * gp
            if not some:
                continue
            if count == 1:
                a = e[0, h, 0]
                inner[0, 0, d] += a * a * s00
                mixed[0, d] += a * m0
                cross[0, d] += a * c0
                continue
            for a in range(3):
                mixed[a, d] += e[a, h, 0] * m0 + e[a, h, 1] * m1 + e[a, h, 2] * m2
                cross[a, d] += e[a, h, 0] * c0 + e[a, h, 1] * c1 + e[a, h, 2] * c2
            s[0, 0], s[0, 1], s[0, 2] = s00, s01, s02
            s[1, 0], s[1, 1], s[1, 2] = s01, s11, s12
            s[2, 0], s[2, 1], s[2, 2] = s02, s12, s22
            _add_products(e[:, h], s, inner[:, :, d])


class _Channel:
    """One channel as a SeparableProblem in (ln alpha, p): columns 1/pi and D F_l g / pi, l = 0, 1, 2."""

    derivatives: ClassVar = [(1, 0), (2, 0), (3, 0), (1, 1), (2, 1), (3, 1)]

    def __init__(self, merged, target, positions, sums: tuple[float, float, float]) -> None:
        self.merged, self.target, self.positions = merged, target, positions
        self.total, self.linear, self.power = sums
        self.tan2 = np.tan(theta_h_centres()) ** 2
        basis = fresnel_basis(np.cos(theta_d_centres()))
        self.basis, self.pairs = basis, basis[:, None] * basis[None]

    def grouped(self) -> "_Channel":
        """The same with GROUP neighbouring phi_d summed into one sample, for trying starts."""
        shape = (*self.merged.shape[:2], N_HALF // GROUP, GROUP)
        merged, target = (a.reshape(shape).sum(-1) for a in (self.merged, self.target))
        positions = tuple(np.ascontiguousarray(a.reshape(shape).mean(-1)) for a in self.positions)
        return _Channel(merged, target, positions, (self.total, self.linear, self.power))

    def moments(self, x: np.ndarray, *, derivatives: bool) -> Moments:
        alpha, p = float(np.exp(x[0])), float(x[1])
        inverse, (log_k, k_alpha, k_p) = shadowing(alpha, p)
        d, by_alpha, by_p = distribution(self.tan2, alpha, p, log_k)
        count = 3 if derivatives else 1
        e = np.zeros((count, d.size, 3))
        e[0, :, 0] = d
        if derivatives:  # (D g)' = D' g + D g'
            e[1, :, 0], e[2, :, 0] = d * (by_alpha + k_alpha), d * (by_p + k_p)
            e[1, :, 1] = e[2, :, 2] = d
        n_d = self.merged.shape[1]
        inner, mixed, cross = np.zeros((count, count, n_d)), np.zeros((count, n_d)), np.zeros((count, n_d))
        _pass(self.merged, self.target, *self.positions, inverse, e, count, inner, mixed, cross)
        for a in range(count):
            for b in range(a):
                inner[b, a] = inner[a, b]
        size = 1 + 3 * count
        gram, right = np.empty((size, size)), np.empty(size)
        gram[0, 0] = self.total
        gram[0, 1:] = gram[1:, 0] = (mixed @ self.basis.T).ravel()
        gram[1:, 1:] = np.einsum("abd,lmd->albm", inner, self.pairs).reshape(size - 1, size - 1)
        right[0], right[1:] = self.linear, (cross @ self.basis.T).ravel()
        return Moments(gram[None] / np.pi**2, right[None] / np.pi, np.array([self.power]))


LOWER, UPPER = np.array([np.log(1e-7), 0.0]), np.array([np.log(20.0), 4.0])


def merged_channel(weights: np.ndarray, rho: np.ndarray) -> _Channel:
    shape = (*GRID_SHAPE[:2], N_HALF)
    merged, target = np.empty(shape), np.empty(shape)
    sums = _merge(np.ascontiguousarray(weights), np.ascontiguousarray(rho), merged, target)
    return _Channel(merged, target, area_positions(), sums)


def fit_channel(weights: np.ndarray, rho: np.ndarray, n_starts: int, seed: int) -> Solution:
    """Starts are tried and followed on grouped samples; the best are followed to the end on all."""
    full = merged_channel(weights, rho)
    starts = latin_starts(n_starts, np.array([np.log(1e-5), 0.0]), np.array([0.0, 2.0]), seed)
    rough = fit_separable(
        full.grouped(), starts, LOWER, UPPER, linear=4, follow=4, separation=0.1, max_iterations=40, tolerance=1e-5
    )
    found = fit_separable(full, rough.x, LOWER, UPPER, linear=4, follow=1, max_iterations=60, tolerance=1e-7)
    return replace(found, starts=rough.starts)


def fit_channel_e2(rho: np.ndarray, n_starts: int, seed: int) -> Solution:
    """Löw's E2 of one channel by Gauss-Newton in the model's values: ln(1 + f cos) is linearised about the present f,
    which leaves a weighted sum of squares with a moved target; first about the material, from many starts. A step that
    does not lower E2 is not taken. Where none does, the gradients of both agree and the fit has converged."""
    theta_h, theta_d = theta_h_centres(), theta_d_centres()
    share = e2_weights(~np.isnan(rho))
    keep = share > 0
    cosine = np.where(keep, np.maximum(grid_cosines()[0], 0), 0).astype(float)
    measured = np.where(keep, rho, 0).astype(float)
    wanted = np.log1p(measured * cosine)
    solution = fit_channel(share * (cosine / (1 + measured * cosine)) ** 2, measured, n_starts, seed)
    best, tried, history, settled = solution, solution.starts, [], False
    table = np.empty((*GRID_SHAPE, 1))
    for _ in range(30):
        rho_d, rho_s, f0, f1 = natural(solution.linear[0])
        alpha, p = float(np.exp(solution.x[0])), float(solution.x[1])
        inverse, log_k = shadowing(alpha, p)
        lobe = rho_s * distribution(np.tan(theta_h) ** 2, alpha, p, log_k[0])[0]
        _fill(
            lobe[:, None] * fresnel(np.cos(theta_d), f0, f1) / np.pi,
            rho_d / np.pi,
            inverse[0],
            *area_positions(),
            table,
            0,
        )
        f = np.where(keep, table[..., 0], 0)
        residual = np.log1p(f * cosine) - wanted
        value = float(np.vdot(share, residual**2))
        settled = bool(history) and value >= history[-1] * (1 - 1e-6)
        if not history or value < history[-1]:
            history.append(value)
            best = solution
        if settled:
            break
        slope = np.where(keep, cosine / (1 + f * cosine), 0)
        target = f - np.where(keep, residual / np.where(keep, slope, 1), 0)
        solution = fit_separable(
            merged_channel(share * slope**2, target),
            solution.x,
            LOWER,
            UPPER,
            linear=4,
            follow=1,
            max_iterations=20,
            tolerance=1e-7,
        )
    return replace(
        best,
        objective=history[-1],
        converged=settled,
        iterations=len(history),
        message="" if settled else "not converged in 30 linearisations",
        history=history,
        starts=tried,
    )
