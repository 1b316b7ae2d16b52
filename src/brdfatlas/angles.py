"""Half and difference angles, the MERL grid and its measures.

All directions are unit vectors that point away from the surface, n = z. Angles are radians. A grid sample sits at
the centre of its cell (the left edges would give theta_h = 0 and theta_d = 0 no weight).

The grid has phi_d in [0, pi): exchanging the two directions adds pi, which a reciprocal BRDF does not notice. One that
is not reciprocal is put on the full circle, [0, 2 pi), 360 cells.

Rusinkiewicz, "A New Change of Variables for Efficient BRDF Representation", 1998; Matusik et al. 2003 (MERL).
"""

from functools import cache

import numpy as np

N_THETA_H, N_THETA_D, N_PHI_D = 90, 90, 180
GRID_SHAPE = (N_THETA_H, N_THETA_D, N_PHI_D)


def theta_h_centres() -> np.ndarray:
    """Centres of the 90 theta_h cells, spaced quadratically: denser at the highlight; shape (90,), radians."""
    return ((np.arange(N_THETA_H) + 0.5) / N_THETA_H) ** 2 * (np.pi / 2)


def theta_d_centres() -> np.ndarray:
    """Centres of the 90 theta_d cells of one degree; shape (90,), radians."""
    return (np.arange(N_THETA_D) + 0.5) / N_THETA_D * (np.pi / 2)


def phi_d_centres(full_circle: bool = False) -> np.ndarray:
    """Centres of the phi_d cells of one degree, radians: (180,) in [0, pi), or (360,) in [0, 2 pi)."""
    return (np.arange(N_PHI_D * (1 + full_circle)) + 0.5) / N_PHI_D * np.pi


def grid_axes(full_circle: bool = False) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """theta_h (90, 1, 1), theta_d (1, 90, 1), phi_d (1, 1, 180 or 360): the grid's axes, ready to broadcast."""
    return theta_h_centres()[:, None, None], theta_d_centres()[None, :, None], phi_d_centres(full_circle)[None, None]


def directions(theta_h, theta_d, phi_d) -> tuple[np.ndarray, np.ndarray]:
    """The pair (wi, wo), each (..., 3), that has these angles and phi_h = 0.

    cos(theta_i) = cos th cos td - sin th sin td cos pd, the sign of the MERL access code.
    """
    theta_h, theta_d, phi_d = np.broadcast_arrays(theta_h, theta_d, phi_d)
    sin_h, cos_h = np.sin(theta_h), np.cos(theta_h)
    sin_d, cos_d = np.sin(theta_d), np.cos(theta_d)
    along, across = sin_d * np.cos(phi_d), sin_d * np.sin(phi_d)
    wi = np.stack([cos_h * along + sin_h * cos_d, across, cos_h * cos_d - sin_h * along], -1)
    wo = np.stack([sin_h * cos_d - cos_h * along, -across, cos_h * cos_d + sin_h * along], -1)
    return wi, wo


def unit_vectors(wi, wo) -> tuple[np.ndarray, np.ndarray]:
    """Directions as a caller has them, (..., 3) each, as float64 of one shape (..., 3); a masked or infinite one is
    NaN.

    ValueError for what are none, for two shapes that do not broadcast, and for vectors of another length than 1, which
    every model would take for a direction that nobody meant; those with NaN pass.
    """
    try:
        arrays = [np.ma.asarray(w).astype(float, casting="same_kind", copy=False) for w in (wi, wo)]
    except (TypeError, ValueError):
        raise ValueError("directions that are no array of real numbers; shape (..., 3) is needed") from None
    one, other = (w.shape for w in arrays)
    for shape in (one, other):
        if shape[-1:] != (3,):
            raise ValueError(f"directions of shape {shape}; (..., 3) is needed")
    try:
        wi, wo = np.broadcast_arrays(*(_nan_for_inf(np.ma.filled(w, np.nan)) for w in arrays))
    except ValueError:
        raise ValueError(f"directions of shapes {one} and {other}, which do not broadcast to one") from None
    for w in (wi, wo):
        with np.errstate(over="ignore"):
            length = np.linalg.norm(w, axis=-1)
        off = np.abs(length - 1) > 1e-3
        if off.any():
            raise ValueError(f"a direction of length {np.extract(off, length)[0]:.4g}; unit vectors are needed")
    return wi, wo


