"""Parts that microfacet models share: normal distributions, masking and shadowing, Fresnel.

Formulas are elementwise numpy expressions that take scalars and arrays alike. Angles in radians, cosines against the
normal or the half vector as named. A model of the form F D G / (4 cos cos) is assembled by :func:`torrance_sparrow`.
"""

import math

import numpy as np

from brdfatlas.angles import N_THETA_D, N_THETA_H, half_difference, phi_d_centres, theta_d_centres, theta_h_centres

# Normal distributions -------------------------------------------------------------------------------------------


def beckmann_ndf(cos_h, alpha):
    """Beckmann D (1/sr), int D cos = 1; ``alpha`` is the root of twice the variance of a slope coordinate."""
    cos2 = cos_h * cos_h
    return np.exp(-(1 - cos2) / (cos2 * alpha * alpha)) / (np.pi * alpha * alpha * cos2 * cos2)


def ggx_ndf(cos_h, alpha):
    """GGX (Trowbridge-Reitz) D (1/sr), int D cos = 1. Walter et al. 2007, Eq. 33."""
    cos2 = cos_h * cos_h
    base = cos2 * (alpha * alpha) + (1 - cos2)
    return alpha * alpha / (np.pi * base * base)


# Shadowing ------------------------------------------------------------------------------------------------------


def ggx_g1(cosine, alpha):
    """Smith G1 of GGX (Walter et al. 2007, Eq. 34)."""
    cos2 = np.minimum(cosine * cosine, 1.0)
    return 2 * cosine / (cosine + np.sqrt(cos2 + alpha * alpha * (1 - cos2)))


def beckmann_g1(cosine, alpha):
    """Smith G1 of Beckmann, exact (Walter et al. 2007, Eq. 25): 2 / (1 + erf(a) + exp(-a^2) / (a sqrt(pi)))."""
    from scipy.special import erf  # late: its import takes longer than many a fit

    cosine = np.asarray(cosine, float)
    sine = np.sqrt(np.maximum(1 - cosine * cosine, 0))
    a = np.clip(cosine, 0, None) / np.maximum(alpha * sine, 1e-300)
    a = np.clip(a, 1e-30, 26.0)  # exp(-26^2) is the least double
    return 2 / (1 + erf(a) + np.exp(-a * a) / (a * math.sqrt(math.pi)))


def smith_g(g1_i, g1_o):
    """Height-correlated G of two G1 (Dupuy et al. 2015, Eq. 3); 0 where both are 0."""
    return g1_i * g1_o / np.maximum(g1_i + g1_o - g1_i * g1_o, 1e-300)


def v_groove(cos_h, cos_i, cos_o, cos_d):
    """Cook and Torrance's V-groove G = min(1, 2 nh no / oh, 2 nh ni / oh)."""
    return np.minimum(1.0, 2 * cos_h * np.minimum(cos_i, cos_o) / cos_d)


def phi_integral(cos_a, sin_a, cos_b, sin_b):
    """int_0^2pi max(0, a·b) dphi of two directions whose azimuths differ by phi, in closed form.

    With t = tan(a) tan(b): 2 pi cos cos for t <= 1, else 2 cos cos (pi - arccos(1/t) + sqrt(t^2 - 1)). Written
    without the tangents, so it holds at 90 degrees.
    """
    even, swing = cos_a * cos_b, sin_a * sin_b
    ratio = np.minimum(even / np.maximum(swing, 1e-300), 1.0)
    root = np.sqrt(np.maximum(swing * swing - even * even, 0.0))
    return 2 * (even * (np.pi - np.arccos(ratio)) + root)


def ndf_normalisation(ndf: np.ndarray) -> float:
    """int D cos(theta_h) dw of an NDF (90,) on the MERL theta_h grid (midpoint rule in theta' = sqrt(theta_h))."""
    theta, weight = theta_h_quadrature()
    return float((ndf * np.cos(theta) * weight).sum())


def theta_h_quadrature() -> tuple[np.ndarray, np.ndarray]:
    """theta_h of the 90 rows and the solid angle 2 pi sin(theta_h) 2 theta' d theta' that each stands for."""
    theta = theta_h_centres()
    step = np.sqrt(np.pi / 2) / N_THETA_H
    return theta, 2 * np.pi * np.sin(theta) * 2 * np.sqrt(theta) * step


#: Nodes of a tabulated projected area, uniform in theta from 0 to 90 degrees, four a degree.
SIGMA_NODES = 361


