"""What every reader does first: a regular file, of a bearable size, read without surprises."""

import os
import re
import stat
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from brdfatlas.files import check_path, digits
from brdfatlas.measured import MeasuredError

#: Larger values, in 1/sr, are no reflectance: a mirror within one MERL cell has about 1e6.
MAX_VALUE = 1e9


def size_of(path: str | os.PathLike) -> int:
    """Bytes of a regular file. MeasuredError for what is absent, unreadable or no regular file (a FIFO would hang),
    TypeError for what is no path."""
    check_path(path)
    try:
        status = os.stat(path)
    except FileNotFoundError:
        raise MeasuredError(f"{path}: no such file") from None
    except (OSError, ValueError) as error:
        raise MeasuredError(f"{path}: cannot be read ({getattr(error, 'strerror', None) or error})") from None
    if not stat.S_ISREG(status.st_mode):
        raise MeasuredError(f"{path}: not a regular file")
    return status.st_size


def read_bytes(path: str | os.PathLike, count: int, offset: int = 0) -> bytes:
    """Up to ``count`` bytes of a regular file from ``offset``. MeasuredError as of :func:`size_of`."""
    size = size_of(path)
    try:
        with open(path, "rb") as handle:
            handle.seek(offset)
            return handle.read(min(count, max(size - offset, 0)))
    except OSError as error:
        raise MeasuredError(f"{path}: cannot be read ({error.strerror or error})") from None


def read_text(path: str | os.PathLike, limit: int) -> str:
    """A text file of at most ``limit`` bytes: UTF-8, a byte order mark and any line ends allowed."""
    size = size_of(path)
    if size > limit:
        raise MeasuredError(f"{path}: {size:,} bytes, at most {limit:,} are read; use fewer directions")
    data = read_bytes(path, limit)
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        raise MeasuredError(f"{path}: UTF-16 text; save it as UTF-8 text")
    if b"\0" in data:
        raise MeasuredError(f"{path}: byte {data.index(0)}: a NUL in a text file; it is damaged or no text")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise MeasuredError(f"{path}: byte {error.start}: not UTF-8; save it as UTF-8 text") from None


def numbers(path: str | os.PathLike, words: Sequence[str], lines: Sequence[int]) -> np.ndarray:
    """``words`` as float64, (n,). MeasuredError, naming its line of ``lines``, for the first that is no number."""
    try:
        digits("".join(words))  # a look at all costs less than one at each
        return np.array(words, float)
    except ValueError:
        for word, line in zip(words, lines, strict=True):
            try:
                float(digits(word))
            except ValueError:
                remedy = "write decimals with a point" if re.fullmatch(r"\s*-?\d+,\d+\s*", word) else "correct it"
                raise MeasuredError(f"{path}: line {line}: {word.strip()[:30]!r} is not a number; {remedy}") from None
        raise


def name_of(path: str | os.PathLike) -> str:
    """The material's name: the stem of the file without RGL's ``_rgb``."""
    return Path(path).stem.removesuffix("_rgb")


def check_values(path: str | os.PathLike, values: np.ndarray, what: str = "value") -> None:
    """MeasuredError if a decoded value is not finite or larger than MAX_VALUE; ``values``: 1/sr."""
    if not np.isfinite(values).all():
        raise MeasuredError(f"{path}: {int((~np.isfinite(values)).sum()):,} {what}s are NaN or Inf")
    if values.size and np.abs(values).max() > MAX_VALUE:
        raise MeasuredError(f"{path}: a {what} of {np.abs(values).max():.3g} 1/sr; {MAX_VALUE:g} is the most accepted")
