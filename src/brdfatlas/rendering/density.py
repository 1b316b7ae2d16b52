"""The sampling density that a material's reference and all its fits share, tabulated from the reference.

A mixture of a cosine lobe and a lobe over half vectors. For each of 32 elevations of the incident light the second
follows, linearly between the edges of the 90 theta_h cells of the MERL grid, the luminance that is reflected through
half vectors of that theta_h. The cosine lobe never has a weight below 0.1, so the density covers the hemisphere.

Neighbouring cells are joined until each has a share worth a few of 2048 places. Probabilities are multiples of 1/2048:
inverting the distribution is one look-up in a list in which each cell stands as often as its probability says, and
sampling, density and list agree exactly.
"""

from dataclasses import dataclass

import numpy as np

from brdfatlas.angles import N_THETA_H
from brdfatlas.constants import LUMINANCE
from brdfatlas.measured import look_up

N_ELEVATIONS = 32
LIST_LENGTH = 2048
MIN_COSINE_WEIGHT, MAX_COSINE_WEIGHT = 0.1, 0.95


@dataclass(frozen=True)
class Density:
    """Tables of the density, row = elevation of wi, uniform in theta.

    ``cosine_weight``: (32,) float32. ``entries``: (32, 2048) uint32, cells in order, repeated by probability; joined
    cells stand there by their first. ``cells``: (32, 90, 4) float32: lower bound and width of the (joined) cell in
    v = 1 - cos(theta_h), mean density p of the half vector in 1/sr, and slope s: at v = low + t width the density is
    p (1 + s (2 t - 1)). ``runs``: (32, 90, 2) float32: first place of a cell in ``entries`` and number of places, both
    divided by 2048.
    """

    cosine_weight: np.ndarray
    entries: np.ndarray
    cells: np.ndarray
    runs: np.ndarray


def sampling_density(table: np.ndarray) -> Density:
    """Tabulate the density for an extended table (90, 90, 180 or 360, 3), 1/sr, without NaN."""
    luminance = (table @ LUMINANCE.astype(np.float32))[..., None]
    edges = (np.arange(N_THETA_H + 1) / N_THETA_H) ** 2 * (np.pi / 2)
    versine = 2 * np.sin(edges / 2) ** 2
    width = np.diff(versine)
    energy, lambertian = _reflected(luminance, edges)

    def mass(values: np.ndarray) -> np.ndarray:
        return (values[1:] + values[:-1]) * np.pi * width

    weights = np.empty(N_ELEVATIONS, np.float32)
    entries = np.empty((N_ELEVATIONS, LIST_LENGTH), np.uint32)
    cells = np.empty((N_ELEVATIONS, N_THETA_H, 4), np.float32)
    runs = np.empty((N_ELEVATIONS, N_THETA_H, 2), np.float32)
    for row in range(N_ELEVATIONS):
        seen = lambertian[row] > 1e-3 * lambertian[row].max()
        floor = np.quantile(energy[row, seen] / lambertian[row, seen], 0.1)
        lobe = np.maximum(energy[row] - floor * lambertian[row], 0)
        share = mass(lobe).sum() / max(mass(energy[row]).sum(), 1e-30)
        weights[row] = np.clip(1 - share, MIN_COSINE_WEIGHT, MAX_COSINE_WEIGHT)
        lobe = lobe if lobe.any() else lambertian[row]
        joined = _join(mass(lobe))
        low, high = versine[joined], versine[np.append(joined[1:], N_THETA_H)]
        counts = _counts(np.add.reduceat(mass(lobe), joined))
        entries[row] = np.repeat(joined.astype(np.uint32), counts)
        first, last = lobe[joined], lobe[np.append(joined[1:], N_THETA_H)]
        # A slope of 1 would leave one edge without samples.
        slope = np.clip((last - first) / np.maximum(first + last, 1e-30), -0.98, 0.98)
        density = counts / LIST_LENGTH / (2 * np.pi * (high - low))
        size = np.diff(np.append(joined, N_THETA_H))
        cells[row] = np.repeat(np.stack([low, high - low, density, slope], -1), size, axis=0)
        runs[row] = np.repeat(np.stack([np.cumsum(counts) - counts, counts], -1) / LIST_LENGTH, size, axis=0)
    return Density(weights, entries, cells, runs)


def _reflected(luminance: np.ndarray, theta_h: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Reflected luminance per solid angle of half vectors, for each elevation of wi and each theta_h, averaged over
    phi_h; and the same for a BRDF of 1."""
    theta_i = (np.arange(N_ELEVATIONS) + 0.5) / N_ELEVATIONS * (np.pi / 2)
    phi_h = (np.arange(24) + 0.5) / 24 * np.pi  # the other half is its mirror image
    wi = np.stack([np.sin(theta_i), 0 * theta_i, np.cos(theta_i)], -1)[:, None, None]
    theta, phi = theta_h[None, :, None], phi_h[None, None, :]
    h = np.stack(np.broadcast_arrays(np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)), -1)
    cos_d = (wi * h).sum(-1)
    wo = 2 * cos_d[..., None] * h - wi
    jacobian = np.where((cos_d > 0) & (wo[..., 2] > 0), 4 * cos_d * wo[..., 2], 0.0)
    wi, wo = np.broadcast_arrays(wi, wo)
    # wi is the viewer, as in Mitsuba
    return (look_up(luminance, wo, wi)[..., 0] * jacobian).mean(-1), jacobian.mean(-1)


def _join(energy: np.ndarray, places: int = 6) -> np.ndarray:
    """First cells of runs of neighbours that each hold at least ``places`` places' worth of ``energy``."""
    share = energy / energy.sum() * LIST_LENGTH
    starts, held = [0], 0.0
    for cell in range(energy.size):
        if held >= places and share[cell:].sum() >= places:
            starts.append(cell)
            held = 0.0
        held += share[cell]
    return np.array(starts)


def _counts(energy: np.ndarray) -> np.ndarray:
    """Whole numbers that sum to LIST_LENGTH, proportional to ``energy`` by largest remainders."""
    share = energy / energy.sum() * LIST_LENGTH
    counts = np.floor(share).astype(int)
    counts[np.argsort(counts - share, kind="stable")[: LIST_LENGTH - counts.sum()]] += 1
    return counts