def smith_sigma(ndf: np.ndarray) -> np.ndarray:
    """The projected area sigma = int max(0, k·h) D dw_h of an NDF (90,) at :data:`SIGMA_NODES` angles of k.

    Dupuy et al. 2015, Eq. 4: G1 = cos / sigma. sigma(0) is int D cos, 1 for a normalised NDF. It is smooth up to 90
    degrees where G1 is not, so sigma is what is tabulated.
    """
    theta, weight = theta_h_quadrature()
    angle = np.linspace(0, np.pi / 2, SIGMA_NODES)
    cosine = np.cos(angle)
    cosine[-1] = 0.0
    inner = phi_integral(cosine[:, None], np.sin(angle)[:, None], np.cos(theta), np.sin(theta))
    return inner @ (ndf * weight / (2 * np.pi))


def smith_g1(sigma: np.ndarray, cosine) -> np.ndarray:
    """G1 = min(1, cos / sigma), from a tabulated sigma (:data:`SIGMA_NODES`,), linear in theta."""
    theta = np.arccos(np.clip(cosine, 0, 1))
    area = np.interp(theta, np.linspace(0, np.pi / 2, sigma.size), sigma)
    return np.clip(cosine / np.maximum(area, 1e-300), 0, 1)


# Fresnel --------------------------------------------------------------------------------------------------------


def schlick_weight(cos_d, exponent: int = 5):
    """(1 - cos)^5, with which Schlick's approximation rises from F0 to 1 (Schlick 1994)."""
    return (1 - cos_d) ** exponent


def schlick(cos_d, f0):
    """Schlick's F0 + (1 - F0) (1 - cos)^5."""
    return f0 + (1 - f0) * schlick_weight(cos_d)


def dielectric(cos_d, eta):
    """Exact unpolarised Fresnel reflectance of a dielectric of relative index ``eta`` > 0."""
    g2 = eta * eta - 1 + cos_d * cos_d
    g = np.sqrt(np.maximum(g2, 0.0))
    a = (g - cos_d) / (g + cos_d)
    b = (cos_d * (g + cos_d) - 1) / (cos_d * (g - cos_d) + 1)
    return np.where(g2 > 0, 0.5 * a * a * (1 + b * b), 1.0)


# Tables on the MERL axes ----------------------------------------------------------------------------------------


def interpolate_ndf(ndf: np.ndarray, theta_h) -> np.ndarray:
    """A tabulated D (90,) at any theta_h: linear between rows in sqrt(theta_h), constant beyond the end rows."""
    position = np.sqrt(np.maximum(theta_h, 0) / (np.pi / 2)) * N_THETA_H - 0.5
    return np.interp(position, np.arange(N_THETA_H), ndf)


def interpolate_fresnel(fresnel: np.ndarray, theta_d) -> np.ndarray:
    """A tabulated F (90, 3) at any theta_d: linear between rows, constant beyond the end rows; (..., 3)."""
    position = np.asarray(theta_d) / (np.pi / 2) * N_THETA_D - 0.5
    return np.stack([np.interp(position, np.arange(N_THETA_D), fresnel[:, c]) for c in range(fresnel.shape[1])], -1)


def torrance_sparrow(wi, wo, ndf, fresnel: np.ndarray, g1) -> np.ndarray:
    """F D G / (4 cos cos) at directions (..., 3), rgb in 1/sr; Dupuy et al. 2015, Eqs. 1 and 3.

    ``ndf`` and ``g1``: functions of theta_h and of a cosine; ``fresnel``: (90, 3), of theta_d.
    """
    theta_h, theta_d, _ = half_difference(wi, wo)
    cos_i, cos_o = wi[..., 2], wo[..., 2]
    shape = ndf(theta_h) * smith_g(g1(cos_i), g1(cos_o)) / np.maximum(4 * cos_i * cos_o, 1e-300)
    return shape[..., None] * interpolate_fresnel(fresnel, theta_d)


def torrance_sparrow_grid(ndf: np.ndarray, fresnel: np.ndarray, g1) -> np.ndarray:
    """:func:`torrance_sparrow` at the cell centres of the MERL grid, float32; D is (90,), ``g1`` a function of a
    cosine. cos(theta_o) is cos(theta_i) mirrored in phi_d, so G1 is computed once. Below the horizon: 0."""
    theta_d, phi_d = theta_d_centres()[:, None], phi_d_centres()
    table = np.empty((N_THETA_H, N_THETA_D, phi_d.size, 3), np.float32)
    for row, theta_h in enumerate(theta_h_centres()):
        swing = np.sin(theta_h) * np.sin(theta_d) * np.cos(phi_d)
        cosine = np.maximum(np.cos(theta_h) * np.cos(theta_d) - swing, 0.0)
        one = g1(cosine)
        product = cosine * cosine[:, ::-1]
        shape = np.where(product > 0, ndf[row] * smith_g(one, one[:, ::-1]) / np.maximum(4 * product, 1e-300), 0.0)
        table[row] = shape[..., None] * fresnel[:, None, :]
    return table
