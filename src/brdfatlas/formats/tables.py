"""Tables of one's own, ``.csv``: a row a pair of directions.

Columns theta_i, phi_i, theta_o, phi_o in degrees, or wi_x, wi_y, wi_z, wo_x, wo_y, wo_z; then r, g, b or one value.
Separated by commas, semicolons, tabs or spaces. Lines that begin with ``#`` say what the values are and where they
come from: ``# values: f`` (1/sr), ``# values: f cos`` (times cos theta_o) or ``# values: reflectance factor`` (pi f);
``# angles: radians``; ``# source:``, ``# instrument:``, ``# note:`` as they are.
What is said of the values in other words is refused: to take them for something else would be off by a cosine or by pi.
"""

import os
import re
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from brdfatlas.files import HEAD_BYTES, atomic_path, shown
from brdfatlas.formats import spectral
from brdfatlas.formats.files import check_values, numbers, read_bytes, read_text
from brdfatlas.formats.scattered import Samples, checked, on_sphere, to_measured
from brdfatlas.measured import KINDS, MEASURED, Measured, MeasuredError

TITLE = "table (CSV)"
ENDINGS = (".csv", ".tsv")
MOST_BYTES = 1 << 28
ANGLES = ("theta_i", "phi_i", "theta_o", "phi_o")
VECTORS = ("wi_x", "wi_y", "wi_z", "wo_x", "wo_y", "wo_z")
COLOURS = ("r", "g", "b")
#: What values may be: f, f cos(theta_o), pi f.
QUANTITIES = F, F_COS, FACTOR = "f", "f cos", "reflectance factor"
#: Other names of columns, letters only.
ALIASES = {
    **{name.replace("_", ""): name for name in (*ANGLES, *VECTORS)},
    **{f"{angle}{letter}": f"{angle}_o" for angle in ("theta", "phi") for letter in "rsv"},
    **{prefix + letter: letter for prefix in ("", "f", "rho") for letter in COLOURS},
    **dict(zip(("red", "green", "blue"), COLOURS)),
}
#: Columns of one value that do not say which.
UNSAID = ("value", "luminance")
_F = "(f|fr|fs|brdf)"
#: Words of QUANTITIES, as :func:`_plain` leaves them.
_WORDS = {F: _F, F_COS: f"{_F}(times)?cos(ine)?(of)?(theta[orsv]?)?", FACTOR: f"(reflectancefactor|rf|brf|(pi|π){_F})"}
#: A comment that may speak of quantities, and the unit that f and f cos have.
_SPEAKS = re.compile(
    r"^values? (are|is) |(?<![a-z])f?cos(ine)?s?(?![a-z])|cos_?(theta|θ)|(reflectance|radiance) factor"
)
_ANGLE = re.compile(r"\b(deg|rad)(rees?|ians?)?\b")
_OTHER_ANGLE = re.compile(r"\b(grad(e|ian)?s?|gons?|m(illi)?rad(ian)?s?|turns?|revolutions?|arc ?(min|sec)\w*)\b")
_UNIT = re.compile(r"(\bin\s+)?[\[(]?(1\s*/\s*sr|sr\s*(\^|\*\*)?\s*[{(]?-\s*1[})]?|sr⁻¹)[\])]?$")


@dataclass
class _Header:
    """What a table says of itself, and where its rows begin."""

    said: dict[str, str] = field(default_factory=dict)
    columns: list[str] = field(default_factory=list)
    separator: str | None = ","
    quantity: str = ""
    stated: str = ""
    unclear: str = ""
    angles: str = ""
    line: int = 0


def recognises(head: bytes) -> bool:
    """Text whose first line that is no comment names the directions' columns."""
    if b"\0" in head:
        return False
    for line in map(_bare, head.decode("utf-8-sig", "replace").splitlines()):
        if line and not line.startswith("#"):
            names = {ALIASES.get(_letters(name)) for name in re.split(r"[,;\t ]+", line)}
            return len(names & {*ANGLES, *VECTORS}) >= 2
    return False


def _bare(line: str) -> str:
    """A line without what spreadsheets put around a comment, quotes and empty cells; a row of empty cells is empty."""
    bare = line.strip().strip(" \t,;")
    return bare.strip('"').replace('""', '"') if bare.startswith(("#", '"#')) else bare


def _letters(name: str) -> str:
    name = re.sub(r"[\[(].*?[\])]", "", name.strip().strip('"').lower())
    return re.sub(r"[^a-z]", "", re.sub(r"_?(deg|rad|degrees|radians)$", "", name.strip()))


def _plain(text: str) -> str:
    """``text`` in small letters without 1/sr at its end, spaces and signs of multiplication; all else stays."""
    text = _UNIT.sub("", text.strip().strip('"').lower()).replace("θ", "theta")
    return re.sub(r"[\s_*·⋅×(){}\\$]", "", text)


def _column(name: str) -> str:
    """A direction's column whatever stands in brackets behind its name; any other by its whole name."""
    direction = ALIASES.get(_letters(name), "")
    return direction if direction in (*ANGLES, *VECTORS) else ALIASES.get(_plain(name), _plain(name))


