"""A measured isotropic BRDF on the MERL grid: what it holds, where it comes from, looking up between cells.

Files are read by :mod:`brdfatlas.formats`.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from brdfatlas.angles import GRID_SHAPE, N_PHI_D, half_difference, unit_vectors
from brdfatlas.compiled import njit
from brdfatlas.files import shown

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

#: The same pair of directions, in radians.
SAME_PAIR = 1e-5
N_CELLS = int(np.prod(GRID_SHAPE))
#: Of a table on the MERL grid, and of one on the full circle.
TABLE_SHAPES = (*GRID_SHAPE, 3), (*GRID_SHAPE[:2], 2 * N_PHI_D, 3)
#: What a table may be: a measurement, somebody's reconstruction of one (a network, a fit), or a built-in stand-in.
KINDS = MEASURED, RECONSTRUCTED, STANDIN = "measured", "reconstructed", "stand-in"


class MeasuredError(ValueError):
    """A file that cannot be used as a measured BRDF; the message is one line that names the file and the fault."""

    def __init__(self, message: object):
        super().__init__(shown(message))  # whatever bytes the file has where a name or a number should be


@dataclass(frozen=True)
class Provenance:
    """Where a table comes from and what was done to it; JSON-able.

    ``format``: of the file; ``source``, ``instrument``, ``note``: words of the file, "" where there are none. ``kind``:
    MEASURED or RECONSTRUCTED. ``shares``: name -> share of the valid cells, 0 to 1 ("out of gamut": a channel was
    negative and is 0; "extrapolated"). ``warnings``: one line each, for page and terminal: what was assumed, changed or
    looks wrong.
    """

    format: str = ""
    source: str = ""
    instrument: str = ""
    note: str = ""
    kind: str = MEASURED
    shares: Mapping[str, float] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Measured:
    """A BRDF on the MERL grid.

    ``table``: (90, 90, 180, 3) float32, 1/sr without the cosine, rgb last, NaN in all channels where nothing was
    measured, or masked there; (90, 90, 360, 3) on the full circle. MeasuredError for anything else.
    ``standin``: True for a material built from published fits; it must never be shown as a measurement.
    ``distance``: of scattered data, GRID_SHAPE float32: degrees to the nearest sample, NaN where the table is.
    ``samples``: of scattered data, (n, 3): theta_h, theta_d, phi_d of the samples in radians.
    Two are equal if name, kind and table are.
    """

    name: str
    table: np.ndarray
    standin: bool = False
    path: Path | None = None
    provenance: Provenance = Provenance()
    distance: np.ndarray | None = None
    samples: np.ndarray | None = None

    def __post_init__(self) -> None:
        shape, dtype = np.shape(self.table), getattr(self.table, "dtype", None)
        if shape not in TABLE_SHAPES:
            raise MeasuredError(f"{self.name}: a table of shape {shape}; {(*GRID_SHAPE, 3)} is needed")
        if dtype not in (np.float32, np.float64):  # compiled code knows no other, nor another order of bytes
            raise MeasuredError(f"{self.name}: a table of {dtype}; float32 or float64 is needed")
        if np.ma.isMaskedArray(self.table):  # whose NaN would be masked, and not seen below
            object.__setattr__(self, "table", self.table.filled(np.nan))
        r, g, b = (np.isnan(self.table[..., channel]) for channel in range(3))
        partly = int(((r != g) | (r != b)).sum())
        if partly:
            raise MeasuredError(f"{self.name}: NaN in some channels of {partly:,} cells; it is in all or in none")
        if np.isinf(self.table).any():
            raise MeasuredError(f"{self.name}: the table holds Inf; NaN is for cells that were not measured")

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Measured):
            return NotImplemented
        same = (self.name, self.kind) == (other.name, other.kind)
        return same and np.array_equal(self.table, other.table, equal_nan=True)

    def __hash__(self) -> int:
        return hash((self.name, self.kind))

    @property
    def kind(self) -> str:
        """One of KINDS; materials of different kinds are never mixed silently in a mean."""
        return STANDIN if self.standin else self.provenance.kind

    @property
    def valid(self) -> np.ndarray:
        """Cells that were measured, bool of shape (90, 90, 180)."""
        return ~np.isnan(self.table[..., 0])

    @cached_property
    def extended(self) -> np.ndarray:
        """The table (90, 90, 180, 3) with a value in every cell (:func:`extend`), made once; do not write to it."""
        return extend(self.table, self.valid)

    def evaluate(self, wi, wo) -> np.ndarray:
        """rgb in 1/sr at unit vectors (..., 3), trilinear, extended beyond the horizon; 0 below the surface, NaN where
        a direction is not finite. ValueError for another shape and for vectors of another length."""
        return look_up(self.extended, *unit_vectors(wi, wo))

    def evaluate_measured(self, wi, wo) -> np.ndarray:
        """As :meth:`evaluate`, (..., 3) in 1/sr, but NaN where the cells around were not measured for the most part and
        the pair is no sample itself: those at the edge have few measured cells around."""
        wi, wo = unit_vectors(wi, wo)
        values = look_up(self.extended, wi, wo)
        known = look_up(self.valid[..., None].astype(np.float32), wi, wo) > 0.5
        return np.where(known | self._sampled(wi, wo)[..., None], values, np.nan)

    def _sampled(self, wi, wo) -> np.ndarray:
        """Whether pairs (..., 3) are samples, of scattered data, or their images under reciprocity and mirror."""
        if self.samples is None:
            return np.zeros(np.broadcast_shapes(np.shape(wi), np.shape(wo))[:-1], bool)
        at = _symmetric(*half_difference(wi, wo))
        far = np.where(np.isfinite(at), at, 9.0)  # a direction that is none is no sample
        return np.less(self._tree.query(far, distance_upper_bound=SAME_PAIR)[0], SAME_PAIR)

    @cached_property
    def _tree(self) -> "cKDTree":
        """Of the samples, made once."""
        from scipy.spatial import cKDTree

        return cKDTree(_symmetric(*np.moveaxis(self.samples, -1, 0)))


def _symmetric(theta_h, theta_d, phi_d) -> np.ndarray:
    """(..., 3): coordinates in which a pair and its images under reciprocity and mirror are one point."""
    return np.stack([theta_h, theta_d, np.sin(theta_h) * np.sin(theta_d) * np.abs(np.cos(phi_d))], -1)


def fold(table: np.ndarray) -> np.ndarray:
    """A table on the MERL grid, (90, 90, 180, ...): the mean of both orders of the directions if it is on the full
    circle, (90, 90, 360, ...), else the table itself."""
    if table.shape[2] == N_PHI_D:
        return table
    return 0.5 * (table[:, :, :N_PHI_D] + table[:, :, N_PHI_D:])


def extension_index(valid: np.ndarray) -> np.ndarray:
    """For each cell, the flat index of the cell whose value stands in for it: itself where valid, else the nearest
    valid cell in phi_d (periodic), else that of the nearest (theta_h, theta_d) that has one.

    One rule for the reference and every fit, always with the reference's mask: no model is judged where nothing was
    measured and none explodes there. Shape of ``valid`` (90, 90, 180 or 360), int32, read-only. ValueError if nothing
    is valid.
    """
    return _extension_index(valid.tobytes(), valid.shape)


@lru_cache(maxsize=4)
def _extension_index(mask: bytes, shape: tuple[int, ...]) -> np.ndarray:
    """All tables of a material have its mask, or that mask twice."""
    valid = np.frombuffer(mask, bool).reshape(shape)
    index = np.arange(valid.size, dtype=np.int32).reshape(valid.shape)
    has_row = valid.any(axis=2)
    if not has_row.any():
        raise ValueError("no valid cell to extend from")
    if not valid.all():
        _nearest_in_phi(valid, index)
    if not has_row.all():
        from scipy.ndimage import distance_transform_edt

        row_h, row_d = distance_transform_edt(~has_row, return_distances=False, return_indices=True)
        index = index[row_h, row_d]
    index.flags.writeable = False
    return index


@njit(cache=True, nogil=True)
def _nearest_in_phi(valid, index):
    n_h, n_d, n_p = valid.shape
    below = np.empty(n_p, np.int64)
    for h in range(n_h):
        for d in range(n_d):
            if not valid[h, d].any():
                continue
            base = (h * n_d + d) * n_p
            last = -n_p
            for p in range(-n_p, n_p):  # a turn before, for what lies below across 0
                if valid[h, d, p % n_p]:
                    last = p
                below[p % n_p] = last
            last = 2 * n_p
            for p in range(2 * n_p - 1, -1, -1):
                if valid[h, d, p % n_p]:
                    last = p
                if p < n_p:
                    index[h, d, p] = base + (below[p] if p - below[p] <= last - p else last) % n_p


def extend(table: np.ndarray, valid: np.ndarray) -> np.ndarray:
    """``table`` with every cell outside the mask ``valid`` filled by the rule of :func:`extension_index`.

    A table on the full circle, (90, 90, 360, ...), may come with a mask of GRID_SHAPE: what was measured in one order
    of the directions was measured in both.
    """
    if table.shape[2] == 2 * valid.shape[2]:
        valid = np.concatenate([valid, valid], 2)
    return np.take(table.reshape(valid.size, -1), extension_index(valid), axis=0).reshape(table.shape)


@njit(cache=True, nogil=True)
def _trilinear(table, theta_h, theta_d, phi_d, period, out):
    n_h, n_d, n_p = table.shape[:3]
    for s in range(theta_h.size):
        if not np.isfinite(theta_h[s] + theta_d[s] + phi_d[s]):
            out[s, :] = np.nan
            continue
        x = min(max(np.sqrt(theta_h[s] / (0.5 * np.pi)) * n_h - 0.5, 0.0), n_h - 1.0)
        y = min(max(theta_d[s] / (0.5 * np.pi) * n_d - 0.5, 0.0), n_d - 1.0)
        z = (phi_d[s] / period * n_p - 0.5) % n_p
        i, j, k = min(int(x), n_h - 2), min(int(y), n_d - 2), int(z) % n_p
        u, v, w = x - i, y - j, z - int(z)
        k1 = (k + 1) % n_p
        for c in range(table.shape[3]):
            low = (1 - v) * ((1 - w) * table[i, j, k, c] + w * table[i, j, k1, c]) + v * (
                (1 - w) * table[i, j + 1, k, c] + w * table[i, j + 1, k1, c]
            )
            high = (1 - v) * ((1 - w) * table[i + 1, j, k, c] + w * table[i + 1, j, k1, c]) + v * (
                (1 - w) * table[i + 1, j + 1, k, c] + w * table[i + 1, j + 1, k1, c]
            )
            out[s, c] = (1 - u) * low + u * high


def look_up(table: np.ndarray, wi, wo) -> np.ndarray:
    """Trilinear look-up between cell centres at directions (..., 3), in a table on the MERL grid, (90, 90, 180, n), or
    on the full circle, (90, 90, 360, n).

    0 where one direction is below the surface, NaN where one is NaN.
    """
    wi, wo = np.broadcast_arrays(np.asarray(wi, float), np.asarray(wo, float))
    full_circle = table.shape[2] > N_PHI_D
    theta_h, theta_d, phi_d = (a.ravel() for a in half_difference(wi, wo, full_circle))
    out = np.empty((theta_h.size, table.shape[-1]))
    _trilinear(table, theta_h, theta_d, phi_d, np.pi * (1 + full_circle), out)
    out[(((wi[..., 2] <= 0) | (wo[..., 2] <= 0)).ravel()) & np.isfinite(theta_h)] = 0.0
    return out.reshape(*wi.shape[:-1], table.shape[-1])
