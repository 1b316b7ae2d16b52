"""Files of the RGL material database (Dupuy and Jakob, "An Adaptive Parameterization for Efficient Material
Acquisition and Rendering", 2018): isotropic ``.bsdf``, rgb or spectral.

A container of named tensors. The value at (wi, wo) is looked up in the material's own parameterization: the halfway
vector goes through the inverse warp of the density of visible normals ``vndf``, and ``rgb`` at that point times
ndf / (4 sigma) is f cos(theta_o). Nothing is resampled but the result, on the cells of the MERL grid.
"""

import os
import struct
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from brdfatlas.angles import GRID_SHAPE, above_horizon, directions, grid_axes, grid_cosines
from brdfatlas.compiled import njit
from brdfatlas.formats.colour import ILLUMINATION, rgb_weights
from brdfatlas.formats.files import MAX_VALUE, name_of, read_bytes, size_of
from brdfatlas.formats.plausibility import suspicions
from brdfatlas.measured import Measured, MeasuredError, Provenance

TITLE = "RGL"
ENDINGS = (".bsdf",)
MAGIC = b"tensor_file\0"
#: Beyond this angle values are extrapolated by the authors' tool and explode when divided by the cosine.
LAST_ANGLE = np.deg2rad(85.0)
TYPES = {1: "u1", 2: "i1", 3: "<u2", 4: "<i2", 5: "<u4", 6: "<i4", 7: "<u8", 8: "<i8", 9: "<f2", 10: "<f4", 11: "<f8"}
#: Bytes in which the list of fields must end, and of the largest field that is read.
DIRECTORY_BYTES, FIELD_BYTES = 1 << 16, 1 << 28


#: Beyond any number of a file: sums of such would overflow.
LARGEST = 1e100


def recognises(head: bytes) -> bool:
    """Whether a file that begins so is a container of tensors."""
    return head.startswith(MAGIC)


@dataclass(frozen=True)
class Tensors:
    """What the evaluator needs of a file, float64: theta_i (n), sigma and ndf (rows, columns), vndf (n, rows,
    columns) with its conditional and marginal distributions, rgb (n, 3, rows, columns), whether ``jacobian``."""

    theta_i: np.ndarray
    sigma: np.ndarray
    ndf: np.ndarray
    vndf: np.ndarray
    conditional: np.ndarray
    marginal: np.ndarray
    rgb: np.ndarray
    jacobian: bool
    description: str
    warnings: tuple[str, ...]


@dataclass(frozen=True)
class _Field:
    dtype: np.dtype
    offset: int
    shape: tuple[int, ...]


def _directory(path: Path) -> dict[str, _Field]:
    """name -> type, place and shape of every field, all of them within the file."""
    size, head = size_of(path), read_bytes(path, DIRECTORY_BYTES)
    if not head.startswith(MAGIC):
        raise MeasuredError(f"{path}: does not begin with {MAGIC[:-1].decode()!r}; it is no .bsdf file of RGL")
    fields: dict[str, _Field] = {}
    try:
        (count,) = struct.unpack_from("<I", head, 14)
        place = 18
        for number in range(count):
            (length,) = struct.unpack_from("<H", head, place)
            name = head[place + 2 : place + 2 + length].decode("ascii", "backslashreplace")
            place += 2 + length
            dimensions, kind, offset = struct.unpack_from("<HBQ", head, place)
            if dimensions > 8 or kind not in TYPES:
                fault = f"{dimensions} dimensions" if dimensions > 8 else f"type {kind}"
                raise MeasuredError(f"{path}: field {number} {name[:40]!r} has {fault}; download the file again")
            shape = struct.unpack_from(f"<{dimensions}Q", head, place + 11)
            place += 11 + 8 * dimensions
            dtype = np.dtype(TYPES[kind])
            bytes_ = dtype.itemsize
            for n in shape:  # Python's integers: a lying header cannot overflow them
                bytes_ *= n
            if offset + bytes_ > size:
                raise MeasuredError(
                    f"{path}: truncated, field {name[:40]!r} ends at byte {offset + bytes_:,} of {size:,}; "
                    "download the file again"
                )
            if name in fields:
                raise MeasuredError(f"{path}: field {name[:40]!r} is there twice; download the file again")
            fields[name] = _Field(dtype, offset, shape)
    except struct.error:
        raise MeasuredError(f"{path}: truncated in its list of fields; download the file again") from None
    return fields


