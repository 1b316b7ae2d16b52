"""What is suspicious in a table that can be read: its scale, its size, a highlight on the wrong side."""

from functools import cache

import numpy as np

from brdfatlas.angles import above_horizon, grid_cosines, pair_measure, theta_d_centres, theta_h_centres

#: Share of the cells above the horizon below which pictures show more of what was not measured than a reader expects.
FEW_CELLS = 0.75
#: How much brighter than in the mirror direction a material may be towards its light; no measured one reaches 1.
BACKWARD = 2.0


@cache
def _weight() -> np.ndarray:
    """cos(theta_i) cos(theta_o) times the measure of direction pairs; 0 below the horizon. GRID_SHAPE, read-only."""
    cos_i, cos_o = grid_cosines()
    weight = (np.maximum(cos_i, 0) * np.maximum(cos_o, 0) * pair_measure()).astype(np.float32)
    weight.flags.writeable = False
    return weight


def mean_albedo(table: np.ndarray) -> np.ndarray:
    """Bihemispherical albedo rgb of a (90, 90, 180, 3) table: pi times the mean of f over pairs of directions, each
    weighted by both cosines, over the valid cells. A Lambertian table gives its albedo exactly."""
    valid = ~np.isnan(table[..., 0])
    weight = _weight()[valid].astype(float)
    return np.pi * (weight @ table[valid]) / max(weight.sum(), 1e-300)


def suspicions(table: np.ndarray) -> tuple[str, ...]:
    """Warnings on a table in 1/sr, one line each; none if it looks like reflectance."""
    share = (~np.isnan(table[..., 0])).sum() / above_horizon().sum()
    told = f"{100 * share:.3g}% of the cells above the horizon were measured; elsewhere the nearest of them stands in"
    return (*((told,) if share < FEW_CELLS else ()), *_backward(table), *_scale(table))


def _backward(table: np.ndarray) -> tuple[str, ...]:
    """A suspicion, where light from 30 to 60 degrees goes back to where it came from and not on."""
    theta_h, theta_d = np.rad2deg(theta_h_centres()), np.rad2deg(theta_d_centres())
    oblique = [(theta > 30) & (theta < 60) for theta in (theta_h, theta_d)]
    cells = table[theta_h < 1][:, oblique[1]], table[oblique[0]][:, theta_d < 8]
    values = [part[~np.isnan(part[..., 0])] for part in cells]
    if not all(part.size for part in values):
        return ()
    mirror, back = (float(np.median(part.mean(-1))) for part in values)
    if back <= BACKWARD * mirror:
        return ()
    told = f"{back:.3g} 1/sr back to the light, {mirror:.3g} in the mirror direction"
    return (f"brightest towards the light ({told}): the mirror direction has phi_o = phi_i + 180 degrees",)


def _scale(table: np.ndarray) -> tuple[str, ...]:
    values = table[~np.isnan(table[..., 0])]
    albedo, median, largest = float(mean_albedo(table).max()), float(np.median(values)), float(values.max())
    told = f"albedo {albedo:.3g}, median {median:.3g}, largest value {largest:.3g} 1/sr"
    if median > 100 or albedo > 100:
        return (f"values look unscaled ({told}): were MERL's factors (1, 1.15, 1.66)/1500 left out?",)
    if largest < 1e-3 or albedo < 1e-3:
        return (f"values look scaled twice ({told}): were MERL's factors applied before the file was written?",)
    if albedo > 1.2:
        return (f"more light is reflected than arrives ({told}): check the scale of the file",)
    return ()
