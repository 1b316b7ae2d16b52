"""A measured isotropic BRDF on the MERL grid: reading, checking, writing, looking up.

File format (Matusik et al. 2003): three little-endian int32 (90, 90, 180), then 3 x 1,458,000 float64, planar R, G,
B. Index = phi_d + 180 (theta_d + 90 theta_h). Stored numbers times (1, 1.15, 1.66) / 1500 are 1/sr; invalid cells
are negative, by any number. Stand-ins use that: their very last number, below the horizon, is STANDIN_MARK, so that a
file is known as a stand-in under any name and in any folder.
"""

import os
import stat
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from brdfatlas.angles import GRID_SHAPE, above_horizon, half_difference
from brdfatlas.compiled import compiled
from brdfatlas.files import atomic_path

N_CELLS = int(np.prod(GRID_SHAPE))
HEADER_BYTES = 12
FILE_BYTES = HEADER_BYTES + 3 * N_CELLS * 8
SCALE = np.array([1.0, 1.15, 1.66]) / 1500.0
STANDIN_MARK = -5.0


class MeasuredError(ValueError):
    """A file that cannot be used as a measured BRDF; the message is one line that names the file and the fault."""


@dataclass(frozen=True)
class Measured:
    """A BRDF on the MERL grid.

    ``table``: (90, 90, 180, 3) float32, 1/sr without the cosine, rgb last, NaN where nothing was measured.
    ``standin``: True for a material built from published fits; it must never be shown as a measurement.
    """

    name: str
    table: np.ndarray
    standin: bool = False
    path: Path | None = field(default=None, compare=False)

    @property
    def valid(self) -> np.ndarray:
        """Cells that were measured, bool of GRID_SHAPE."""
        return ~np.isnan(self.table[..., 0])

    def evaluate(self, wi, wo) -> np.ndarray:
        """rgb in 1/sr at directions (..., 3), trilinear, extended beyond the horizon; 0 below the surface."""
        return look_up(extend(self.table, self.valid), wi, wo)


@compiled
def _decode(stored, scale, above, table):
    """Scale, interleave and mask the planar file; returns the numbers of non-finite and of valid cells."""
    n = above.size
    bad, valid = 0, 0
    for i in range(n):
        r, g, b = stored[i], stored[n + i], stored[2 * n + i]
        if not (np.isfinite(r) and np.isfinite(g) and np.isfinite(b)):
            bad += 1
        if above[i] and r >= 0.0 and g >= 0.0 and b >= 0.0:
            valid += 1
            table[i, 0], table[i, 1], table[i, 2] = r * scale[0], g * scale[1], b * scale[2]
        else:
            table[i, 0] = table[i, 1] = table[i, 2] = np.nan
    return bad, valid


def check_header(path: str | os.PathLike) -> None:
    """Check in microseconds that ``path`` is a regular, readable file of the MERL size and dimensions.

    Raises MeasuredError with one line that names the file and what is wrong.
    """
    path = Path(path)
    try:
        status = path.stat()
        if not stat.S_ISREG(status.st_mode):
            raise MeasuredError(f"{path}: not a regular file")
        with open(path, "rb") as handle:
            header = handle.read(HEADER_BYTES)
    except FileNotFoundError:
        raise MeasuredError(f"{path}: no such file") from None
    except OSError as error:
        raise MeasuredError(f"{path}: cannot be read ({error.strerror or error})") from None
    if len(header) < HEADER_BYTES:
        raise MeasuredError(f"{path}: truncated, {status.st_size:,} of {FILE_BYTES:,} bytes")
    shape = tuple(int(n) for n in np.frombuffer(header, "<i4"))
    if shape != GRID_SHAPE:
        raise MeasuredError(f"{path}: wrong dimensions {shape}, a MERL file has {GRID_SHAPE}")
    if status.st_size != FILE_BYTES:
        fault = "truncated" if status.st_size < FILE_BYTES else "over-long"
        raise MeasuredError(f"{path}: {fault}, {status.st_size:,} of {FILE_BYTES:,} bytes")