def _tensor(path: Path, fields: dict[str, _Field], name: str, shape: tuple[int | None, ...]) -> np.ndarray:
    """One field as float64; ``shape``: what it must be, None where any length will do."""
    if name not in fields:
        raise MeasuredError(f"{path}: has no field {name!r}; it holds {', '.join(sorted(fields))[:200]}")
    field = fields[name]
    fits = len(field.shape) == len(shape) and all(b in (None, a) for a, b in zip(field.shape, shape))
    if not fits or 0 in field.shape:
        wanted = tuple("n" if n is None else n for n in shape)
        raise MeasuredError(f"{path}: field {name!r} has shape {field.shape}, {wanted} is needed".replace("'n'", "n"))
    if field.dtype.kind != "f" and name != "jacobian":
        raise MeasuredError(f"{path}: field {name!r} holds {field.dtype.name}, floating point numbers are needed")
    count = int(np.prod(field.shape)) * field.dtype.itemsize
    if count > FIELD_BYTES:
        raise MeasuredError(f"{path}: field {name!r} has {count:,} bytes, at most {FIELD_BYTES:,} are read")
    values = np.frombuffer(read_bytes(path, count, field.offset), field.dtype).reshape(field.shape)
    with np.errstate(invalid="ignore"):  # a damaged number may be a signalling NaN
        values = values.astype(float)
    if not np.isfinite(values).all():
        raise MeasuredError(f"{path}: field {name!r} holds {int((~np.isfinite(values)).sum()):,} NaN or Inf")
    return values


def read_tensors(path: str | os.PathLike) -> Tensors:
    """The checked tensors of an isotropic file. MeasuredError (one line: file, field, fault) for anything else."""
    path = Path(path)
    fields = _directory(path)
    phi_i = _tensor(path, fields, "phi_i", (None,))
    if phi_i.size > 1:
        raise MeasuredError(f"{path}: anisotropic, {phi_i.size} values of phi_i; only isotropic materials are read")
    theta_i = _tensor(path, fields, "theta_i", (None,))
    n = theta_i.size
    if n < 2 or (np.diff(theta_i) <= 0).any() or theta_i[0] < 0 or theta_i[-1] > np.pi / 2 + 1e-5:
        raise MeasuredError(f"{path}: field 'theta_i' must rise within 0 to pi/2 radians: {theta_i[:9].tolist()}")
    sigma = _tensor(path, fields, "sigma", (None, None))
    ndf = _tensor(path, fields, "ndf", (None, None))
    vndf = _tensor(path, fields, "vndf", (1, n, None, None))[0]
    rgb, warnings = _colours(path, fields, n)
    for name, values in {"sigma": sigma, "ndf": ndf, "vndf": vndf, "rgb": rgb}.items():
        if min(values.shape[-2:]) < 2:
            raise MeasuredError(f"{path}: field {name!r} has shape {values.shape}, two nodes a side are needed")
        if np.abs(values).max() > LARGEST:
            raise MeasuredError(f"{path}: field {name!r} holds {np.abs(values).max():.3g}; download the file again")
        if name != "rgb" and values.min() < 0:
            raise MeasuredError(f"{path}: field {name!r} has negative values, a density has none")
        if name == "sigma" and values.min() == 0:  # f is divided by it
            raise MeasuredError(f"{path}: field 'sigma' is 0 at some angle, a projected area is not")
    if not sigma.max() > 0 or not ndf.max() > 0 or not rgb.max() > 0:
        raise MeasuredError(f"{path}: black, 'sigma', 'ndf' or the colours are 0 everywhere")
    jacobian = bool(_tensor(path, fields, "jacobian", (1,))[0])
    vndf, conditional, marginal = _distributions(path, vndf)
    return Tensors(theta_i, sigma, ndf, vndf, conditional, marginal, rgb, jacobian, _text(path, fields), warnings)


check = read_tensors


