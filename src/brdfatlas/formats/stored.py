"""A Measured as this program keeps it, ``.measured``: what took seconds to put on the grid is read in an instant.

A line that says so, a line of JSON (everything but the arrays; their names, types and shapes), then the arrays.
"""

import json
import math
import os
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from brdfatlas.angles import GRID_SHAPE
from brdfatlas.constants import LONGEST_NAME, NAME
from brdfatlas.files import atomic_path
from brdfatlas.formats.files import check_values, read_bytes, size_of
from brdfatlas.measured import KINDS, Measured, MeasuredError, Provenance

TITLE = "stored table"
ENDINGS = (".measured",)
MAGIC = b"brdfatlas measured 1\n"
HEADER_BYTES = 1 << 16
MOST_SAMPLES = 1 << 26


def recognises(head: bytes) -> bool:
    """Whether a file that begins so is one of ours."""
    return head.startswith(MAGIC)


def write(path: str | os.PathLike, measured: Measured) -> None:
    """Write everything that ``measured`` holds, whole or not at all."""
    arrays = {name: getattr(measured, name) for name in ("table", "distance", "samples")}
    arrays = {name: np.ascontiguousarray(a, "<f4") for name, a in arrays.items() if a is not None}
    header = {
        "name": measured.name,
        "standin": measured.standin,
        "path": None if measured.path is None else os.fspath(measured.path),
        "provenance": asdict(measured.provenance),
        "shapes": {name: a.shape for name, a in arrays.items()},
    }
    with atomic_path(path) as temporary, open(temporary, "wb") as handle:
        handle.write(MAGIC + json.dumps(header).encode() + b"\n")
        for array in arrays.values():
            array.tofile(handle)


def _fit(shapes: dict[str, tuple[int, ...]]) -> bool:
    """Whether the arrays are those of a Measured."""
    allowed = {"table": (*GRID_SHAPE, 3), "distance": GRID_SHAPE}
    samples = shapes.get("samples", (0, 3))
    known = {"table"} <= shapes.keys() <= {"table", "distance", "samples"}
    fixed = all(shapes[key] == shape for key, shape in allowed.items() if key in shapes)
    return known and fixed and len(samples) == 2 and samples[1] == 3 and 0 <= samples[0] <= MOST_SAMPLES


def _about(header: dict[str, Any]) -> Provenance:
    """The provenance of a header. TypeError, or what Python raises, where a part is not of the type that it has."""
    provenance, shapes = header["provenance"], header["shapes"]
    if not isinstance(provenance["warnings"], list):
        raise TypeError("warnings")
    about = Provenance(**provenance | {"warnings": tuple(provenance["warnings"])})
    texts = (header["name"], header["path"] or "", about.format, about.source, about.instrument, about.note)
    typed = [isinstance(text, str) for text in (*texts, *about.warnings)]
    typed += [isinstance(share, int | float) and 0 <= share <= 1 for share in about.shares.values()]
    typed += [type(n) is int for shape in shapes.values() for n in shape]
    if not (all(typed) and isinstance(header["standin"], bool) and about.kind in KINDS):
        raise TypeError("header")
    return about


def read(path: str | os.PathLike) -> Measured:
    """What :func:`write` wrote. MeasuredError, one line, for anything else."""
    try:
        line = read_bytes(path, HEADER_BYTES)[len(MAGIC) :].split(b"\n", 1)[0]
        header = json.loads(line)
        about = _about(header)
        shapes = {name: tuple(shape) for name, shape in header["shapes"].items()}
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
        raise MeasuredError(f"{path}: its header cannot be read; convert the measurement again") from None
    name, source = header["name"], header["path"]
    if not NAME.match(name) or len(name) > LONGEST_NAME:
        raise MeasuredError(
            f"{path}: holds a material called {name[:80]!r}; a name has letters, digits, '.', '_' and '-', "
            f"{LONGEST_NAME} at most; rename the measurement and convert it again"
        )
    start = len(MAGIC) + len(line) + 1
    counts = {key: math.prod(shape) for key, shape in shapes.items()}
    if not (_fit(shapes) and size_of(path) == start + 4 * sum(counts.values())):
        raise MeasuredError(f"{path}: truncated or changed; convert the measurement again")
    numbers = np.frombuffer(read_bytes(path, 4 * sum(counts.values()), start), "<f4")
    arrays, place = {}, 0
    for key, shape in shapes.items():
        arrays[key] = numbers[place : place + counts[key]].reshape(shape).copy()
        place += counts[key]
    table = arrays.pop("table")
    valid = ~np.logical_and.reduce([np.isnan(table[..., channel]) for channel in range(3)])
    values = table[valid]
    check_values(path, values)
    if not valid.any():
        raise MeasuredError(f"{path}: no valid cell; convert the measurement again")
    if values.min() < 0:
        raise MeasuredError(f"{path}: negative values, which are no reflectance; convert the measurement again")
    return Measured(name, table, header["standin"], Path(source) if source else None, about, **arrays)


check = read