def quantity_of(text: str) -> str | None:
    """Which of QUANTITIES a person's words mean; None if that is not certain."""
    return next((quantity for quantity, words in _WORDS.items() if re.fullmatch(words, _plain(text))), None)


def _header(path: Path, lines: list[str]) -> _Header:
    header = _Header()
    for number, line in enumerate(lines, 1):
        text = _bare(line)
        if not text:
            continue
        if text.startswith("#"):
            _comment(path, number, text.lstrip("# \t"), header)
        elif not header.line:
            header.line = number
    if not header.line:
        raise MeasuredError(f"{path}: no line with the names of the columns; {_wanted()}")
    names = lines[header.line - 1]
    header.separator = next((s for s in ";,\t" if s in names), None)
    raw = [name.strip() for name in names.split(header.separator)]
    header.columns = [_column(name) for name in raw]
    for name, column in zip(raw, header.columns):
        if column in ANGLES:
            _angles(path, header.line, name.lower().replace("_", " "), header)
    return header


def _angles(path: Path, number: int, text: str, header: _Header) -> None:
    """What ``text`` says of the unit of angles, if anything."""
    other, said = _OTHER_ANGLE.search(text), _ANGLE.search(text)
    if other:
        raise MeasuredError(f"{path}: line {number}: angles in {other[0]}; convert them to degrees or radians")
    if not said:
        return
    unit = "degrees" if said[1] == "deg" else "radians"
    if header.angles not in ("", unit):
        raise MeasuredError(f"{path}: line {number}: angles in {unit}, before: {header.angles}; keep the right one")
    header.angles = unit


def _comment(path: Path, number: int, text: str, header: _Header) -> None:
    key, colon, value = (part.strip() for part in text.partition(":"))
    key, bare = key.lower(), re.sub(r"^values? (are|is) ", "", text.lower())
    if not colon and _SPEAKS.search(text.lower()) and quantity_of(bare):
        key, colon, value = "values", ":", bare
    if colon and key in ("values", "value", "quantity"):
        before, header.quantity = header.stated, quantity_of(value) or ""
        header.stated = header.quantity
        if before not in ("", header.quantity):
            raise MeasuredError(
                f"{path}: line {number}: values: {value[:40]!r}, before: {before!r}; keep the right one"
            )
        if not header.quantity:
            raise MeasuredError(f"{path}: line {number}: values: {value[:60]!r}; write one of: {', '.join(QUANTITIES)}")
    elif colon and key in ("unit", "units"):
        _angles(path, number, value.lower(), header)
    elif colon and key in ("angle", "angles"):
        if not _ANGLE.fullmatch(value.lower()):
            raise MeasuredError(f"{path}: line {number}: {key}: {value[:60]!r}; write # angles: degrees, or radians")
        _angles(path, number, value.lower(), header)
    elif colon and key in ("source", "instrument", "note"):
        header.said[key] = "".join(c if c.isprintable() else " " for c in value)[:500]
    elif colon and key == "kind":
        if value.lower() not in KINDS:
            raise MeasuredError(f"{path}: line {number}: kind: {value[:60]!r}; write one of: {', '.join(KINDS)}")
        header.said[key] = value.lower()
    elif _SPEAKS.search(text.lower()):
        header.unclear = header.unclear or f"line {number}: {text[:60]!r}"


def _wanted() -> str:
    return f"columns {', '.join(ANGLES)} (degrees) or {', '.join(VECTORS)}, then r, g, b or one value, are wanted"


def _columns(path: Path, header: _Header) -> tuple[list[int], list[int]]:
    """Places of the directions' columns and of the values'."""
    known = header.columns
    doubled = next((name for name in (*ANGLES, *VECTORS, *COLOURS) if known.count(name) > 1), None)
    if doubled:
        raise MeasuredError(f"{path}: line {header.line}: column {doubled} is there twice; rename one")
    wanted = VECTORS if sum(name in known for name in VECTORS) > sum(name in known for name in ANGLES) else ANGLES
    missing = [name for name in wanted if name not in known]
    if missing:
        raise MeasuredError(f"{path}: line {header.line}: no column {', '.join(missing)}; {_wanted()}")
    values = [name for name in COLOURS if name in known]
    if len(values) not in (0, 3):
        raise MeasuredError(f"{path}: line {header.line}: of r, g, b only {', '.join(values)}; {_wanted()}")
    if values:
        return [known.index(name) for name in wanted], [known.index(name) for name in values]
    places = [at for at, name in enumerate(known) if name in UNSAID or quantity_of(name)]
    if not places:
        raise MeasuredError(f"{path}: line {header.line}: no column of values; {_wanted()}")
    if len(places) > 1:
        told = " and ".join(known[at] for at in places)
        raise MeasuredError(f"{path}: line {header.line}: columns {told[:80]} may all be the values; keep one")
    named = quantity_of(known[places[0]])
    if named in (F_COS, FACTOR):  # a column of another quantity is often called f
        if header.quantity not in ("", named):
            raise MeasuredError(
                f"{path}: line {header.line}: a column of {named}, before: {header.quantity!r}; keep the right one"
            )
        header.quantity = named
    return [known.index(name) for name in wanted], places


