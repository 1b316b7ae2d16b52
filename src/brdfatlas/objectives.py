"""What a fit minimises, as weights on the MERL grid, and the measures that compare two BRDFs.

All weights are (90, 90, 180) or (90, 90, 180, 3) arrays; 0 marks a sample that is left out.
"""

import numpy as np

from brdfatlas.angles import grid_axes, grid_cosines, pair_measure, slice_measure
from brdfatlas.compiled import njit
from brdfatlas.constants import E2_ANGLE, LUMINANCE, MAX_ANGLE


def importance_weight(valid: np.ndarray, *, measure: str = "slice", max_angle: float = MAX_ANGLE) -> np.ndarray:
    """w_V w_I of Bagher et al. 2016 (Eqs. 9, 10), GRID_SHAPE float64; 0 where invalid or beyond ``max_angle``.

    ``measure``: "slice" is the published w_V, "pairs" the exact measure of direction pairs. A sample is left out if
    either angle exceeds ``max_angle`` (radians).
    """
    volume = {"slice": slice_measure, "pairs": pair_measure}[measure]()
    cos_i, cos_o = grid_cosines()
    keep = valid & (np.minimum(cos_i, cos_o) >= np.cos(max_angle))
    return np.where(keep, volume * np.maximum(cos_i, 0) * np.maximum(cos_o, 0), 0.0)


def weighted_median(values: np.ndarray, weights: np.ndarray) -> float:
    """The smallest value at which half of the weight is reached; arrays of one shape. ValueError if all weigh 0."""
    keep = weights > 0
    values, weights = values[keep], weights[keep]
    if values.size == 0:
        raise ValueError("weighted median of nothing")
    order = np.argsort(values, kind="stable")
    total = np.cumsum(weights[order])
    return float(values[order[np.searchsorted(total, 0.5 * total[-1])]])


@njit(cache=True, nogil=True)
def _weighted_median(values, weights, bits):
    """The bits of :func:`fast_median`, in two passes."""
    first = np.zeros(65536)
    for i in range(values.size):
        if weights[i] > 0:
            first[bits[i] >> 16] += weights[i]
    half = 0.5 * first.sum()
    below, high = 0.0, 0
    while high < 65535 and below + first[high] < half:
        below += first[high]
        high += 1
    second = np.zeros(65536)
    for i in range(values.size):
        if weights[i] > 0 and bits[i] >> 16 == high:
            second[bits[i] & 65535] += weights[i]
    last = 0
    for low in range(65536):
        if second[low] > 0:
            below += second[low]
            last = low
            if below >= half:
                break
    return high * 65536 + last


def fast_median(values: np.ndarray, weights: np.ndarray) -> float:
    """:func:`weighted_median` of float32 values >= 0 (n,), which sort like their bits, in an eighth of the time."""
    values = values + np.float32(0)  # -0 sorts above all by its bits
    return float(np.uint32(_weighted_median(values, weights, values.view(np.uint32))).view(np.float32))


@njit(cache=True, nogil=True)
def _compress(values, importance, scale, power, out):
    for i in range(values.size):
        if importance[i] > 0:
            x = values[i] / scale
            ratio = -np.expm1(-np.log(2.0) * x) / (np.log(2.0) * x) if x > 1e-8 else 1.0
            out[i] = importance[i] * ratio**power
        else:
            out[i] = 0.0


def compressive_weight(rho: np.ndarray, importance: np.ndarray, power: float = 1.4) -> np.ndarray:
    """w = w_V w_I w_C of one channel (Bagher et al. 2016, Eqs. 8-12), GRID_SHAPE float64.

    w_C = (f(x) / x)^p with f(x) = (1 - 2^-x) / ln 2, x = rho / (weighted median of rho). ``power`` = 0 turns the
    compressive part off. A channel whose median is 0 (dark) has x taken against its mean, and w_C = 1 if that is
    0 as well. Raises ValueError if no sample has a weight.
    """
    importance = np.ascontiguousarray(importance, float)
    flat = importance.ravel()
    if not (flat > 0).any():
        raise ValueError("no valid sample within 89 degrees")
    values = np.where(flat > 0, rho.ravel(), 0).astype(np.float32)
    scale = fast_median(values, flat)
    if scale <= 0:
        scale = float((values * flat).sum() / flat.sum())
    if power == 0 or scale <= 0:
        return importance.copy()
    out = np.empty_like(flat)
    _compress(values, flat, scale, power, out)
    return out.reshape(importance.shape)


