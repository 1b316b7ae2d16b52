"""Tables in files: tab-separated, numbers that are none spelt out, names never taken for numbers."""

import os
from collections.abc import Iterable
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
    "note",
    "source",
)


def write_tsv(path: str | os.PathLike, table: pd.DataFrame, *, digits: int = 6) -> None:
    """Numbers with so many significant digits, "nan" and "inf" spelt out; whole or not at all."""
    with atomic_path(path) as temporary:
        table.to_csv(temporary, sep="\t", index=False, float_format=f"%.{digits}g", na_rep="nan", lineterminator="\n")


def read_tsv(paths: Iterable[str | os.PathLike] | str | os.PathLike) -> pd.DataFrame:
    """One table from the files that :func:`write_tsv` wrote; columns of TEXT_COLUMNS stay text, others are numbers.

    An empty cell among numbers is NaN. ValueError for a word there, and for a file that was cut off.
    """
    files = [paths] if isinstance(paths, str | os.PathLike) else list(paths)
    for path in files:
        if not Path(path).read_bytes().endswith(b"\n"):
            raise ValueError(f"{path}: cut off, the last line has no end")
    tables = [pd.read_csv(path, sep="\t", dtype=str, na_filter=False) for path in files]
    table = pd.concat(tables, ignore_index=True)
    numbers = [name for name in table.columns if name not in TEXT_COLUMNS]
    return table.assign(**{name: table[name].replace("", "nan").astype(float) for name in numbers})