def _rows(path: Path, lines: list[str], header: _Header, columns: list[int]) -> tuple[np.ndarray, np.ndarray]:
    """``columns`` of every row as numbers (n, columns), and its line (n)."""
    words, places = [], []
    for number, line in enumerate(lines[header.line :], header.line + 1):
        bare = _bare(line)
        if bare and not bare.startswith("#"):
            cells = line.split(header.separator)
            if len(cells) != len(header.columns):
                raise MeasuredError(
                    f"{path}: line {number}: {len(cells)} cells, the names of the columns are {len(header.columns)}"
                )
            words += [cells[column] for column in columns]
            places.append(number)
    if not places:
        raise MeasuredError(f"{path}: no row after the names of the columns")
    values = numbers(path, words, np.repeat(places, len(columns)))
    return values.reshape(-1, len(columns)), np.array(places)


def _load(path: str | os.PathLike) -> tuple[Samples, dict[str, str], tuple[str, ...]]:
    path = Path(path)
    lines = re.split(r"\r\n|\r|\n", read_text(path, MOST_BYTES))
    header = _header(path, lines)
    directions, channels = _columns(path, header)
    if header.unclear and not header.quantity:
        raise MeasuredError(f"{path}: {header.unclear}; write # values: and one of: {', '.join(QUANTITIES)}")
    rows, places = _rows(path, lines, header, directions + channels)
    if not np.isfinite(rows).all():
        at = int(np.flatnonzero(~np.isfinite(rows).all(1))[0])
        raise MeasuredError(f"{path}: line {places[at]}: NaN or Inf; remove the row or correct it")
    unit = "vectors" if len(directions) == 6 else header.angles
    wi, wo, keep, warnings = on_sphere(path, rows[:, : len(directions)], places, unit)
    values = rows[keep, len(directions) :]
    if header.quantity == F_COS:
        values = values / wo[:, 2:]
    elif header.quantity == FACTOR:
        values = values / np.pi
    elif not header.quantity:
        warnings = (*warnings, "the file does not say what its values are; taken for f in 1/sr (# values: ...)")
    check_values(path, values)
    values = np.repeat(values, 3, 1) if len(channels) == 1 else values
    return Samples(wi, wo, values, places[keep]), header.said, warnings


def check(path: str | os.PathLike) -> None:
    """MeasuredError (one line: file, line, fault and remedy) if :func:`read` would refuse the file."""
    checked(path, _load(path)[0])


def read(path: str | os.PathLike) -> Measured:
    """The table on the MERL grid, interpolated between its samples. Raises MeasuredError, one line."""
    samples, said, warnings = _load(path)
    return to_measured(path, samples, format=TITLE, warnings=warnings, **said)


def regular_directions(step: float = 10.0) -> tuple[np.ndarray, np.ndarray]:
    """Pairs of a regular table: theta_i and theta_o every ``step`` degrees from 0 to below 90, azimuths from 0 to 180;
    two arrays (n, 3)."""
    theta = np.deg2rad(np.arange(0.0, 90.0 - 1e-9, step))
    phi = np.deg2rad(np.linspace(0.0, 180.0, max(2, round(180 / step) + 1)))
    i, o, p = (a.ravel() for a in np.meshgrid(theta, theta, phi, indexing="ij"))
    wi = np.stack([np.sin(i), 0 * i, np.cos(i)], -1)
    return wi, np.stack([np.sin(o) * np.cos(p), np.sin(o) * np.sin(p), np.cos(o)], -1)


def scattered_directions(path: str | os.PathLike) -> tuple[np.ndarray, np.ndarray]:
    """The pairs of directions, each (n, 3), of a table or of a file of spectral text. MeasuredError for others."""
    samples = _load(path)[0] if recognises(read_bytes(path, HEAD_BYTES)) else spectral.load_samples(path)
    return samples.wi, samples.wo


def write_csv(
    path: str | os.PathLike, wi: np.ndarray, wo: np.ndarray, values: np.ndarray, kind: str, about: str
) -> int:
    """Write f (n, 3) in 1/sr at pairs of unit vectors (n, 3) as a table that :func:`read` takes; returns its rows: NaN
    is left out. ``kind``: of measured.KINDS; ``about``: a line of text. Whole or not at all."""
    angles = []
    for w in (wi, wo):
        angles += [np.arctan2(np.hypot(w[:, 0], w[:, 1]), w[:, 2]), np.arctan2(w[:, 1], w[:, 0])]
    rows = np.concatenate([np.rad2deg(np.stack(angles, -1)), values], -1)
    rows = rows[np.isfinite(rows).all(1)]
    marked = f"# kind: {kind}\n" if kind != MEASURED else ""
    note = shown(" ".join(about.split()))  # a file's name may hold what is no text
    head = f"# values: f\n# angles: degrees\n{marked}# note: {note}\n{','.join((*ANGLES, *COLOURS))}"
    with atomic_path(path) as temporary:
        np.savetxt(temporary, rows, "%.9g", ",", header=head, comments="", encoding="utf-8")
    return len(rows)
