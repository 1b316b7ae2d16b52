"""Samples at scattered pairs of directions, put on the MERL grid.

An isotropic, reciprocal BRDF that is mirror symmetric is a smooth function of theta_h, theta_d and the square of
q = (cos(theta_o) - cos(theta_i)) / 2 = sin(theta_h) sin(theta_d) cos(phi_d). ln f is interpolated over (sqrt(theta_h),
theta_d, |q|) by cubic splines through the samples and their images at -q, so that both symmetries hold by construction
and the highlight, which is narrow in theta_h, is wide. Tables that are regular in theta_i, theta_o and
the azimuth between them are interpolated linearly between their nodes instead.

Both end at the hull of what was measured: the convex hull of the samples over (theta_i, theta_o cos phi, theta_o sin
phi), both orders of directions, phi the azimuth between them. Outside nothing was measured.

SciPy's parts are imported where they are used: that takes longer than many a fit.
"""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

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
from brdfatlas.formats.files import name_of
from brdfatlas.formats.plausibility import suspicions
from brdfatlas.measured import MEASURED, SAME_PAIR, STANDIN, Measured, MeasuredError, Provenance

if TYPE_CHECKING:
    from scipy.spatial import ConvexHull, cKDTree

#: Values below this part of a channel's median are raised to it before the logarithm: noise around 0.
FLOOR = 1e-3
#: How far values of one pair of directions may differ before they disagree.
DISAGREE = 0.2
#: How far equal values differ in a text of six digits.
ROUNDING = 1e-5
#: Samples up to which one spline goes through all; more are interpolated by their nearest NEIGHBOURS.
MOST_GLOBAL, NEIGHBOURS = 3000, 40
#: Added to the kernel's diagonal: noise of neighbouring samples is not swung between.
SMOOTHING = 1e-4
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
    """(..., 3): sqrt(theta_h), theta_d and |q|, the coordinates in which ln f is smooth."""
    theta_h, theta_d, _ = half_difference(wi, wo)
    return np.stack([np.sqrt(theta_h), theta_d, np.abs(wo[..., 2] - wi[..., 2]) / 2], -1)


def _tree(points: np.ndarray) -> "cKDTree":
    from scipy.spatial import cKDTree

    return cKDTree(points)


@dataclass(frozen=True)
class Samples:
    """Values rgb (n, 3) in 1/sr at pairs of unit vectors wi, wo, each (n, 3); ``places``: where each stands in its
    file, for messages."""

    wi: np.ndarray
    wo: np.ndarray
    values: np.ndarray
    places: np.ndarray

    @cached_property
    def hull(self) -> "ConvexHull":
        from scipy.spatial import ConvexHull

        points = np.concatenate([disk(self.wi, self.wo), disk(self.wo, self.wi)])
        return ConvexHull(points)

    @cached_property
    def tree(self) -> "cKDTree":
        return _tree(np.concatenate([disk(self.wi, self.wo), disk(self.wo, self.wi)]))

    def inside(self, wi: np.ndarray, wo: np.ndarray) -> np.ndarray:
        """Whether pairs (n, 3) lie within the hull of the samples; a degree more at its edge, for cell centres."""
        return _within(self.hull.equations, disk(wi, wo), np.deg2rad(1.0))

    def distance(self, wi: np.ndarray, wo: np.ndarray) -> np.ndarray:
        """Degrees from each pair (n, 3) to the nearest sample or its image under reciprocity and mirror."""
        return np.rad2deg(self.tree.query(disk(wi, wo))[0])


@njit(cache=True, nogil=True)
def _within(equations, points, margin):
    """Whether each point is on the inner side of all planes, or no further than ``margin`` outside."""
    within = np.ones(len(points), np.bool_)
    for s in range(len(points)):
        for e in range(len(equations)):
            side = equations[e, 3]
            for axis in range(3):
                side += equations[e, axis] * points[s, axis]
            if side > margin:
                within[s] = False
                break
    return within


