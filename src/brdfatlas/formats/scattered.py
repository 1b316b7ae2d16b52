"""Samples at scattered pairs of directions, put on the MERL grid.

An isotropic, reciprocal BRDF that is mirror symmetric is a smooth function of theta_h, theta_d and the square of
q = (cos(theta_o) - cos(theta_i)) / 2 = sin(theta_h) sin(theta_d) cos(phi_d). ln f is interpolated over (sqrt(theta_h),
theta_d, q) by a thin-plate spline through all samples and their images at -q, so that both symmetries hold by
construction and the highlight, which is narrow in theta_h, is wide. Tables that are regular in theta_i, theta_o and
the azimuth between them are interpolated linearly between their nodes instead.

Both end at the hull of what was measured: the convex hull of the samples over (theta_i, theta_o cos phi, theta_o sin
phi), both orders of directions, phi the azimuth between them. Outside nothing was measured.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.interpolate import RegularGridInterpolator
from scipy.linalg import lapack
from scipy.spatial import ConvexHull, QhullError, cKDTree

from brdfatlas.angles import (
    GRID_SHAPE,
    above_horizon,
    directions,
    half_difference,
    phi_d_centres,
    theta_d_centres,
    theta_h_centres,
)
from brdfatlas.compiled import njit
from brdfatlas.measured import MeasuredError

#: Values below this part of a channel's median are raised to it before the logarithm: noise around 0.
FLOOR = 1e-3
#: The same pair of directions, in radians, and how far values there may differ before they disagree.
SAME_PAIR, DISAGREE = 1e-5, 0.2
#: Samples up to which one spline goes through all; more are interpolated by their nearest NEIGHBOURS.
MOST_GLOBAL, NEIGHBOURS = 3000, 40
#: Every so many degrees of phi_d the spline is evaluated; between, ln f is linear.
PHI_STEP = 5
FEWEST = 20


def azimuth(wi: np.ndarray, wo: np.ndarray) -> np.ndarray:
    """The azimuth between directions (..., 3), 0 to pi: mirror images have the same."""
    dot = wi[..., 0] * wo[..., 0] + wi[..., 1] * wo[..., 1]
    cross = wi[..., 0] * wo[..., 1] - wi[..., 1] * wo[..., 0]
    return np.abs(np.arctan2(cross, dot))


def disk(wi: np.ndarray, wo: np.ndarray) -> np.ndarray:
    """(..., 3): theta_i, and theta_o as a point of the half disk; distances there are angles, nearly."""
    theta_i, theta_o = (np.arctan2(np.hypot(w[..., 0], w[..., 1]), w[..., 2]) for w in (wi, wo))
    phi = azimuth(wi, wo)
    return np.stack([theta_i, theta_o * np.cos(phi), theta_o * np.sin(phi)], -1)


def symmetric(wi: np.ndarray, wo: np.ndarray) -> np.ndarray:
    """(..., 3): sqrt(theta_h), theta_d and q, the coordinates in which ln f is smooth."""
    theta_h, theta_d, _ = half_difference(wi, wo)
    return np.stack([np.sqrt(theta_h), theta_d, (wo[..., 2] - wi[..., 2]) / 2], -1)


@dataclass(frozen=True)
class Samples:
    """Values rgb (n, 3) in 1/sr at pairs of unit vectors wi, wo, each (n, 3); ``places``: where each stands in its
    file, for messages."""

    wi: np.ndarray
    wo: np.ndarray
    values: np.ndarray
    places: np.ndarray

    @cached_property
    def hull(self) -> ConvexHull:
        points = np.concatenate([disk(self.wi, self.wo), disk(self.wo, self.wi)])
        return ConvexHull(points)

    @cached_property
    def tree(self) -> cKDTree:
        return cKDTree(np.concatenate([disk(self.wi, self.wo), disk(self.wo, self.wi)]))

    def inside(self, wi: np.ndarray, wo: np.ndarray) -> np.ndarray:
        """Whether pairs (n, 3) lie within the hull of the samples; a degree more at its edge, for cell centres."""
        equations = self.hull.equations
        within = np.ones(len(wi), bool)
        for start in range(0, len(wi), 20000):
            part = slice(start, start + 20000)
            sides = disk(wi[part], wo[part]) @ equations[:, :3].T + equations[:, 3]
            within[part] = (sides <= np.deg2rad(1.0)).all(1)
        return within

    def distance(self, wi: np.ndarray, wo: np.ndarray) -> np.ndarray:
        """Degrees from each pair (n, 3) to the nearest sample or its image under reciprocity and mirror."""
        return np.rad2deg(self.tree.query(disk(wi, wo))[0])


def unique(path, samples: Samples) -> tuple[Samples, tuple[str, ...]]:
    """Samples with each pair of directions once, mean values where it was there more often; and the word on it.

    MeasuredError, naming both places, where two values of one pair, in the same order, differ by more than DISAGREE.
    """
    key = np.rint(disk(samples.wi, samples.wo) / SAME_PAIR).astype(np.int64)
    _, first, inverse, count = np.unique(key, axis=0, return_index=True, return_inverse=True, return_counts=True)
    if len(first) == len(key):
        return samples, ()
    inverse = inverse.ravel()
    mean = np.stack([np.bincount(inverse, samples.values[:, c]) / count for c in range(3)], -1)
    gap = np.abs(samples.values - mean[inverse]).max(-1)
    wide = gap > DISAGREE / 2 * np.maximum(np.abs(mean).max(-1)[inverse], 1e-6)
    if wide.any():
        one = int(np.flatnonzero(wide)[0])
        other = next(int(i) for i in np.flatnonzero(inverse == inverse[one]) if i != one)
        a, b = sorted((int(samples.places[one]), int(samples.places[other])))
        raise MeasuredError(
            f"{path}: lines {a} and {b} give one pair of directions, as seen from the normal, different values "
            f"({samples.values[one].max():.4g} and {samples.values[other].max():.4g}): remove one, or the sample is "
            "anisotropic, which is not read"
        )
    order = np.sort(first)
    kept = Samples(samples.wi[order], samples.wo[order], mean[inverse[order]], samples.places[order])
    return kept, (f"{len(key) - len(first):,} pairs of directions are there more than once; their values are averaged",)


def _floored(values: np.ndarray) -> np.ndarray:
    """ln f with values below FLOOR of a channel's median raised to that; a black channel is NaN throughout."""
    with np.errstate(divide="ignore", invalid="ignore"):
        middle = np.array([np.median(v[v > 0]) if (v > 0).any() else np.nan for v in values.T])
        return np.log(np.maximum(values, FLOOR * middle))


