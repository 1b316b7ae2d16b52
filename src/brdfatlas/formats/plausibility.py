"""What is suspicious in a table that can be read: its scale, above all."""

from functools import cache

import numpy as np

from brdfatlas.angles import grid_cosines, pair_measure


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
    """Warnings on the scale of a table in 1/sr, one line each; none if it looks like reflectance."""
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