def unique(path, samples: Samples) -> tuple[Samples, tuple[str, ...]]:
    """Samples with each pair of directions once, mean values where it was there more often; and the word on it, unless
    they are equal to ROUNDING.

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
        same = np.flatnonzero(inverse == inverse[np.flatnonzero(wide)[0]])
        values = samples.values[same, np.ptp(samples.values[same], axis=0).argmax()]
        (a, one), (b, other) = sorted(
            (int(samples.places[same[i]]), values[i]) for i in (values.argmin(), values.argmax())
        )
        raise MeasuredError(
            f"{path}: lines {a} and {b} give one pair of directions, as seen from the normal, different values "
            f"({one:.4g} and {other:.4g}): remove one, or the sample is anisotropic, which is not read"
        )
    order = np.sort(first)
    kept = Samples(samples.wi[order], samples.wo[order], mean[inverse[order]], samples.places[order])
    if not (gap > ROUNDING * np.abs(mean).max(-1)[inverse]).any():  # at the normal a table names one pair often
        return kept, ()
    return kept, (f"{len(key) - len(first):,} pairs of directions are there more than once; their values are averaged",)


def exchanged(samples: Samples) -> tuple[str, ...]:
    """A word on samples whose values change where the two directions are exchanged, by more than DISAGREE in the
    median: of reflectance they do not, times cos(theta_o) they do."""
    there, back = disk(samples.wi, samples.wo), disk(samples.wo, samples.wi)
    near, other = _tree(there).query(back, distance_upper_bound=SAME_PAIR)
    total, cosine = samples.values.sum(1), samples.wo[:, 2]
    one = np.flatnonzero(near < np.inf)
    other = other[one]
    one, other = (
        i[(np.abs(cosine[one] - cosine[other]) > 0.05) & (total[one] > 0) & (total[other] > 0)] for i in (one, other)
    )
    if len(one) < FEWEST:
        return ()
    change = np.log(total[one] / total[other])
    middle = float(np.median(np.abs(change)))
    if middle < DISAGREE:
        return ()
    left = float(np.median(np.abs(change - np.log(cosine[one] / cosine[other]))))
    cause = "; the values look like f cos (# values: f cos)" if left < middle / 2 else ""
    return (f"values change by {np.expm1(middle):.0%} where directions are exchanged, their mean is taken{cause}",)


def _split(values: np.ndarray) -> np.ndarray:
    """(n, 4): ln of r + g + b, raised to FLOOR of its median, and the share of each channel in it. A channel of a
    saturated colour is 0 within noise: its logarithm would swing, its share does not."""
    total = values.sum(1)
    floor = FLOOR * np.median(total[total > 0])
    share = np.where(total[:, None] > floor, values / np.maximum(total, floor)[:, None], 1 / 3)
    return np.concatenate([np.log(np.maximum(total, floor))[:, None], share], 1)


def _joined(split: np.ndarray) -> np.ndarray:
    """rgb of :func:`_split` values, whose shares need not be within 0 and 1."""
    share = np.maximum(split[..., 1:], 0)
    return np.exp(split[..., :1]) * share / np.maximum(share.sum(-1, keepdims=True), 1e-9)


def without_dropouts(samples: Samples) -> tuple[Samples, tuple[str, ...]]:
    """Samples without those below a fifth of all their eight nearest ones, which an instrument lost; and the word."""
    total = samples.values.sum(1)
    points = symmetric(samples.wi, samples.wo)
    _, near = _tree(points).query(points, 9)
    keep = total >= total[near[:, 1:]].min(1) / 5
    if keep.all():
        return samples, ()
    kept = Samples(*(a[keep] for a in (samples.wi, samples.wo, samples.values, samples.places)))
    lost = int((~keep).sum())
    return kept, (f"far below all their neighbours, left out: {lost:,} sample{'s' if lost > 1 else ''}",)


@njit(cache=True, nogil=True, fastmath=True)
def _spline(points, weights, at, out):
    """Sums of cubic kernels r^3 at the points and at their images at -q; the linear part is in the last rows."""
    n = points.shape[0]
    for s in range(at.shape[0]):
        x, y, z = at[s, 0], at[s, 1], at[s, 2]
        a = b = c = d = 0.0
        for i in range(n):
            square = (x - points[i, 0]) ** 2 + (y - points[i, 1]) ** 2
            near, far = square + (z - points[i, 2]) ** 2, square + (z + points[i, 2]) ** 2
            kernel = near * np.sqrt(near) + far * np.sqrt(far)
            a += weights[i, 0] * kernel
            b += weights[i, 1] * kernel
            c += weights[i, 2] * kernel
            d += weights[i, 3] * kernel
        for k, value in enumerate((a, b, c, d)):
            out[s, k] = value + weights[n, k] + weights[n + 1, k] * x + weights[n + 2, k] * y


def _weights(points: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Weights of the splines, (..., n + 3, c), through values (..., n, c) at points (..., n, 3) with q >= 0."""
    n = points.shape[-2]
    one, other = points[..., :, None, :], points[..., None, :, :]
    kernel = sum(np.sqrt(((one - other * image) ** 2).sum(-1)) ** 3 for image in ([1, 1, 1], [1, 1, -1]))
    linear = np.concatenate([np.ones((*points.shape[:-1], 1)), points[..., :2]], -1)
    matrix = np.zeros((*points.shape[:-2], n + 3, n + 3))
    matrix[..., :n, :n] = kernel + SMOOTHING * np.eye(n)
    matrix[..., :n, n:], matrix[..., n:, :n] = linear, np.swapaxes(linear, -1, -2)
    matrix[..., np.arange(n, n + 3), np.arange(n, n + 3)] = -1e-9  # solvable where all points share a coordinate
    right = np.zeros((*values.shape[:-2], n + 3, values.shape[-1]))
    right[..., :n, :] = values
    return np.linalg.solve(matrix, right)


