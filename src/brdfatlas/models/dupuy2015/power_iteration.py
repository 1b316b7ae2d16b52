"""Microfacet distribution and Fresnel term of a measured BRDF by power iterations.

Dupuy, Heitz, Iehl, Poulin, Ostromoukhov, "Extracting Microfacet-based BRDF Parameters from Arbitrary Materials with
Power Iterations", EGSR 2015; equation numbers are those of its supplemental. Algorithm 1 there is misprinted (sec^4
of the wrong angle, no azimuth integral) and diverges; this follows the equations.
"""

import numpy as np

from brdfatlas.angles import N_PHI_D, N_THETA_D, N_THETA_H, phi_d_centres, theta_d_centres, theta_h_centres
from brdfatlas.compiled import njit
from brdfatlas.constants import LUMINANCE
from brdfatlas.microfacet import (
    interpolate_ndf,
    ndf_normalisation,
    phi_integral,
    smith_g,
    smith_g1,
    smith_sigma,
    theta_h_quadrature,
)

ITERATIONS = 4
#: The ideal mirror's response below which a cell says nothing about Fresnel.
MIN_IDEAL = 1e-4


class NoDistribution(ValueError):
    """The retro-reflective slice holds nothing to find a distribution from."""


def retro_slice(table: np.ndarray) -> tuple[np.ndarray, int]:
    """Luminance f_r(o, o) at the 90 theta_h, and how many of them had to be filled.

    Light and sensor coincide at theta_d = 0, so each value is the mean over phi_d of the valid cells of theta_d
    row 0. Rows without any are filled from their neighbours, linear in the row's number.
    Raises NoDistribution if no row is valid or all are dark.
    """
    with np.errstate(invalid="ignore"):
        cells = table[:, 0].astype(float) @ LUMINANCE
    valid = ~np.isnan(cells)
    count = valid.sum(1)
    known = count > 0
    if not known.any():
        raise NoDistribution("no valid sample of retro-reflection (theta_d index 0)")
    values = np.where(valid, cells, 0).sum(1) / np.maximum(count, 1)
    rows = np.arange(N_THETA_H)
    values = np.interp(rows, rows[known], values[known])
    if not values.any():
        raise NoDistribution("retro-reflection is zero at every angle")
    return values, int((~known).sum())


def kernel(retro: np.ndarray) -> np.ndarray:
    """The matrix whose dominant eigenvector is D and whose eigenvalue is F0 (Eq. 9), (90, 90), nodes at cell centres.

    4 f_r(o, o) cos theta_o int (o·h)+ dphi sin theta_h 2 theta' w. It is the matrix of Eq. 23 with P = D cos^4
    written out, so both have the same eigenvalues. w = sqrt(pi/2) / N; Eq. 22 prints 1 / N, with which the eigenvalue
    is not F0.
    """
    theta, weight = theta_h_quadrature()
    cosine, sine = np.cos(theta), np.sin(theta)
    inner = phi_integral(cosine[:, None], sine[:, None], cosine, sine) / (2 * np.pi)
    return (4 * retro * cosine)[:, None] * inner * weight


def distribution(retro: np.ndarray, *, backscatter: str = "published", iterations: int = ITERATIONS):
    """The NDF (90,) with int D cos = 1, the eigenvalue F0 (luminance), and the curve of relative changes of D.

    Iterations start from D = 1. (From P = 1, as Eq. 26 has it, D = P / cos^4 starts with a peak of 1e7 at grazing
    angles which 4 iterations do not forget on rough surfaces: GGX 0.6 comes back 0.9 % too rough, with F off by 0.014.)

    ``backscatter``: "published" assumes G(o, o) = G1(o); "forward" (ours) uses what Eq. 3 gives, G1 / (2 - G1), by
    scaling the matrix's rows with 2 - G1 of the present estimate in every iteration, up to a fixed point.
    """
    matrix = kernel(retro)
    cosine = np.cos(theta_h_centres())
    ndf = np.ones(N_THETA_H)
    ndf /= ndf_normalisation(ndf)
    changes: list[float] = []
    eigenvalue = 0.0
    for _ in range(iterations if backscatter == "published" else 100):
        product = matrix @ ndf
        if backscatter == "forward":
            product *= 2 - smith_g1(smith_sigma(ndf), cosine)
        eigenvalue = ndf_normalisation(product)
        before, ndf = ndf, product / eigenvalue
        changes.append(float(np.abs(ndf - before).max() / ndf.max()))
        if backscatter == "forward" and changes[-1] < 1e-9:
            break
    return ndf, eigenvalue, changes


def slope_moments(ndf: np.ndarray) -> tuple[float, float]:
    """E[x^2] and E|x| of the slope density P = D cos^4: pi int r^3 P dr and 4 int r^2 P dr, r = tan theta_h.

    E[x^2] of a distribution with long tails (GGX) does not exist; on the grid it is finite and depends on where the
    last row lies (89 degrees).
    """
    theta, weight = theta_h_quadrature()
    slope = np.tan(theta)
    probability = ndf * np.cos(theta) * weight  # of a slope in this row's ring; sums to 1
    return float((0.5 * slope**2 * probability).sum()), float((2 / np.pi * slope * probability).sum())