def read_merl(path: str | os.PathLike, *, standin: bool = False) -> Measured:
    """Read a MERL ``.binary`` file; the material's name is the file's stem. ``standin``: it is one, marked or not.

    Raises MeasuredError (one line, naming the file) for wrong dimensions, a truncated or over-long file, NaN or
    Inf, no valid cell, or what is not a readable regular file.
    """
    path = Path(path)
    check_header(path)
    try:
        stored = np.fromfile(path, "<f8", offset=HEADER_BYTES)
    except OSError as error:
        raise MeasuredError(f"{path}: cannot be read ({error.strerror or error})") from None
    if stored.size != 3 * N_CELLS:
        raise MeasuredError(f"{path}: truncated while reading")
    table = np.empty((N_CELLS, 3), np.float32)
    bad, valid = _decode(stored, SCALE, above_horizon().ravel(), table)
    if bad:
        raise MeasuredError(f"{path}: {bad:,} cells hold NaN or Inf")
    if valid == 0:
        raise MeasuredError(f"{path}: no valid cell, every sample is negative or below the horizon")
    standin = standin or bool(stored[-1] == STANDIN_MARK)
    return Measured(path.stem, table.reshape(*GRID_SHAPE, 3), standin, path)


def write_merl(path: str | os.PathLike, table: np.ndarray, *, standin: bool = False) -> None:
    """Write a (90, 90, 180, 3) table in 1/sr as a MERL file; NaN cells become the format's -1. Whole or not at all.

    ``standin`` marks the file as a stand-in, or made from one.
    """
    table = np.asarray(table)
    if table.shape != (*GRID_SHAPE, 3):
        raise ValueError(f"{path}: a MERL table has shape {(*GRID_SHAPE, 3)}, not {table.shape}")
    stored = np.where(np.isnan(table), -1.0, table / SCALE)
    if standin:
        stored[-1, -1, -1, -1] = STANDIN_MARK
    with atomic_path(path) as temporary, open(temporary, "wb") as handle:
        np.array(GRID_SHAPE, "<i4").tofile(handle)
        np.ascontiguousarray(np.moveaxis(stored, -1, 0), "<f8").tofile(handle)


def extension_index(valid: np.ndarray) -> np.ndarray:
    """For each cell, the flat index of the cell whose value stands in for it: itself where valid, else the nearest
    valid cell in phi_d (periodic by reciprocity), else that of the nearest (theta_h, theta_d) that has one.

    One rule for the reference and every fit, always with the reference's mask: no model is judged where nothing was
    measured and none explodes there. Shape GRID_SHAPE, int32. ValueError if nothing is valid.
    """
    index = np.arange(N_CELLS, dtype=np.int32).reshape(GRID_SHAPE).copy()
    if valid.all():
        return index
    has_row = valid.any(axis=2)
    if not has_row.any():
        raise ValueError("no valid cell to extend from")
    _nearest_in_phi(np.ascontiguousarray(valid), index)
    if not has_row.all():
        from scipy.ndimage import distance_transform_edt

        row_h, row_d = distance_transform_edt(~has_row, return_distances=False, return_indices=True)
        index = index[row_h, row_d]
    return index


@compiled
def _nearest_in_phi(valid, index):
    n_h, n_d, n_p = valid.shape
    for h in range(n_h):
        for d in range(n_d):
            base = (h * n_d + d) * n_p
            for p in range(n_p):
                for step in range(n_p // 2 + 1):
                    left, right = (p - step) % n_p, (p + step) % n_p
                    if valid[h, d, left]:
                        index[h, d, p] = base + left
                        break
                    if valid[h, d, right]:
                        index[h, d, p] = base + right
                        break


def extend(table: np.ndarray, valid: np.ndarray) -> np.ndarray:
    """``table`` with every cell outside the mask ``valid`` filled by the rule of :func:`extension_index`."""
    return table.reshape(N_CELLS, -1)[extension_index(valid)].reshape(table.shape)


@compiled
def _trilinear(table, theta_h, theta_d, phi_d, out):
    n_h, n_d, n_p = table.shape[:3]
    for s in range(theta_h.size):
        x = min(max(np.sqrt(theta_h[s] / (0.5 * np.pi)) * n_h - 0.5, 0.0), n_h - 1.0)
        y = min(max(theta_d[s] / (0.5 * np.pi) * n_d - 0.5, 0.0), n_d - 1.0)
        z = (phi_d[s] / np.pi * n_p - 0.5) % n_p
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
    """Trilinear look-up between cell centres at directions (..., 3); 0 where one direction is below the surface."""
    wi, wo = np.broadcast_arrays(np.asarray(wi, float), np.asarray(wo, float))
    theta_h, theta_d, phi_d = (a.ravel() for a in half_difference(wi, wo))
    out = np.empty((theta_h.size, table.shape[-1]))
    _trilinear(table, theta_h, theta_d, phi_d, out)
    out[((wi[..., 2] <= 0) | (wo[..., 2] <= 0)).ravel()] = 0.0
    return out.reshape(*wi.shape[:-1], table.shape[-1])