def compressive_weights(
    table: np.ndarray, *, power: float = 1.4, measure: str = "slice", max_angle: float = MAX_ANGLE
) -> np.ndarray:
    """:func:`compressive_weight` of the three channels of a table with NaN for invalid; (90, 90, 180, 3) float64."""
    importance = importance_weight(~np.isnan(table[..., 0]), measure=measure, max_angle=max_angle)
    return np.stack([compressive_weight(table[..., c], importance, power) for c in range(3)], -1)


@njit(cache=True, nogil=True)
def _weighted_squares(fitted, table, weights):
    """sum w (f - rho)^2 and sum w rho^2 of each channel, (2, 3); arrays (n, 3)."""
    sums = np.zeros((2, 3))
    for i in range(len(table)):
        for c in range(3):
            if weights[i, c] > 0:
                rho = np.float64(table[i, c])
                sums[0, c] += weights[i, c] * (np.float64(fitted[i, c]) - rho) ** 2
                sums[1, c] += weights[i, c] * rho * rho
    return sums


def relative_objective(fitted: np.ndarray, table: np.ndarray, weights: np.ndarray) -> float:
    """sum w (f - rho)^2 / sum w rho^2 per channel, averaged over rgb, for tables and weights (..., 3); a dark
    channel counts its absolute error."""
    errors, powers = _weighted_squares(*(x.reshape(-1, 3) for x in (fitted, table, weights)))
    return float(np.mean(errors / np.where(powers > 0, powers, 1.0)))


def least_squares_weights(
    table: np.ndarray, objective: str, max_angle: float = MAX_ANGLE, *, together: bool = False
) -> np.ndarray:
    """Weights (90, 90, 180, 3) whose weighted sum of squares is the objective.

    ``objective``: "compressive", :func:`relative_objective` in Bagher 2016's weights; "cosine", the square of
    :func:`cosine_weighted`. Of the compressive one: ``max_angle`` (radians), and ``together`` for one weight of rgb,
    that of the luminance. Raises ValueError if no valid sample lies within 89 degrees.
    """
    if objective == "compressive" and together:
        importance = importance_weight(~np.isnan(table[..., 0]), max_angle=max_angle)
        values = np.nan_to_num(table)
        luminance = np.maximum(values @ LUMINANCE.astype(np.float32), 0)
        weight = compressive_weight(luminance, importance)
        power = float(np.einsum("hdp,hdpc,hdpc->", weight, values, values))
        return np.repeat((weight / (power if power > 0 else 1.0))[..., None], 3, -1)
    if objective == "compressive":
        weights = compressive_weights(table, max_angle=max_angle)
        for c in range(3):
            rho = np.nan_to_num(table[..., c]).astype(float)
            power = float(np.vdot(weights[..., c] * rho, rho))
            weights[..., c] /= 3 * (power if power > 0 else 1.0)
        return weights
    if objective != "cosine":
        raise ValueError(f"unknown least-squares objective {objective!r}; known: compressive, cosine")
    cos_i, cos_o = grid_cosines()
    keep = (np.minimum(cos_i, cos_o) >= np.cos(MAX_ANGLE)) & ~np.isnan(table[..., 0])
    measure = np.where(keep, pair_measure(), 0.0)
    if not keep.any():
        raise ValueError("no valid sample within 89 degrees")
    weight = measure * cos_i.astype(float) ** 2 / (3 * measure.sum())
    return np.repeat(weight[..., None], 3, -1)


def graded_weights(
    table: np.ndarray, objective: str, max_angle: float, grazing: float, *, together: bool = False
) -> np.ndarray:
    """:func:`least_squares_weights`, but that the compressive metric counts in full within ``max_angle`` (radians) and
    by ``grazing`` of its whole range beyond: 1 / (cos theta_i cos theta_o) would make the last degrees rule the fit,
    which measurements know least. Under "e2", the weights of the optimum from which it starts, the compressive ones.
    ``table`` and the weights: (90, 90, 180, 3)."""
    if objective == "cosine":
        return least_squares_weights(table, "cosine")
    whole, inner = (
        least_squares_weights(table, "compressive", angle, together=together) for angle in (MAX_ANGLE, max_angle)
    )
    return (grazing * whole + inner) / (1 + grazing)


