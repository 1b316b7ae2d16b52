"""Tables of the reference and of fits for the interactive viewer, small enough for a report.

``tables/{model}.js`` calls ``ATLAS_TABLE("material/model", cells, count, text)`` (figures.scripts). ``cells``: how many
of theta_h, theta_d and phi_d. The bytes are zlib of int16 little-endian, theta_h fastest, then theta_d, phi_d, channel;
each row of theta_h as differences, and green and blue as differences to red, of

    q = round(STEPS log2(max(value, FLOOR) / FLOOR)),    value in 1/sr = FLOOR 2^(q / STEPS),

so that a value is right within 0.6 %. The grid is MERL's with cells of theta_d (:data:`THETA_D` left) and phi_d merged
to their means, extended over the horizon as for rendering. phi_d runs over 0 to pi/2, or 0 to pi for a model that is
not reciprocal: the rest of the circle is its mirror image.
"""

import os
import zlib
from pathlib import Path

import numpy as np

from brdfatlas.angles import N_PHI_D, N_THETA_D, N_THETA_H
from brdfatlas.figures.scripts import write_script
from brdfatlas.models.base import Factors

STEPS, FLOOR = 64, 1e-5
#: Cells of theta_d and, on a quarter of the circle, phi_d.
THETA_D, PHI_D = 30, 15
#: A fit of more products than this is shown by its table.
MOST_PRODUCTS = 16


def has_few_products(factors: Factors | None) -> bool:
    """Whether a fit is shown by its factors, which are exact, and needs no table."""
    return factors is not None and factors.d.shape[1] <= MOST_PRODUCTS


def table_file(folder: str | os.PathLike, model: str) -> Path:
    """The script with the table of a model; ``folder``: the material's."""
    return Path(folder) / "tables" / f"{model}.js"


def small_table(full: np.ndarray) -> np.ndarray:
    """A table (90, 90, 180 or 360, 3) in 1/sr without NaN on the viewer's grid, (90, THETA_D, PHI_D or 2 PHI_D, 3)
    float32."""
    half = PHI_D * full.shape[2] // N_PHI_D
    rows = _mean(full.reshape(N_THETA_H, THETA_D, N_THETA_D // THETA_D, -1))
    cells = _mean(rows.reshape(N_THETA_H, 2 * half * THETA_D, -1, 3)).reshape(N_THETA_H, THETA_D, 2 * half, 3)
    return (cells[:, :, :half] + cells[:, :, : half - 1 : -1]) / 2


def _mean(values: np.ndarray) -> np.ndarray:
    """Over the third axis, float32; of whole slices, for NumPy's own walks along the axis, in twice the time."""
    return sum(values[:, :, k] for k in range(values.shape[2])) / np.float32(values.shape[2])


def encode_table(values: np.ndarray) -> bytes:
    """What :func:`small_table` gives, compressed."""
    steps = np.rint(STEPS * np.log2(np.maximum(values, FLOOR) / FLOOR)).astype(np.int16).transpose(3, 2, 1, 0)
    steps = np.diff(np.stack([steps[0], steps[1] - steps[0], steps[2] - steps[0]]), axis=-1, prepend=np.int16(0))
    # Level 9 takes six times as long for 5 % less.
    return zlib.compress(np.ascontiguousarray(steps, "<i2").tobytes(), 7)


def decode_table(content: bytes, cells: tuple[int, int, int]) -> np.ndarray:
    """The inverse of :func:`encode_table`, (theta_h, theta_d, phi_d, 3): what the page's script does."""
    steps = np.frombuffer(zlib.decompress(content), "<i2").reshape(3, *cells[::-1])
    steps = np.cumsum(steps, -1)
    return (FLOOR * 2.0 ** (np.stack([steps[0], steps[0] + steps[1], steps[0] + steps[2]]) / STEPS)).transpose(
        3, 2, 1, 0
    )


def write_table(path: str | os.PathLike, name: str, table: np.ndarray) -> None:
    """Write a table (90, 90, 180 or 360, 3) in 1/sr without NaN for the viewer; ``name``: material/model."""
    values = small_table(table)
    write_script(path, "ATLAS_TABLE", [name, list(values.shape[:3])], encode_table(values))