def _colours(path: Path, fields: dict[str, _Field], n: int) -> tuple[np.ndarray, tuple[str, ...]]:
    """rgb (n, 3, rows, columns), of the field itself or from spectra."""
    if "rgb" in fields or "spectra" not in fields:
        return _tensor(path, fields, "rgb", (1, n, 3, None, None))[0], ()
    wavelengths = _tensor(path, fields, "wavelengths", (None,))
    spectra = _tensor(path, fields, "spectra", (1, n, wavelengths.size, None, None))[0]
    try:
        weights = rgb_weights(wavelengths)
    except ValueError as error:
        raise MeasuredError(f"{path}: field 'wavelengths': {error}") from None
    return np.einsum("nwyx,wc->ncyx", spectra, weights), (f"rgb from {wavelengths.size} wavelengths, {ILLUMINATION}",)


def _text(path: Path, fields: dict[str, _Field]) -> str:
    """The description, printable and on one line; "" if there is none."""
    field = fields.get("description")
    if field is None or field.dtype.itemsize != 1 or len(field.shape) != 1:
        return ""
    text = read_bytes(path, min(field.shape[0], 1000), field.offset).decode("utf-8", "replace")
    return "".join(c if c.isprintable() else " " for c in text).strip()


def _distributions(path: Path, vndf: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Each slice of a bilinear density, normalised, with its conditional distribution along columns and its marginal
    over rows, both cumulated by the trapezoid rule in units of a patch: (n, R, C), (n, R, C), (n, R)."""
    conditional, marginal = np.zeros_like(vndf), np.zeros(vndf.shape[:2])
    np.cumsum((vndf[..., 1:] + vndf[..., :-1]) / 2, axis=-1, out=conditional[..., 1:])
    ends = conditional[..., -1]
    np.cumsum((ends[:, 1:] + ends[:, :-1]) / 2, axis=-1, out=marginal[:, 1:])
    total = marginal[:, -1]
    if not (total > 0).all():
        raise MeasuredError(f"{path}: field 'vndf': a slice is 0 everywhere; it cannot be a density")
    return vndf / total[:, None, None], conditional / total[:, None, None], marginal / total[:, None]


@njit(cache=True, nogil=True, inline="always")
def _cell(u, n):
    """Index and weight of the second node of the patch of n nodes on [0, 1] that u lies in."""
    x = min(max(u, 0.0), 1.0) * (n - 1)
    i = min(int(x), n - 2)
    return i, x - i


@njit(cache=True, nogil=True)
def _bilinear(values, column, row):
    y, b = _cell(row, values.shape[0])
    x, a = _cell(column, values.shape[1])
    return (1 - b) * ((1 - a) * values[y, x] + a * values[y, x + 1]) + b * (
        (1 - a) * values[y + 1, x] + a * values[y + 1, x + 1]
    )


@njit(cache=True, nogil=True)
def _warped(vndf, conditional, marginal, k, w, column, row):
    """The inverse warp: where the density, linear between slices k and k + 1, takes a point of the unit square."""
    y, b = _cell(row, vndf.shape[1])
    x, a = _cell(column, vndf.shape[2])
    last = vndf.shape[2] - 1
    c0 = c1 = start = end0 = end1 = below = 0.0
    for s, weight in ((k, 1.0 - w), (k + 1, w)):
        c0 += weight * ((1 - b) * vndf[s, y, x] + b * vndf[s, y + 1, x])
        c1 += weight * ((1 - b) * vndf[s, y, x + 1] + b * vndf[s, y + 1, x + 1])
        start += weight * ((1 - b) * conditional[s, y, x] + b * conditional[s, y + 1, x])
        end0 += weight * conditional[s, y, last]
        end1 += weight * conditional[s, y + 1, last]
        below += weight * marginal[s, y]
    end = (1 - b) * end0 + b * end1
    if end <= 0.0:
        return -1.0, -1.0
    return (start + a * (c0 + 0.5 * a * (c1 - c0))) / end, below + b * (end0 + 0.5 * b * (end1 - end0))


@njit(cache=True, nogil=True)
def _evaluate(wi, wo, theta_i, sigma, ndf, vndf, conditional, marginal, rgb, jacobian, out):
    """f, rgb, of each pair in the order given; NaN where the density is 0 or a direction is not above the surface."""
    for s in range(len(wi)):
        out[s] = np.nan
        cos_o = wo[s, 2]
        if not (wi[s, 2] > 0.0 and cos_o > 0.0):
            continue
        hx, hy, hz = wi[s, 0] + wo[s, 0], wi[s, 1] + wo[s, 1], wi[s, 2] + cos_o
        angle_i = np.arctan2(np.hypot(wi[s, 0], wi[s, 1]), wi[s, 2])
        angle_h = np.arctan2(np.hypot(hx, hy), hz)
        phi = np.arctan2(hy, hx) - np.arctan2(wi[s, 1], wi[s, 0])
        row = (phi + np.pi) / (2 * np.pi)
        row -= np.floor(row)
        column = np.sqrt(2 * angle_h / np.pi)
        k = min(max(np.searchsorted(theta_i, angle_i) - 1, 0), len(theta_i) - 2)
        w = min(max((angle_i - theta_i[k]) / (theta_i[k + 1] - theta_i[k]), 0.0), 1.0)
        v_column, v_row = _warped(vndf, conditional, marginal, k, w, column, row)
        if v_column < 0.0:
            continue
        scale = 1.0 / cos_o
        if jacobian:
            scale *= _bilinear(ndf, column, row) / (4 * _bilinear(sigma, np.sqrt(2 * angle_i / np.pi), 0.5))
        for c in range(3):
            value = (1 - w) * _bilinear(rgb[k, c], v_column, v_row) + w * _bilinear(rgb[k + 1, c], v_column, v_row)
            out[s, c] = value * scale


def evaluate(tensors: Tensors, wi, wo) -> np.ndarray:
    """f in 1/sr, rgb, at unit vectors (..., 3), exactly as the file says for this order of directions: single channels
    may be negative; NaN where the file has no value or a direction is not above the surface."""
    wi, wo = np.broadcast_arrays(np.asarray(wi, float), np.asarray(wo, float))
    out = np.empty((wi[..., 0].size, 3))
    t = tensors
    parts = (t.theta_i, t.sigma, t.ndf, t.vndf, t.conditional, t.marginal, t.rgb, t.jacobian)
    _evaluate(np.ascontiguousarray(wi.reshape(-1, 3)), np.ascontiguousarray(wo.reshape(-1, 3)), *parts, out)
    return out.reshape(wi.shape)


def read(path: str | os.PathLike) -> Measured:
    """An isotropic file on the MERL grid: the mean of both orders at every cell centre whose directions are within
    LAST_ANGLE of the normal and, but for a degree, within the file's theta_i; a cell with all channels negative was not
    measured. Raises MeasuredError (one line: file, field, fault and remedy)."""
    path = Path(path)
    tensors = read_tensors(path)
    first, last = tensors.theta_i[[0, -1]] + np.deg2rad([-1, 1])
    last = min(last, LAST_ANGLE)
    wanted = above_horizon() & (np.minimum(*grid_cosines()) >= np.cos(last))
    wanted &= np.maximum(*grid_cosines()) <= np.cos(max(first, 0))
    axes = np.broadcast_arrays(*grid_axes())
    wi, wo = directions(*(axis[wanted] for axis in axes))
    values = (evaluate(tensors, wi, wo) + evaluate(tensors, wo, wi)) / 2
    there = np.isfinite(values).all(-1) & (values >= 0).any(-1)
    if not there.any():
        raise MeasuredError(f"{path}: no value of 0 or more within {np.rad2deg(last):.0f} degrees of the normal")
    if values[there].max() > MAX_VALUE:
        raise MeasuredError(f"{path}: a value of {values[there].max():.3g} 1/sr; {MAX_VALUE:g} is the most accepted")
    negative = (values[there] < 0).any(-1)
    values[there] = np.maximum(values[there], 0)
    table = np.full((*GRID_SHAPE, 3), np.nan, np.float32)
    table[wanted] = np.where(there[:, None], values, np.nan)
    told = f"directions beyond {np.rad2deg(last):.0f} degrees are left out: values there are extrapolated"
    provenance = Provenance(
        format=TITLE,
        source="RGL material database (Dupuy and Jakob 2018)",
        instrument="pgII gonio-photometer, adaptive parameterization",
        note=tensors.description,
        shares={"out of gamut": float(negative.mean())},
        warnings=(*tensors.warnings, told, *suspicions(table)),
    )
    return Measured(name_of(path), table, path=path, provenance=provenance)
