"""Files of measured reflectance, one module a format, found by content and not by name.

Each module has TITLE, ENDINGS (of the names that its files usually have), ``recognises(head)``, ``check(path)``
(everything that can be wrong with the file, without putting it on the grid) and ``read(path)``. All faults are
MeasuredError: one line with file, place and remedy.
"""

import os
from dataclasses import replace
from types import ModuleType

from brdfatlas.files import HEAD_BYTES, ours, stamps
from brdfatlas.formats import merl, rgl, spectral, stored, tables
from brdfatlas.formats.files import read_bytes, size_of
from brdfatlas.measured import Measured, MeasuredError

FORMATS = (stored, rgl, merl, tables, spectral)
KNOWN = "MERL .binary, RGL isotropic .bsdf, Cornell spectral text and CSV tables"
#: How files begin in which measurements may be packed; they are not opened here.
PACKED = {
    b"PK": "packed by zip (or a fit, .npz, which is no measurement); unpack it first",
    b"\x1f\x8b": "packed by gzip; unpack it first (gunzip)",
    b"\xfd7zXZ": "packed by xz; unpack it first (unxz)",
    b"BZh": "packed by bzip2; unpack it first (bunzip2)",
}
#: Kinds of files of ours that are taken for measurements.
EXPORTED = ("JSON", "XML", "MaterialX", "glTF", "picture")
ENDINGS = frozenset(ending for module in FORMATS for ending in module.ENDINGS)


def format_of(path: str | os.PathLike) -> ModuleType | None:
    """The module that reads the file, told by how it begins; None for anything else. MeasuredError if it cannot be
    read at all."""
    head = read_bytes(path, HEAD_BYTES)
    return next((module for module in FORMATS if module.recognises(head)), None)


def read(path: str | os.PathLike, *, standin: bool = False) -> Measured:
    """Any file of measured reflectance, on the MERL grid. ``standin``: it is one, marked or not.

    Raises MeasuredError: one line with file, place and remedy; TypeError for what is no path.
    """
    module, before = _module(path), stamps([path])
    measured = module.read(path)
    if stamps([path]) != before:  # parts of two files
        raise MeasuredError(f"{path}: has changed while it was read; see that it is whole and read it again")
    return replace(measured, standin=True) if standin else measured


def check(path: str | os.PathLike) -> None:
    """MeasuredError if :func:`read` would refuse the file; the work of putting it on the grid is spared."""
    _module(path).check(path)


def _module(path: str | os.PathLike) -> ModuleType:
    """The format's module; for a file of no known format, that whose names end so, which says what is wrong."""
    module = format_of(path)
    if module is None and not read_bytes(path, 16).startswith(tuple(PACKED)):
        ending = os.path.splitext(os.fspath(path))[1].lower()
        module = next((m for m in FORMATS if ending in m.ENDINGS), None)
    if module is None:
        kind = next((kind for kind in EXPORTED if size_of(path) and ours(path, kind)), None)
        what = f"{kind} that brdfatlas wrote, no measurement" if kind else _looks(read_bytes(path, 16))
        raise MeasuredError(f"{path}: {what}; {KNOWN} are read")
    return module


def _looks(head: bytes) -> str:
    """What a file that is none of ours begins like."""
    for magic, told in PACKED.items():
        if head.startswith(magic):
            return told
    return "empty" if not head else "no file of measured reflectance"
