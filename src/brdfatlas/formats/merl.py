"""MERL ``.binary`` files and their variants (Matusik et al. 2003).

Three little-endian int32 (90, 90, 180), then 3 x 1,458,000 float64, planar R, G, B. Index = phi_d + 180 (theta_d + 90
theta_h). Stored numbers times (1, 1.15, 1.66) / 1500 are 1/sr. A cell is invalid where all channels are negative, by
any number; single negative channels are colours outside the gamut of rgb and become 0. Files of ours use the freedom
of the number: their very last one, below the horizon, tells stand-ins and reconstructions from measurements, so that
they are known under any name and in any folder.
"""

import os
from pathlib import Path

import numpy as np

from brdfatlas.angles import GRID_SHAPE, above_horizon
from brdfatlas.compiled import njit
from brdfatlas.files import atomic_path
from brdfatlas.formats.files import MAX_VALUE, name_of, read_bytes, size_of
from brdfatlas.formats.plausibility import suspicions
from brdfatlas.measured import MEASURED, N_CELLS, RECONSTRUCTED, Measured, MeasuredError, Provenance

TITLE = "MERL"
ENDINGS = (".binary",)
HEADER_BYTES = 12
FILE_BYTES = HEADER_BYTES + 3 * N_CELLS * 8
SCALE = np.array([1.0, 1.15, 1.66]) / 1500.0
STANDIN_MARK, RECONSTRUCTED_MARK = -5.0, -6.0
#: Cells of the largest table of another size that is resampled (2 GB in the file).
MOST_CELLS = 1 << 26


def _shapes(header: bytes) -> dict[str, tuple[int, ...]]:
    """The header's three numbers in both byte orders."""
    return {order: tuple(int(n) for n in np.frombuffer(header, f"{order}i4")) for order in "<>"}


def _usable(shape: tuple[int, ...]) -> bool:
    return min(shape) >= 2 and max(shape) <= 1 << 16 and shape[0] * shape[1] * shape[2] <= MOST_CELLS


def recognises(head: bytes) -> bool:
    """A header of three sizes that could be a table's, in either byte order, from 30 to 1,000 each."""
    return len(head) >= HEADER_BYTES and any(
        min(shape) >= 30 and max(shape) <= 1000 for shape in _shapes(head[:HEADER_BYTES]).values()
    )


def check_header(path: str | os.PathLike) -> None:
    """Check in microseconds that ``path`` is a regular, readable file of the MERL size and dimensions.

    Raises MeasuredError with one line that names the file and what is wrong.
    """
    order, shape = _header(path)
    if (order, shape) != ("<", GRID_SHAPE):
        raise MeasuredError(f"{path}: wrong dimensions {shape}, a MERL file has {GRID_SHAPE}")


def _header(path: str | os.PathLike) -> tuple[str, tuple[int, ...]]:
    """Byte order and shape of a file whose size is that of its header. MeasuredError for anything else."""
    size, header = size_of(path), read_bytes(path, HEADER_BYTES)
    if len(header) < HEADER_BYTES:
        raise MeasuredError(f"{path}: truncated, {size:,} of {FILE_BYTES:,} bytes")
    shapes = _shapes(header)
    order = next((order for order in shapes if _usable(shapes[order])), None)
    if order is None:
        raise MeasuredError(f"{path}: wrong dimensions {shapes['<']}, a MERL file has {GRID_SHAPE}")
    shape = shapes[order]
    expected = HEADER_BYTES + 24 * int(np.prod(shape, dtype=np.int64))
    if size != expected:
        fault = "truncated" if size < expected else "over-long"
        note = "" if shape == GRID_SHAPE else f" (wrong dimensions {shape}? a MERL file has {GRID_SHAPE})"
        raise MeasuredError(f"{path}: {fault}, {size:,} of {expected:,} bytes{note}; copy or download it again")
    return order, shape


@njit(cache=True, nogil=True)
def _decode(red, green, blue, scale, above, table):
    """Scale, interleave and mask the channels (n,) of a file; returns the numbers of non-finite, valid and out-of-gamut
    cells and the largest value."""
    bad, valid, gamut, largest = 0, 0, 0, 0.0
    for i in range(above.size):
        r, g, b = red[i], green[i], blue[i]
        if not (np.isfinite(r) and np.isfinite(g) and np.isfinite(b)):
            bad += 1
        if above[i] and (r >= 0.0 or g >= 0.0 or b >= 0.0):
            valid += 1
            if r < 0.0 or g < 0.0 or b < 0.0:
                gamut += 1
            for c, value in enumerate((r * scale[0], g * scale[1], b * scale[2])):
                table[i, c] = max(value, 0.0)
                largest = max(largest, value)
        else:
            table[i, 0] = table[i, 1] = table[i, 2] = np.nan
    return bad, valid, gamut, largest