def _nan_for_inf(w: np.ndarray) -> np.ndarray:
    return np.where(np.isinf(w), np.nan, w) if np.isinf(w).any() else w


def half_difference(wi, wo, full_circle: bool = False) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """theta_h, theta_d in [0, pi/2] and phi_d in [0, pi) of unit vectors wi, wo of shape (..., 3).

    phi_d is folded by reciprocity, unless ``full_circle`` asks for [0, 2 pi): exchanging wi and wo adds pi. Written
    with chord lengths instead of arc cosines, which lose half their digits near 0, where highlights live. A direction
    with a NaN has NaN angles.
    """
    wi, wo = np.asarray(wi, float), np.asarray(wo, float)
    total, difference = wi + wo, wi - wo
    h = total / np.maximum(np.linalg.norm(total, axis=-1, keepdims=True), 1e-300)
    rho = np.hypot(h[..., 0], h[..., 1])
    theta_h = np.arctan2(rho, h[..., 2])
    theta_d = np.arctan2(np.linalg.norm(difference, axis=-1), np.linalg.norm(total, axis=-1))
    safe = rho > 1e-12
    cos_p = np.where(safe, h[..., 0] / np.where(safe, rho, 1), 1.0)
    sin_p = np.where(safe, h[..., 1] / np.where(safe, rho, 1), 0.0)
    along = h[..., 2] * (wi[..., 0] * cos_p + wi[..., 1] * sin_p) - rho * wi[..., 2]
    across = wi[..., 1] * cos_p - wi[..., 0] * sin_p
    # the modulus of a tiny negative number is the period itself
    period = np.pi * (1 + full_circle)
    phi_d = np.mod(np.arctan2(across, along), period)
    return theta_h, theta_d, np.where(phi_d >= period, 0.0, phi_d)


@cache
def grid_cosines() -> tuple[np.ndarray, np.ndarray]:
    """cos(theta_i), cos(theta_o) at every cell centre: two read-only arrays of GRID_SHAPE, float32."""
    theta_h, theta_d, phi_d = grid_axes()
    middle = np.cos(theta_h) * np.cos(theta_d)
    swing = np.sin(theta_h) * np.sin(theta_d) * np.cos(phi_d)
    cosines = (middle - swing).astype(np.float32), (middle + swing).astype(np.float32)
    for values in cosines:
        values.flags.writeable = False
    return cosines


@cache
def above_horizon() -> np.ndarray:
    """Where both directions of a cell centre are above the surface: read-only bool array of GRID_SHAPE."""
    cos_i, cos_o = grid_cosines()
    mask = (cos_i > 0) & (cos_o > 0)
    mask.flags.writeable = False
    return mask


def cell_widths() -> tuple[np.ndarray, float, float]:
    """d theta_h of each cell (90,), d theta_d, d phi_d. With theta_h = theta'^2, d theta_h = 2 theta' d theta'."""
    step = np.sqrt(np.pi / 2) / N_THETA_H
    return 2 * np.sqrt(theta_h_centres()) * step, np.pi / 2 / N_THETA_D, np.pi / N_PHI_D


def pair_measure() -> np.ndarray:
    """The measure of direction pairs in each cell, dwi dwo = 4 cos td sin td sin th dth dphi_h dtd dpd (phi_h
    integrated out); shape (90, 90, 1), sr^2."""
    theta_h, theta_d, _ = grid_axes()
    width_h, width_d, width_p = cell_widths()
    density = 4 * np.cos(theta_d) * np.sin(theta_d) * np.sin(theta_h)
    return 2 * np.pi * density * width_h[:, None, None] * width_d * width_p


def slice_measure() -> np.ndarray:
    """The area of the phi_h = 0 slice in each cell, w_V of Bagher et al. 2016 (Eq. 9); GRID_SHAPE.

    It lacks sin(theta_h) against :func:`pair_measure`, so it stresses theta_h near 0; it is the published metric.
    """
    theta_h, theta_d, phi_d = grid_axes()
    width_h, width_d, width_p = cell_widths()
    bend = np.cos(theta_d) ** 2 + (np.sin(theta_d) * np.cos(phi_d)) ** 2
    return np.sqrt(8 * np.sin(theta_d) ** 2 * bend) * width_h[:, None, None] * width_d * width_p + 0 * theta_h
