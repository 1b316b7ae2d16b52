"""Tables in files: tab-separated, numbers that are none spelt out, names never taken for numbers."""

import os
import re
from collections.abc import Iterable, Sequence
from pathlib import Path

import pandas as pd

from brdfatlas.files import atomic_path

#: Columns that hold words, also where a word looks like a number: a material may be called "null" or "NA".
TEXT_COLUMNS = (
    "material",
    "model",
    "variant",
    "other",
    "measure",
    "scene",
    "status",
    "reason",
    "class",
    "standin",
    "reconstructed",
    "note",
    "source",
)

#: Columns that tables of errors have whatever they measure.
ERRORS, BRDF = ("material", "model", "scene", "status"), ("material", "model")
PAIRS = ("material", "scene", "model", "other")

#: What a spreadsheet may run; apostrophes before it, so that taking one off gives back what was.
FORMULA = re.compile(r"'*[=+\-@\t\r]")


def write_tsv(path: str | os.PathLike, table: pd.DataFrame, *, digits: int = 6) -> None:
    """Numbers with so many significant digits, "nan" and "inf" spelt out; whole or not at all.

    A cell of text that a spreadsheet would take for a formula (a file may be called "=1+1") gets an apostrophe before
    it, which :func:`read_tsv` takes off.
    """
    words = table.select_dtypes(exclude="number").columns
    table = table.assign(**{name: table[name].map(_guarded) for name in words})
    with atomic_path(path) as temporary:
        table.to_csv(temporary, sep="\t", index=False, float_format=f"%.{digits}g", na_rep="nan", lineterminator="\n")


def _guarded(cell: object) -> object:
    return f"'{cell}" if isinstance(cell, str) and FORMULA.match(cell) else cell


def _unguarded(cell: str) -> str:
    return cell[1:] if cell.startswith("'") and FORMULA.match(cell) else cell


def read_tsv(paths: Iterable[str | os.PathLike] | str | os.PathLike, columns: Sequence[str] = ()) -> pd.DataFrame:
    """One table from the files that :func:`write_tsv` wrote; columns of TEXT_COLUMNS stay text, others are numbers.

    An empty cell among numbers is NaN. ValueError naming the file for a word there, for one that was cut off, and for
    one without the ``columns`` that it should have.
    """
    files = [paths] if isinstance(paths, str | os.PathLike) else list(paths)
    for path in files:
        if not Path(path).read_bytes().endswith(b"\n"):
            raise ValueError(f"{path}: cut off, the last line has no end")
    return pd.concat([_read_table(path, columns) for path in files], ignore_index=True)


def _read_table(path: str | os.PathLike, columns: Sequence[str]) -> pd.DataFrame:
    try:
        table = pd.read_csv(path, sep="\t", dtype=str, na_filter=False).map(_unguarded)
        missing = [name for name in columns if name not in table]
        if missing:
            raise ValueError(f"no column {', '.join(missing)}")
        numbers = [name for name in table.columns if name not in TEXT_COLUMNS]
        return table.assign(**{name: table[name].replace("", "nan").astype(float) for name in numbers})
    except ValueError as error:
        raise ValueError(f"{path}: not a table that a run writes ({error})") from None