class Spline:
    """Cubic splines of :func:`_split` values over :func:`symmetric`, through the samples but for SMOOTHING."""

    def __init__(self, samples: Samples):
        points, values = symmetric(samples.wi, samples.wo), _split(samples.values)
        key = np.rint(points / 1e-4).astype(np.int64)  # pairs that are one by reciprocity or mirror: their mean
        _, first, inverse, count = np.unique(key, axis=0, return_index=True, return_inverse=True, return_counts=True)
        self.points = np.ascontiguousarray(points[first])
        self.values = np.stack([np.bincount(inverse.ravel(), v) / count for v in values.T], -1)
        self.low, self.high = self.values.min(0), self.values.max(0)
        self.local = len(self.points) > MOST_GLOBAL
        if self.local:
            self.tree = _tree(self.points)
        else:
            self.weights = _weights(self.points, self.values)

    def __call__(self, wi: np.ndarray, wo: np.ndarray) -> np.ndarray:
        """As :func:`_split`, (n, 4), at pairs (n, 3); never beyond the range of the samples."""
        at = np.ascontiguousarray(symmetric(wi, wo))
        out = np.empty((len(at), 4))
        if self.local:
            for start in range(0, len(at), 4000):
                self._nearest(at[start : start + 4000], out[start : start + 4000])
        else:
            _spline(self.points, self.weights, at, out)
        return np.clip(out, self.low, self.high)

    def _nearest(self, at: np.ndarray, out: np.ndarray) -> None:
        """Splines of their own through the nearest samples of each point."""
        _, near = self.tree.query(at, NEIGHBOURS)
        weights = _weights(self.points[near], self.values[near])
        for s in range(len(at)):
            _spline(self.points[near[s]], weights[s], at[s : s + 1], out[s : s + 1])


class Regular:
    """A table that is regular in theta_i, theta_o and the azimuth between them, exact at its nodes.

    Linear between nodes in :func:`_split` values. Of the two orders of
    directions that lie inside, each counts by the inverse of its distance to the nearest node.
    """

    def __init__(self, axes: tuple[np.ndarray, ...], values: np.ndarray):
        from scipy.interpolate import RegularGridInterpolator

        self.axes = axes
        split = _split(values.reshape(-1, 3)).reshape(*values.shape[:3], 4)
        self.look_up = RegularGridInterpolator(axes, split, bounds_error=False, fill_value=np.nan)

    def __call__(self, wi: np.ndarray, wo: np.ndarray) -> np.ndarray:
        """As :func:`_split`, (n, 4), at pairs (n, 3); NaN where neither order lies between the nodes."""
        total, weights = np.zeros((len(wi), 4)), np.zeros((len(wi), 1))
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
            return total / weights


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