@njit(cache=True, nogil=True)
def _deviation(a, b, weights, cosines, logarithmic, squared):
    """sum over samples of w times the sum over rgb of the difference of a cos and b cos, of their log1p if
    ``logarithmic``, its absolute value or its square; tables (n, 3), samples of weight 0 may be NaN."""
    total = 0.0
    for i in range(len(a)):
        if weights[i] > 0:
            cosine, part = np.float64(cosines[i]), 0.0
            for c in range(3):
                x, y = a[i, c] * cosine, b[i, c] * cosine
                d = abs(x - y)
                if logarithmic:  # one logarithm, of (1 + x) / (1 + y) with x the larger
                    x, y = max(x, 0.0), max(y, 0.0)
                    d = np.log1p(abs(x - y) / (1 + min(x, y)))
                part += d * d if squared else d
            total += weights[i] * part
    return total


def _common(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Cells (90, 90, 180) where both tables are valid."""
    return ~(np.isnan(a[..., 0]) | np.isnan(b[..., 0]))


def _mean_deviation(a: np.ndarray, b: np.ndarray, weights: np.ndarray, *, logarithmic: bool, squared: bool) -> float:
    """Weighted mean over samples of :func:`_deviation`, cos(theta_i) 0 below the horizon. NaN if none counts."""
    cosines = np.maximum(grid_cosines()[0], 0).ravel()
    weights = np.ascontiguousarray(weights, float).ravel()
    total = weights.sum()
    if not total > 0:
        return float("nan")
    return float(_deviation(a.reshape(-1, 3), b.reshape(-1, 3), weights, cosines, logarithmic, squared) / total)


def log_deviation(a: np.ndarray, b: np.ndarray, min_cosine: float = 0.1) -> float:
    """mean |log1p(f cos) - log1p(g cos)| over cells where both tables are valid and both cosines exceed
    ``min_cosine``; cos is cos(theta_i). For two tables (90, 90, 180, 3) in 1/sr; symmetric, 0 for equal tables, NaN
    where they have no such cell in common."""
    keep = (np.minimum(*grid_cosines()) > min_cosine) & _common(a, b)
    return _mean_deviation(a, b, keep, logarithmic=True, squared=False) / 3


def e2_weights(valid: np.ndarray, max_angle: float = E2_ANGLE) -> np.ndarray:
    """The weight of every sample in Löw's E2, (90, 90, 180) float64 of sum 1: its share of the direction pairs with
    theta_h, theta_d <= ``max_angle`` (radians) among the ``valid``.

    Equal weights for the cells of the file would be another metric: half of them have theta_h < 22 degrees, and the
    highlight would count for almost everything. Raises ValueError if no valid sample lies within.
    """
    theta_h, theta_d, _ = grid_axes()
    weights = np.where(valid & (theta_h <= max_angle) & (theta_d <= max_angle), pair_measure(), 0.0)
    total = weights.sum()
    if not total > 0:
        raise ValueError(f"no valid sample with theta_h and theta_d within {np.rad2deg(max_angle):g} degrees")
    return weights / total


def within(table: np.ndarray, max_angle: float) -> np.ndarray:
    """``table`` (90, 90, 180, 3) without the samples whose theta_i or theta_o exceeds ``max_angle`` (radians): NaN."""
    outside = np.minimum(*grid_cosines()) < np.cos(max_angle)
    return np.where(outside[..., None], np.float32(np.nan), table)


def loew_e2(a: np.ndarray, b: np.ndarray, max_angle: float = E2_ANGLE) -> float:
    """Löw et al. 2012, E2: mean over direction pairs (:func:`e2_weights`) of the squared difference of
    ln(1 + rho cos theta_i), summed over rgb; both tables (90, 90, 180, 3), 1/sr, NaN for invalid."""
    weights = e2_weights(_common(a, b), max_angle)
    return _mean_deviation(a, b, weights, logarithmic=True, squared=True)


def cosine_weighted(a: np.ndarray, b: np.ndarray) -> float:
    """Ngan et al. 2005: root of the mean of ((rho - rho*) cos theta_i)^2 over direction pairs (solid-angle measure,
    both angles <= 89 degrees), rgb averaged; tables (90, 90, 180, 3) in 1/sr."""
    keep = (np.minimum(*grid_cosines()) >= np.cos(MAX_ANGLE)) & _common(a, b)
    mean = _mean_deviation(a, b, np.where(keep, pair_measure(), 0.0), logarithmic=False, squared=True)
    return float(np.sqrt(mean / 3))
