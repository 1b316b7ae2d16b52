"""What is suspicious in a table that can be read: its scale, its size, a highlight on the wrong side."""

from functools import cache

import numpy as np

from brdfatlas.angles import above_horizon, grid_cosines, pair_measure, theta_d_centres, theta_h_centres
from brdfatlas.compiled import njit

#: Share of the cells above the horizon below which pictures show more of what was not measured than a reader expects.
FEW_CELLS = 0.75
#: How much brighter than in the mirror direction a material may be towards its light; no measured one reaches 1.
BACKWARD = 2.0
#: 1/sr beyond which neither the albedo nor the median is.
UNSCALED = 100.0


@cache
def _weight() -> np.ndarray:
    """cos(theta_i) cos(theta_o) times the measure of direction pairs; 0 below the horizon. GRID_SHAPE, read-only."""
    cos_i, cos_o = grid_cosines()
    weight = (np.maximum(cos_i, 0) * np.maximum(cos_o, 0) * pair_measure()).astype(np.float32)
    weight.flags.writeable = False
    return weight


@njit(cache=True, nogil=True)
def _weighted(table, weight):
    """Weight of the cells (n, 3) with values and the weighted sum of rgb; every job of a run reads its material."""
    total, rgb = 0.0, np.zeros(3)
    for i in range(weight.size):
        if not np.isnan(table[i, 0]):
            total += weight[i]
            for c in range(3):
                rgb[c] += weight[i] * table[i, c]
    return total, rgb


def mean_albedo(table: np.ndarray) -> np.ndarray:
    """Bihemispherical albedo rgb of a (90, 90, 180, 3) table: pi times the mean of f over pairs of directions, each
    weighted by both cosines, over the valid cells. A Lambertian table gives its albedo exactly."""
    total, rgb = _weighted(table.reshape(-1, 3), _weight().ravel())
    return np.pi * rgb / max(total, 1e-300)


def suspicions(table: np.ndarray) -> tuple[str, ...]:
    """Warnings on a table in 1/sr, one line each; none if it looks like reflectance."""
    valid = ~np.isnan(table[..., 0])
    share = np.count_nonzero(valid) / np.count_nonzero(above_horizon())
    told = f"{100 * share:.3g}% of the cells above the horizon were measured; elsewhere the nearest of them stands in"
    return (*((told,) if share < FEW_CELLS else ()), *_backward(table, valid), *_scale(table, valid))


def _backward(table: np.ndarray, valid: np.ndarray) -> tuple[str, ...]:
    """A suspicion, where light from 30 to 60 degrees goes back to where it came from and not on."""
    theta_h, theta_d = np.rad2deg(theta_h_centres()), np.rad2deg(theta_d_centres())
    oblique = [(theta > 30) & (theta < 60) for theta in (theta_h, theta_d)]
    places = np.ix_(theta_h < 1, oblique[1]), np.ix_(oblique[0], theta_d < 8)
    values = [table[place][valid[place]] for place in places]
    if not all(part.size for part in values):
        return ()
    mirror, back = (float(np.median(part.mean(-1))) for part in values)
    if back <= BACKWARD * mirror:
        return ()
    told = f"{back:.3g} 1/sr back to the light, {mirror:.3g} in the mirror direction"
    why = "is it no retro-reflector? The mirror direction has phi_o = phi_i + 180 degrees"
    return (f"brightest towards the light ({told}): {why}",)


def _scale(table: np.ndarray, valid: np.ndarray) -> tuple[str, ...]:
    """A suspicion on the scale; half of the values above UNSCALED are those of no reflectance."""
    albedo, largest = float(mean_albedo(table).max()), float(np.fmax.reduce(table, axis=None))
    if 2 * np.count_nonzero(table > UNSCALED) > 3 * np.count_nonzero(valid) or albedo > UNSCALED:
        told = "values look unscaled ({}): were MERL's factors (1, 1.15, 1.66)/1500 left out?"
    elif largest < 1e-3 or albedo < 1e-3:
        told = "values look scaled twice ({}): were MERL's factors applied before the file was written?"
    elif albedo > 1.2 and albedo * _weight()[valid].sum(dtype=float) / _weight().sum(dtype=float) > 1.2:
        # also if what was not measured reflects nothing: where only the highlight was measured, its mean says nothing
        told = "more light is reflected than arrives ({}): check the scale of the file"
    else:
        return ()
    return (told.format(f"albedo {albedo:.3g}, median {np.nanmedian(table):.3g}, largest value {largest:.3g} 1/sr"),)