def on_grid(samples: Samples) -> OnGrid:
    """Samples that :func:`checked` let pass on the MERL grid."""
    source = regular(samples)
    how = "linear between the nodes of a regular table" if source else "cubic splines in ln f between samples"
    if source:
        split, inside, distance = _everywhere(source, samples, phi_d_centres()[: GRID_SHAPE[2] // 2], None)
    else:
        steps = np.linspace(0, np.pi / 2, 90 // PHI_STEP + 1)
        split, inside, distance = _everywhere(Spline(samples), samples, phi_d_centres()[: GRID_SHAPE[2] // 2], steps)
    values = _joined(split)
    table = np.where(inside[..., None], values, np.nan).astype(np.float32)
    distance = np.where(inside, distance, np.nan).astype(np.float32)
    full = [np.concatenate([half, half[:, :, ::-1]], 2) for half in (table, distance)]  # phi_d and pi - phi_d are one
    return OnGrid(np.ascontiguousarray(full[0]), np.ascontiguousarray(full[1]), how)


def _everywhere(source, samples: Samples, phi_d: np.ndarray, steps: np.ndarray | None):
    """Values as of :func:`_split`, inside or not, distance, at (theta_h, theta_d, phi_d): (90, 90, 90, ...)."""
    shape = (GRID_SHAPE[0], GRID_SHAPE[1], len(phi_d))
    inside, distance = np.zeros(shape, bool), np.full(shape, np.nan)
    cells = above_horizon()[:, :, : shape[2]]
    wi, wo = directions(theta_h_centres()[:, None, None], theta_d_centres()[:, None], phi_d)
    inside[cells] = samples.inside(wi[cells], wo[cells])
    distance[inside] = samples.distance(wi[inside], wo[inside])
    split = np.full((*shape, 4), np.nan)
    if steps is None:
        split[inside] = source(wi[inside], wo[inside])
        inside &= ~np.isnan(split).all(-1)
        return split, inside, distance
    rows = inside.any(-1)
    theta_h, theta_d = np.nonzero(rows)
    at = directions(theta_h_centres()[theta_h, None], theta_d_centres()[theta_d, None], steps)
    values = source(at[0].reshape(-1, 3), at[1].reshape(-1, 3)).reshape(len(theta_h), len(steps), 4)
    place = phi_d / (steps[1] - steps[0])
    low = np.minimum(place.astype(int), len(steps) - 2)
    w = (place - low)[:, None]
    split[rows] = values[:, low] * (1 - w) + values[:, low + 1] * w
    return split, inside, distance


def on_sphere(path, columns: np.ndarray, places: np.ndarray, unit: str):
    """Unit vectors wi, wo (n, 3) of rows theta_i phi_i theta_o phi_o in ``unit`` "degrees" or "radians" ("" for
    degrees that nobody stated), or of six components ("vectors"); which rows are kept (bool), and words on those that
    are not, at exactly 90 degrees.

    MeasuredError, naming the line, for a direction below the surface, one that is no unit vector, and angles that are
    in the other unit by their looks.
    """
    if unit == "vectors":
        wi, wo = columns[:, :3], columns[:, 3:]
        length = np.stack([np.linalg.norm(w, axis=1) for w in (wi, wo)], -1)
        off = (np.abs(length - 1) > 1e-2).any(1)
        if off.any():
            at = int(np.flatnonzero(off)[0])
            worst = length[at, np.abs(length[at] - 1).argmax()]
            raise MeasuredError(f"{path}: line {places[at]}: a direction of length {worst:.4g}; 1 is wanted")
        wi, wo = wi / length[:, :1], wo / length[:, 1:]
    else:
        theta, phi = columns[:, 0::2], columns[:, 1::2]
        for name, angles, turn, least in (("theta", theta, np.pi / 2, 0.0), ("phi", phi, 2 * np.pi, 0.1)):
            largest = np.abs(angles).max()
            if not unit and least < largest <= turn + 1e-3 and len(columns) > 1:
                told = f"no {name} above {largest:.3g}: radians? Bring all angles to one unit and name it"
                raise MeasuredError(f"{path}: {told}, # angles: degrees or # angles: radians")
        unit = unit or "degrees"
        if unit == "radians" and (np.abs(theta).max() > 2 * np.pi or np.abs(phi).max() > 4 * np.pi):
            at = int(np.argmax(np.abs(columns).max(1)))
            raise MeasuredError(
                f"{path}: line {places[at]}: an angle of {np.abs(columns[at]).max():g}: degrees? radians are wanted"
            )
        if unit == "degrees" and np.abs(phi).max() > 720:
            at = int(np.argmax(np.abs(phi).max(1)))
            raise MeasuredError(
                f"{path}: line {places[at]}: an azimuth of {np.abs(phi[at]).max():g} degrees; correct it"
            )
        if unit == "degrees":
            theta, phi = np.deg2rad(theta), np.deg2rad(phi)
        if theta.min() < -1e-6:
            at = int(np.argmin(theta.min(1)))
            raise MeasuredError(f"{path}: line {places[at]}: a negative theta; make it positive, phi + 180")
        wi, wo = (
            np.stack([np.sin(t) * np.cos(p), np.sin(t) * np.sin(p), np.cos(t)], -1) for t, p in zip(theta.T, phi.T)
        )
    lowest = np.minimum(wi[:, 2], wo[:, 2])
    if lowest.min() < -1e-6:
        at = int(np.argmin(lowest))
        angle = np.rad2deg(np.arccos(np.clip(lowest[at], -1, 1)))
        raise MeasuredError(
            f"{path}: line {places[at]}: a direction below the surface, {angle:.4g} degrees; remove the row"
        )
    keep = lowest > 1e-6
    if not keep.any():
        raise MeasuredError(f"{path}: every pair has a direction at 90 degrees, where nothing can be measured")
    lost = int((~keep).sum())
    told = (f"{lost:,} rows with a direction at 90 degrees are left out",) if lost else ()
    return wi[keep], wo[keep], keep, told


def checked(path, samples: Samples) -> tuple[Samples, float, tuple[str, ...]]:
    """Samples ready to be interpolated, the share whose colour is out of gamut, and words on what was changed.

    All channels negative: no value, left out; a single one is 0. MeasuredError for too few, black, or flat data, and
    for pairs that disagree.
    """
    negative = samples.values < 0
    keep = ~negative.all(1)
    lost = int((~keep).sum())
    if lost == len(keep):
        raise MeasuredError(f"{path}: every row has negative values only, which are no reflectance; correct the sign")
    told = (f"{lost:,} rows with negative values only are left out",) if lost else ()
    share = float(negative[keep].any(1).mean()) if keep.any() else 0.0
    values = np.maximum(samples.values[keep], 0)
    kept, more = unique(path, Samples(samples.wi[keep], samples.wo[keep], values, samples.places[keep]))
    if len(kept.wi) < FEWEST:
        raise MeasuredError(f"{path}: {len(kept.wi)} pairs of directions, at least {FEWEST} are needed")
    if not kept.values.astype(np.float32).any():
        raise MeasuredError(f"{path}: black, no value is above 0")
    from scipy.spatial import QhullError

    try:
        kept.hull  # noqa: B018
    except (QhullError, ValueError):
        raise MeasuredError(
            f"{path}: the directions lie in one plane; several theta_i, theta_o and azimuths are needed"
        ) from None
    return kept, share, (*told, *more)


def to_measured(path, samples: Samples, *, format: str, warnings: tuple[str, ...] = (), **about: str) -> Measured:
    """Samples as a Measured of the MERL grid; ``about``: source, instrument, note, kind of a Provenance."""
    samples, share, told = checked(path, samples)
    told = (*told, *exchanged(samples))
    if not regular(samples):
        samples, lost = without_dropouts(samples)
        told = (*told, *lost)
    grid = on_grid(samples)
    if np.isnan(grid.table).all():
        raise MeasuredError(f"{path}: no cell of the MERL grid lies between the samples")
    valid = ~np.isnan(grid.table[..., 0])
    how = f"{len(samples.wi):,} pairs of directions, {grid.how}; {valid.sum() / above_horizon().sum():.0%} of the grid"
    kind = about.pop("kind", MEASURED)
    provenance = Provenance(
        format=format,
        kind=MEASURED if kind == STANDIN else kind,
        shares={"out of gamut": share},
        warnings=(*warnings, *told, how, *suspicions(grid.table)),
        **about,
    )
    angles = np.stack(half_difference(samples.wi, samples.wo), -1)
    return Measured(
        name_of(path), grid.table, kind == STANDIN, Path(path), provenance, grid.distance, angles.astype(np.float32)
    )