def read(path: str | os.PathLike, *, standin: bool = False) -> Measured:
    """Read a MERL ``.binary`` file; the material's name is the file's stem. ``standin``: it is one, marked or not.

    (90, 90, 360) tables are folded by the mean of both orders, other sizes are resampled, with a warning. Raises
    MeasuredError (one line, naming the file) for wrong dimensions, a truncated or over-long file, NaN or Inf, values
    above MAX_VALUE, no valid cell, or what is not a readable regular file.
    """
    table, gamut, mark, warnings = load(path)
    provenance = Provenance(
        format=TITLE,
        kind=RECONSTRUCTED if mark == RECONSTRUCTED_MARK else MEASURED,
        shares={"out of gamut": gamut},
        warnings=(*warnings, *suspicions(table)),
    )
    return Measured(name_of(path), table, standin or mark == STANDIN_MARK, Path(path), provenance)


check = read


def load(path: str | os.PathLike) -> tuple[np.ndarray, float, float, list[str]]:
    """The table of a file, GRID_SHAPE x 3 float32 in 1/sr, the share of its valid cells that are out of gamut, the last
    number in the file, which may be a mark of ours, and warnings on its form. MeasuredError as of :func:`read`."""
    order, shape = _header(path)
    path = Path(path)
    cells = int(np.prod(shape))
    try:  # channels of half the size of the file get memory that is used again
        stored = [np.fromfile(path, f"{order}f8", cells, offset=HEADER_BYTES + 8 * cells * c) for c in range(3)]
    except OSError as error:
        raise MeasuredError(f"{path}: cannot be read ({error.strerror or error})") from None
    if any(channel.size != cells for channel in stored):
        raise MeasuredError(f"{path}: truncated while reading")
    stored = [channel.astype("<f8", copy=False) for channel in stored]
    above = above_horizon() if shape == GRID_SHAPE else _above(shape)
    table = np.empty((cells, 3), np.float32)
    bad, valid, gamut, largest = _decode(*stored, SCALE, above.ravel(), table)
    if bad or largest > MAX_VALUE:
        fault = f"{bad:,} cells hold NaN or Inf" if bad else f"a value of {largest:.3g} 1/sr; {MAX_VALUE:g} is the most"
        raise MeasuredError(f"{path}: {fault}{_other_order(stored)}")
    if valid == 0:
        raise MeasuredError(f"{path}: no valid cell, every sample is negative or below the horizon")
    warnings = [] if order == "<" else ["the header is big-endian; the file is read so"]
    table = table.reshape(*shape, 3)
    if shape != GRID_SHAPE:
        table, told = _on_grid(table)
        warnings.append(told)
    elif _interleaved(stored, valid):
        warnings.append(
            "values look interleaved (r g b of a cell side by side), MERL files hold one channel after another"
        )
    return table, gamut / valid, float(stored[2][-1]), warnings


def _other_order(stored: list[np.ndarray]) -> str:
    """A suspicion, if the numbers make sense with their bytes reversed."""
    swapped = np.concatenate(stored).byteswap()
    with np.errstate(all="ignore"):
        sane = np.isfinite(swapped).all() and (np.abs(swapped) < MAX_VALUE / SCALE[0]).all()
        sane = sane and (np.abs(swapped[swapped != 0]) > 1e-30).all() and swapped.any()
    return "; the numbers look big-endian behind a little-endian header: swap their bytes" if sane else ""


def _interleaved(stored: list[np.ndarray], valid: int) -> bool:
    """Whether the signs fit the horizon if taken as interleaved, and do not as they are."""
    above = above_horizon().ravel()
    if valid > 0.95 * above.sum():
        return False
    return bool(((np.concatenate(stored).reshape(-1, 3) >= 0).any(-1) == above).mean() > 0.99)