@njit(cache=True, nogil=True)
def _spline(points, weights, at, out):
    """Sums of thin-plate kernels r^2 ln r, with the linear part in the last four rows of ``weights``."""
    n, channels = points.shape[0], weights.shape[1]
    for s in range(at.shape[0]):
        x, y, z = at[s, 0], at[s, 1], at[s, 2]
        for c in range(channels):
            out[s, c] = weights[n, c] + weights[n + 1, c] * x + weights[n + 2, c] * y + weights[n + 3, c] * z
        for i in range(n):
            dx, dy, dz = x - points[i, 0], y - points[i, 1], z - points[i, 2]
            square = dx * dx + dy * dy + dz * dz
            if square > 0.0:
                kernel = 0.5 * square * np.log(square)
                for c in range(channels):
                    out[s, c] += weights[i, c] * kernel


def _weights(points: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Weights of thin-plate splines, (..., n + 4, c), through values (..., n, c) at points (..., n, 3)."""
    n = points.shape[-2]
    square = ((points[..., :, None, :] - points[..., None, :, :]) ** 2).sum(-1)
    kernel = np.zeros_like(square)
    np.log(square, out=kernel, where=square > 0)
    linear = np.concatenate([np.ones((*points.shape[:-1], 1)), points], -1)
    matrix = np.zeros((*points.shape[:-2], n + 4, n + 4))
    matrix[..., :n, :n] = 0.5 * square * kernel
    matrix[..., :n, n:], matrix[..., n:, :n] = linear, np.swapaxes(linear, -1, -2)
    right = np.zeros((*values.shape[:-2], n + 4, values.shape[-1]))
    right[..., :n, :] = values
    if matrix.ndim == 2:
        *_, solution, fault = lapack.dsysv(matrix, right)
        if fault == 0 and np.isfinite(solution).all():
            return solution
    matrix[..., np.arange(n), np.arange(n)] += 1e-9
    return np.linalg.lstsq(matrix, right, rcond=None)[0] if matrix.ndim == 2 else np.linalg.solve(matrix, right)


class Spline:
    """Thin-plate splines of ln f over :func:`symmetric`, exact at the samples up to noise of pairs that meet there."""

    def __init__(self, samples: Samples):
        points, values = symmetric(samples.wi, samples.wo), _floored(samples.values)
        points = np.concatenate([points, points * [1, 1, -1]])
        key = np.rint(points / 1e-4).astype(np.int64)
        _, first, inverse, count = np.unique(key, axis=0, return_index=True, return_inverse=True, return_counts=True)
        values = np.concatenate([values, values])
        self.points = points[first]
        self.values = np.stack([np.bincount(inverse.ravel(), v) / count for v in values.T], -1)
        self.low, self.high = np.nanmin(values, 0), np.nanmax(values, 0)
        self.local = len(samples.wi) > MOST_GLOBAL
        if self.local:
            self.tree = cKDTree(self.points)
        else:
            self.weights = _weights(self.points, np.nan_to_num(self.values))

    def __call__(self, wi: np.ndarray, wo: np.ndarray) -> np.ndarray:
        """ln f, rgb, at pairs (n, 3), never beyond the range of the samples; NaN in a black channel."""
        at = np.ascontiguousarray(symmetric(wi, wo))
        out = self._nearest(at) if self.local else np.empty((len(at), 3))
        if not self.local:
            _spline(self.points, self.weights, at, out)
        return np.where(np.isnan(self.low), np.nan, np.clip(out, self.low, self.high))

    def _nearest(self, at: np.ndarray) -> np.ndarray:
        out = np.empty((len(at), 3))
        for start in range(0, len(at), 5000):
            part = at[start : start + 5000]
            _, near = self.tree.query(part, min(NEIGHBOURS, len(self.points)))
            points = self.points[near] - part[:, None]
            weights = _weights(points, np.nan_to_num(self.values[near]))
            square = (points**2).sum(-1)
            kernel = np.zeros_like(square)
            np.log(square, out=kernel, where=square > 0)
            n = points.shape[1]
            out[start : start + 5000] = np.einsum("sn,snc->sc", 0.5 * square * kernel, weights[:, :n]) + weights[:, n]
        return out


class Regular:
    """A table that is regular in theta_i, theta_o and the azimuth between them, exact at its nodes.

    Linear between nodes in ln f, in f where a channel has values that are not positive. Of the two orders of
    directions that lie inside, each counts by the inverse of its distance to the nearest node.
    """

    def __init__(self, axes: tuple[np.ndarray, ...], values: np.ndarray):
        self.axes = axes
        self.logarithmic = bool((values > 0).all())
        self.look_up = RegularGridInterpolator(
            axes, np.log(values) if self.logarithmic else values, bounds_error=False, fill_value=np.nan
        )

    def __call__(self, wi: np.ndarray, wo: np.ndarray) -> np.ndarray:
        """ln f, rgb, at pairs (n, 3); NaN where neither order lies between the nodes."""
        total, weights = np.zeros((len(wi), 3)), np.zeros((len(wi), 1))
        phi = azimuth(wi, wo)
        theta = [np.arctan2(np.hypot(w[:, 0], w[:, 1]), w[:, 2]) for w in (wi, wo)]
        for one, other in (theta, theta[::-1]):
            at = np.stack([one, other, phi], -1)
            for axis, nodes in enumerate(self.axes):  # rounding at the ends
                near = (at[:, axis] > nodes[0] - 1e-6) & (at[:, axis] < nodes[-1] + 1e-6)
                at[near, axis] = np.clip(at[near, axis], nodes[0], nodes[-1])
            values = self.look_up(at)
            gap = sum(_gap(nodes, at[:, axis]) ** 2 for axis, nodes in enumerate(self.axes))
            weight = np.where(np.isnan(values[:, :1]), 0.0, 1 / (np.sqrt(gap)[:, None] + 1e-9))
            total, weights = total + weight * np.nan_to_num(values), weights + weight
        with np.errstate(invalid="ignore", divide="ignore"):
            mean = total / weights
            return mean if self.logarithmic else np.log(np.maximum(mean, 0))


def _gap(nodes: np.ndarray, at: np.ndarray) -> np.ndarray:
    i = np.clip(np.searchsorted(nodes, at), 1, len(nodes) - 1)
    return np.minimum(np.abs(at - nodes[i - 1]), np.abs(at - nodes[i]))


def regular(samples: Samples) -> Regular | None:
    """The table as a regular one, or None: every theta_i with every theta_o and every azimuth, at least two of each;
    at theta 0 one azimuth stands for all."""
    theta_i, theta_o = (np.arctan2(np.hypot(w[:, 0], w[:, 1]), w[:, 2]) for w in (samples.wi, samples.wo))
    phi = azimuth(samples.wi, samples.wo)
    columns = [np.round(a, 5) for a in (theta_i, theta_o, phi)]
    tilted = (columns[0] > 0) & (columns[1] > 0)
    nodes = [np.unique(columns[0]), np.unique(columns[1]), np.unique(columns[2][tilted])]
    shape = tuple(len(n) for n in nodes)
    if min(shape) < 2 or np.prod(shape) > 4 * len(phi) or np.prod(shape) < len(phi) / 3:
        return None
    values, count = np.zeros((*shape, 3)), np.zeros(shape)
    i, o, p = (np.clip(np.searchsorted(n, c), 0, len(n) - 1) for n, c in zip(nodes, columns))
    np.add.at(values, (i[tilted], o[tilted], p[tilted]), samples.values[tilted])
    np.add.at(count, (i[tilted], o[tilted], p[tilted]), 1)
    for s in np.flatnonzero(~tilted):
        values[i[s], o[s], :] += samples.values[s]
        count[i[s], o[s], :] += 1
    if (count == 0).any():
        return None
    exact = tuple(
        np.array([a[np.round(a, 5) == node].mean() for node in n]) for a, n in zip((theta_i, theta_o, phi), nodes)
    )
    return Regular(exact, values / count[..., None])


@dataclass(frozen=True)
class OnGrid:
    """A table (90, 90, 180, 3) float32, degrees to the nearest sample (90, 90, 180) float32, both NaN outside the
    hull, and how it was interpolated, in words."""

    table: np.ndarray
    distance: np.ndarray
    how: str


def on_grid(path, samples: Samples) -> OnGrid:
    """The samples on the MERL grid. MeasuredError where they are too few, or do not span three dimensions."""
    if len(samples.wi) < FEWEST:
        raise MeasuredError(f"{path}: {len(samples.wi)} pairs of directions, at least {FEWEST} are needed")
    if not (samples.values > 0).any():
        raise MeasuredError(f"{path}: black, no value is above 0")
    try:
        samples.hull  # noqa: B018
    except QhullError:
        raise MeasuredError(
            f"{path}: the directions lie in one plane; out-of-plane ones are needed, or several theta_i and theta_o"
        ) from None
    source = regular(samples)
    how = "linear between the nodes of a regular table" if source else "thin-plate splines in ln f between samples"
    if source:
        logs, inside, distance = _everywhere(source, samples, phi_d_centres()[: GRID_SHAPE[2] // 2], None)
    else:
        steps = np.linspace(0, np.pi / 2, 90 // PHI_STEP + 1)
        logs, inside, distance = _everywhere(Spline(samples), samples, phi_d_centres()[: GRID_SHAPE[2] // 2], steps)
    values = np.exp(logs)
    values[np.isnan(values) & inside[..., None]] = 0.0  # black channels
    table = np.where(inside[..., None], values, np.nan).astype(np.float32)
    distance = np.where(inside, distance, np.nan).astype(np.float32)
    full = [np.concatenate([half, half[:, :, ::-1]], 2) for half in (table, distance)]  # phi_d and pi - phi_d are one
    return OnGrid(np.ascontiguousarray(full[0]), np.ascontiguousarray(full[1]), how)


def _everywhere(source, samples: Samples, phi_d: np.ndarray, steps: np.ndarray | None):
    """ln f, inside or not, and distance at theta_h, theta_d and phi_d up to pi/2: (90, 90, 90, ...)."""
    shape = (GRID_SHAPE[0], GRID_SHAPE[1], len(phi_d))
    inside, distance = np.zeros(shape, bool), np.full(shape, np.nan)
    cells = above_horizon()[:, :, : shape[2]]
    wi, wo = directions(theta_h_centres()[:, None, None], theta_d_centres()[:, None], phi_d)
    inside[cells] = samples.inside(wi[cells], wo[cells])
    distance[inside] = samples.distance(wi[inside], wo[inside])
    logs = np.full((*shape, 3), np.nan)
    if steps is None:
        logs[inside] = source(wi[inside], wo[inside])
        inside &= ~np.isnan(logs).all(-1)
        return logs, inside, distance
    rows = inside.any(-1)
    theta_h, theta_d = np.nonzero(rows)
    at = directions(theta_h_centres()[theta_h, None], theta_d_centres()[theta_d, None], steps)
    values = source(at[0].reshape(-1, 3), at[1].reshape(-1, 3)).reshape(len(theta_h), len(steps), 3)
    place = phi_d / (steps[1] - steps[0])
    low = np.minimum(place.astype(int), len(steps) - 2)
    w = (place - low)[:, None]
    logs[rows] = values[:, low] * (1 - w) + values[:, low + 1] * w
    return logs, inside, distance
