"""What runs made in reports/: what is gone of it is noticed, what is left over from an earlier run is removed."""

import os
import time
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path

from brdfatlas.files import UNFINISHED, file_digest, read_record, write_text

HOUR = 3600.0


def listed_files(listing: str | os.PathLike, folder: str | os.PathLike) -> list[Path]:
    """Files in ``folder`` that the listing of a job, {kind: {name: SHA-256}}, names."""
    kinds = read_record(listing).values()
    if not all(isinstance(names, Mapping) for names in kinds):
        raise ValueError(f"{listing}: not a list of files that a run writes")
    return [Path(folder) / name for names in kinds for name in names]


def missing_files(listing: str | os.PathLike, folder: str | os.PathLike) -> list[Path]:
    """Listed files that are gone; none where there is no listing (yet) or where it cannot be read."""
    try:
        return [path for path in listed_files(listing, folder) if not path.exists()]
    except (OSError, ValueError):
        return []


def record_reports_job(
    files: Iterable[str], listings: Mapping[str, str], record: str | os.PathLike, say: Callable[[str], None]
) -> None:
    """Write ``record``, a line "SHA-256, path" for each of ``files`` and each listed file; ``listings``: listing ->
    folder. A file of the old record that is not in the new one is removed if nobody has changed it since."""
    record = Path(record)
    listed = [path for listing, folder in listings.items() for path in listed_files(listing, folder)]
    made = {str(path) for path in [*map(Path, files), *listed] if Path(path).parts[0] == "reports"}
    try:
        lines = record.read_text(encoding="utf-8").splitlines() if record.exists() else []
    except UnicodeDecodeError:
        raise ValueError(f"{record}: not UTF-8, no record that a run writes") from None
    for digest, _, name in (line.partition("\t") for line in lines):
        path = Path(name)
        if name in made or path.parts[:1] != ("reports",) or ".." in path.parts or not path.is_file():
            continue
        if file_digest(path) != digest:
            say(f"{name}: not part of this run, but changed since it was made; kept")
            continue
        path.unlink()
        print(f"{name}: removed, not part of this run")
        _remove_empty(path.parent)
    for folder in ("results", "reports"):
        for path in Path(folder).rglob(f"{UNFINISHED}*"):
            if path.is_file() and path.stat().st_mtime < time.time() - HOUR:
                path.unlink()
    write_text(record, "".join(f"{file_digest(name)}\t{name}\n" for name in sorted(made)))


def _remove_empty(folder: Path) -> None:
    while folder != Path("reports") and not any(folder.iterdir()):
        folder.rmdir()
        folder = folder.parent
