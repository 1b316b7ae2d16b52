"""Spectral text of scattered pairs, as Cornell's gonioreflectometer data came with pbrt-v2 (``.brdf``).

The number of wavelengths, the wavelengths in nm, then a row of theta_i phi_i theta_o phi_o (radians) and one value a
wavelength (1/sr) for each pair of directions; ``#`` starts a comment.
"""

import os
import re
from pathlib import Path

import numpy as np

from brdfatlas.formats.colour import ILLUMINATION, check_wavelengths, rgb_weights
from brdfatlas.formats.files import check_values, numbers, read_text
from brdfatlas.formats.scattered import Samples, checked, on_sphere, to_measured
from brdfatlas.measured import Measured, MeasuredError

TITLE = "spectral text (Cornell, pbrt)"
ENDINGS = (".brdf",)
MOST_BYTES = 1 << 27
MOST_WAVELENGTHS = 2000


def recognises(head: bytes) -> bool:
    """Text whose first words are a whole number and then rising numbers, comments aside."""
    if b"\0" in head:
        return False
    words = _words_of(head.decode("latin-1").lstrip("\ufeff\xef\xbb\xbf"))[:4]
    try:
        first, second, third = int(words[0]), float(words[1]), float(words[2])
    except (ValueError, IndexError):
        return False
    return 0 < first <= MOST_WAVELENGTHS and 100 < second < third


def _words_of(text: str) -> list[str]:
    return re.sub(r"#[^\n\r]*", " ", text).split()


def _parse(path: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray, str]:
    """Wavelengths (w), rows (n, 4 + w), the line at which each begins (n), and the file's comments in one line."""
    lines = read_text(path, MOST_BYTES).splitlines()
    words, places = [], []
    for number, line in enumerate(lines, 1):
        found = line.split("#", 1)[0].split()
        words += found
        places += [number] * len(found)
    values = numbers(path, words, places)
    count = int(values[0]) if len(values) and 0 < values[0] <= MOST_WAVELENGTHS else 0
    if not count or count != values[0]:
        found = words[0][:30] if words else "nothing"
        raise MeasuredError(f"{path}: begins with {found!r}, the number of wavelengths is wanted there")
    if not np.isfinite(values).all():
        at = int(np.flatnonzero(~np.isfinite(values))[0])
        raise MeasuredError(f"{path}: line {places[at]}: {words[at]} is no value; remove the row or correct it")
    wavelengths, rest = values[1 : 1 + count], values[1 + count :]
    try:
        check_wavelengths(wavelengths)
    except ValueError as error:
        raise MeasuredError(f"{path}: {error}") from None
    width = 4 + count
    if rest.size % width or not rest.size:
        raise MeasuredError(
            f"{path}: {rest.size:,} numbers after the {count} wavelengths are no rows of {width} (four angles, "
            f"{count} values): truncated at line {places[-1]}, or the number of wavelengths is wrong"
        )
    comments = [line.lstrip("# \t") for line in lines if line.startswith("#")]
    told = [c for c in comments if c and not re.match(r"(num wls|wls|theta)", c)]
    note = "; ".join("".join(ch if ch.isprintable() else " " for ch in c).strip() for c in told[:5])[:500]
    return wavelengths, rest.reshape(-1, width), np.array(places[1 + count :: width]), note


def _load(path: str | os.PathLike, colour: bool) -> tuple[Samples, tuple[str, ...], str]:
    """The samples with rgb values; without ``colour`` their mean over the wavelengths, which needs no library."""
    path = Path(path)
    wavelengths, rows, places, note = _parse(path)
    wi, wo, keep, warnings = on_sphere(path, rows[:, :4], places, "radians")
    spectra = rows[keep, 4:]
    check_values(path, spectra)
    if colour:
        values = spectra @ rgb_weights(wavelengths)
        warnings = (*warnings, f"rgb from {wavelengths.size} wavelengths, {ILLUMINATION}")
    else:
        values = np.repeat(spectra.mean(1, keepdims=True), 3, 1)
    return Samples(wi, wo, values, places[keep]), warnings, note


def load_samples(path: str | os.PathLike) -> Samples:
    """The pairs of directions, with the mean over the wavelengths as values. MeasuredError, one line."""
    return _load(path, colour=False)[0]


def check(path: str | os.PathLike) -> None:
    """MeasuredError (one line: file, line, fault and remedy) if :func:`read` would refuse the file."""
    samples, _, _ = _load(path, colour=False)
    checked(path, samples)


def read(path: str | os.PathLike) -> Measured:
    """The file on the MERL grid, interpolated between its samples. Raises MeasuredError, one line."""
    samples, warnings, note = _load(path, colour=True)
    return to_measured(path, samples, format=TITLE, note=note, warnings=warnings)