def _axes(shape: tuple[int, ...]) -> tuple[list[np.ndarray], bool]:
    """Cell centres of a table of another size, and whether its phi_d goes round the full circle: four cells of phi_d
    to one of theta_d, where MERL has two."""
    full = shape[2] == 4 * shape[1]
    n_h, n_d, n_p = ((np.arange(n) + 0.5) / n for n in shape)
    return [n_h**2 * (np.pi / 2), n_d * (np.pi / 2), n_p * (2 * np.pi if full else np.pi)], full


def _above(shape: tuple[int, ...]) -> np.ndarray:
    """Where both directions of a cell centre are above the surface, bool of ``shape``."""
    (theta_h, theta_d, phi_d), _ = _axes(shape)
    middle = np.cos(theta_h)[:, None, None] * np.cos(theta_d)[:, None]
    swing = np.sin(theta_h)[:, None, None] * np.sin(theta_d)[:, None] * np.cos(phi_d)
    return np.abs(swing) < middle


def _on_grid(table: np.ndarray) -> tuple[np.ndarray, str]:
    """A table of another size on the MERL grid, and the word on it: folded by the mean of both orders where it covers
    the full circle, then resampled, linear between cell centres among valid cells, valid where the nearest cell is."""
    shape = table.shape[:3]
    _, full = _axes(shape)
    told = []
    if full:
        half = shape[2] // 2
        one, other = table[:, :, :half], table[:, :, half:]
        mean = (one + other) / 2
        table = np.where(np.isnan(mean), np.where(np.isnan(one), other, one), mean)
        told.append("folded by the mean of both orders of directions")
    if table.shape[:3] != GRID_SHAPE:
        table = _resampled(table)
        told.append("resampled")
    return np.ascontiguousarray(table, np.float32), f"a table of {shape}, {' and '.join(told)} to {GRID_SHAPE}"


def _resampled(table: np.ndarray) -> np.ndarray:
    places = [(np.arange(n) + 0.5) / n * m - 0.5 for n, m in zip(GRID_SHAPE, table.shape[:3])]
    values, weight = np.nan_to_num(table), (~np.isnan(table[..., :1])).astype(np.float32)
    nearest = np.ones((1, 1, 1, 1), np.float32) * weight
    stack = np.concatenate([values, weight], -1)
    for axis, place in enumerate(places):
        n = table.shape[axis]
        low = np.floor(place).astype(int)
        w = (place - low).astype(np.float32).reshape([-1 if a == axis else 1 for a in range(4)])
        a, b = (low % n, (low + 1) % n) if axis == 2 else (np.clip(low, 0, n - 1), np.clip(low + 1, 0, n - 1))
        stack = stack.take(a, axis) * (1 - w) + stack.take(b, axis) * w
        nearest = nearest.take(np.clip(np.rint(place).astype(int), 0, n - 1), axis)
    with np.errstate(invalid="ignore", divide="ignore"):
        out = stack[..., :3] / stack[..., 3:]
    out[(nearest[..., 0] == 0) | ~above_horizon()] = np.nan
    return out


def write_merl(
    path: str | os.PathLike, table: np.ndarray, *, standin: bool = False, reconstructed: bool = False
) -> None:
    """Write a (90, 90, 180, 3) table in 1/sr as a MERL file; NaN cells, and masked ones, become the format's -1. Whole
    or not at all.

    ``standin`` marks the file as a stand-in, or made from one; ``reconstructed`` as no measurement, a fit for example.
    Raises ValueError for a table of another shape or type, and for Inf, which :func:`read` refuses.
    """
    table = table if np.ma.isMaskedArray(table) else np.asarray(table)
    if table.shape != (*GRID_SHAPE, 3):
        raise ValueError(f"{path}: a MERL table has shape {(*GRID_SHAPE, 3)}, not {table.shape}")
    if table.dtype.kind not in "fiu":
        raise ValueError(f"{path}: a MERL table holds real numbers, not {table.dtype}")
    table = np.ma.filled(table.astype(np.float64, copy=False), np.nan)
    if np.isinf(table).any():
        raise ValueError(f"{path}: the table holds Inf; NaN is for cells without a value")
    stored = np.where(np.isnan(table), -1.0, table / SCALE)
    if standin or reconstructed:
        stored[-1, -1, -1, -1] = STANDIN_MARK if standin else RECONSTRUCTED_MARK
    with atomic_path(path) as temporary, open(temporary, "wb") as handle:
        np.array(GRID_SHAPE, "<i4").tofile(handle)
        np.ascontiguousarray(np.moveaxis(stored, -1, 0), "<f8").tofile(handle)