def beckmann_alpha(ndf: np.ndarray) -> float:
    """alpha = sqrt(2 E[x^2]) of the Beckmann distribution with the same second moment."""
    return float(np.sqrt(2 * slope_moments(ndf)[0]))


def ggx_alpha(ndf: np.ndarray) -> float:
    """alpha = E|x| of the GGX distribution with the same first absolute moment."""
    return slope_moments(ndf)[1]


@njit(cache=True, nogil=True)
def _fresnel_sums(table, ndf, sigma, theta_h, theta_d, cos_p, sums, counts):
    """Sums over (theta_h, phi_d) of measured over ideal, per theta_d; cells below MIN_IDEAL or invalid are left out.

    phi_d and pi - phi_d swap theta_i and theta_o and share one ideal value.
    """
    n_p, last = cos_p.size, sigma.size - 1
    scale = last / (0.5 * np.pi)
    for d in range(theta_d.size):
        sin_d, cos_d = np.sin(theta_d[d]), np.cos(theta_d[d])
        for h in range(theta_h.size):
            if theta_h[h] >= 0.5 * np.pi - theta_d[d]:
                break
            middle, swing = np.cos(theta_h[h]) * cos_d, np.sin(theta_h[h]) * sin_d
            for p in range(n_p // 2):
                a, b = middle - swing * cos_p[p], middle + swing * cos_p[p]
                if a <= 0 or b <= 0:
                    continue
                x, y = np.arccos(min(a, 1.0)) * scale, np.arccos(min(b, 1.0)) * scale
                i, j = min(int(x), last - 1), min(int(y), last - 1)
                ga = min(a / (sigma[i] + (x - i) * (sigma[i + 1] - sigma[i])), 1.0)
                gb = min(b / (sigma[j] + (y - j) * (sigma[j + 1] - sigma[j])), 1.0)
                below = ga + gb - ga * gb
                if below <= 0:
                    continue
                ideal = ndf[h] * ga * gb / (below * 4 * a * b)
                if not ideal > MIN_IDEAL:
                    continue
                for q in (p, n_p - 1 - p):
                    if table[h, d, q, 0] >= 0:
                        counts[d] += 1
                        for c in range(3):
                            sums[d, c] += table[h, d, q, c] / ideal


def fresnel_corrected(table: np.ndarray, ndf: np.ndarray) -> np.ndarray:
    """F (90, 3): the mean of measured over ideal response at each theta_d over (phi_d, theta_h), theta_h <= 90
    degrees - theta_d (Eq. 35), clamped to [0, 1]. A diffuse part drives it to the clamp: the model has no diffuse term.

    A theta_d without a usable cell takes the value of its neighbours. NoDistribution if there is none at all.
    """
    sums, counts = np.zeros((N_THETA_D, 3)), np.zeros(N_THETA_D, np.int64)
    cos_p = np.cos(phi_d_centres())
    _fresnel_sums(table, ndf, smith_sigma(ndf), theta_h_centres(), theta_d_centres(), cos_p, sums, counts)
    known = counts > 0
    if not known.any():
        raise NoDistribution("no valid sample lies where an ideal mirror with this distribution would reflect")
    mean = sums[known] / counts[known, None]
    rows = np.arange(N_THETA_D)
    return np.clip(np.stack([np.interp(rows, rows[known], mean[:, c]) for c in range(3)], -1), 0, 1)


def fresnel_egsr2015(table: np.ndarray, ndf: np.ndarray) -> np.ndarray:
    """F (90, 3) as the authors' program of 2015 found it, with the light held at the normal: kept to compare with
    their printed figures, wrong for any other use.

    For each theta_d it walks theta_h at phi_d = 90 degrees, takes o of that pair but i = n, and averages measured over
    ideal there, so F(theta_d) is a mean of the true F over half of theta_o, at most 45 degrees. Values above 1 become
    1, and so do angles without a usable cell.
    """
    theta_h, theta_d = theta_h_centres(), theta_d_centres()
    sigma = smith_sigma(ndf)
    fresnel = np.ones((N_THETA_D, 3))
    for row, angle in enumerate(theta_d):
        cos_o = np.cos(theta_h[theta_h < np.pi / 2 - angle]) * np.cos(angle)
        half = np.arccos(np.clip(cos_o, 0, 1)) / 2  # with i = n, theta_h = theta_d = theta_o / 2
        ideal = interpolate_ndf(ndf, half) * smith_g(1.0, smith_g1(sigma, cos_o)) / (4 * cos_o)
        h = np.minimum((np.sqrt(half / (np.pi / 2)) * N_THETA_H).astype(int), N_THETA_H - 1)
        d = np.minimum((half / (np.pi / 2) * N_THETA_D).astype(int), N_THETA_D - 1)
        measured = table[h, d, N_PHI_D - 1].astype(float)
        use = (ideal > MIN_IDEAL) & ~np.isnan(measured[:, 0])
        if use.any():
            fresnel[row] = np.minimum(1.0, (measured[use] / ideal[use, None]).mean(0))
    return fresnel
