"""What a run finds of an earlier one that was killed, lost its disk or its clock, and how it goes on by itself.

Snakemake knows which outputs a killed job left unfinished. Three things it does not know, and they are mended here
before its work begins: that the holder of a lock is dead, that a finished file was damaged afterwards, and that time
stamps of the future mean nothing.
"""

import fcntl
import json
import os
import re
import sys
import time
from base64 import urlsafe_b64encode
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import IO

from brdfatlas.files import atomic_path
from brdfatlas.pipeline.download import checksum_of

LEDGER = Path("results") / "ledger.tsv"
STATE = Path(".snakemake")
#: Names of temporary files of the package: hidden, with tempfile's eight characters.
UNFINISHED = re.compile(r"\..+\.[a-z0-9_]{8}(\.\w+)?")
_held: list[IO[str]] = []


def recover(inputs: Iterable[str | os.PathLike] = (), say: Callable[[str], None] | None = None) -> None:
    """Make the working directory ready for the next run; ``inputs``: files and folders that jobs read.

    Raises ValueError (one line) if the results folder cannot be written, or if another run is at work here.
    """
    say = say or _to_stderr
    check_writable("results", "reports", STATE)
    take_over_lock(say=say)
    remove_unfinished("results", "reports")
    remove_damaged(say=say)
    mend_time_stamps(inputs, say=say)


def check_writable(*folders: str | os.PathLike) -> None:
    """ValueError that names the first folder in which no file can be made."""
    for folder in map(Path, folders):
        probe = folder / f".writable.{os.getpid()}"
        try:
            folder.mkdir(parents=True, exist_ok=True)
            probe.touch()
            probe.unlink()
        except OSError as error:
            raise ValueError(
                f"{folder}: cannot be written ({error.strerror}); make it writable for this user, or free space there"
            ) from None


def take_over_lock(state: Path = STATE, patience: float = 10.0, say: Callable[[str], None] | None = None) -> None:
    """Remove Snakemake's lock if the process that made it is dead.

    A run holds a lock of the operating system as long as it lives; who gets that lock knows that no other run is
    alive here. ``patience``: seconds to wait for a process that is about to end (as a killed one is).
    """
    state.mkdir(exist_ok=True)
    handle = open(state / "brdfatlas.lock", "a", encoding="utf-8")  # noqa: SIM115, held until this process ends
    deadline = time.monotonic() + patience
    while True:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            break
        except BlockingIOError:
            if time.monotonic() > deadline:
                handle.close()
                raise ValueError(
                    f"{Path.cwd()}: another run is at work here; wait for its end, or use another copy of the project"
                ) from None
            time.sleep(0.2)
        except OSError:  # a file system without locks: Snakemake's own lock must do
            handle.close()
            return
    _held.append(handle)
    stale = list((state / "locks").glob("*.lock"))
    for lock in stale:
        lock.unlink(missing_ok=True)
    if stale:
        (say or _to_stderr)("an earlier run was killed; going on where it stopped")


def remove_unfinished(*folders: str | os.PathLike) -> None:
    """Remove what :func:`brdfatlas.files.atomic_path` left where its process was killed."""
    for path in _files(folders):
        if UNFINISHED.fullmatch(os.path.basename(path)):
            Path(path).unlink(missing_ok=True)


def record_outputs(paths: Iterable[str], ledger: Path = LEDGER) -> None:
    """Remember size, time stamp and checksum of files that a job has just finished."""
    with open(ledger, "a", encoding="utf-8") as handle:
        for path in paths:
            if os.path.isfile(path):
                handle.write(_entry(path) + "\n")


def _entry(path: str) -> str:
    status = os.stat(path)
    return f"{path}\t{status.st_size}\t{status.st_mtime_ns}\t{checksum_of(path)}"


def read_ledger(ledger: Path = LEDGER) -> dict[str, tuple[int, int, str]]:
    """path -> (size, time stamp in ns, checksum), the last entry of each; a line cut short by a kill is skipped."""
    known: dict[str, tuple[int, int, str]] = {}
    if ledger.exists():
        for line in ledger.read_text(encoding="utf-8").splitlines():
            parts = line.split("\t")
            if len(parts) == 4 and parts[1].isdigit() and parts[2].isdigit() and len(parts[3]) == len("sha256:") + 64:
                known[parts[0]] = (int(parts[1]), int(parts[2]), parts[3])
    return known


def remove_damaged(ledger: Path = LEDGER, say: Callable[[str], None] | None = None) -> list[str]:
    """Remove files that changed since their job finished, so that they are made again; returns their paths.

    Size and time stamp are compared, and the checksum where only the time stamp differs.
    """
    known, removed, moved = read_ledger(ledger), [], {}
    for path, (size, stamp, checksum) in known.items():
        try:
            status = os.stat(path)
        except OSError:
            continue
        if status.st_size == size and status.st_mtime_ns == stamp:
            continue
        if status.st_size == size and checksum_of(path) == checksum:
            moved[path] = (size, status.st_mtime_ns, checksum)
            continue
        os.unlink(path)
        removed.append(path)
        (say or _to_stderr)(f"{path}: damaged since it was made ({status.st_size:,} of {size:,} bytes); made again now")
    gone = [path for path in known if not os.path.exists(path)]
    if moved or gone:
        known |= moved
        with atomic_path(ledger) as temporary, open(temporary, "w", encoding="utf-8") as handle:
            for path, entry in known.items():
                if path not in set(gone):
                    handle.write("\t".join([path, *map(str, entry)]) + "\n")
    return removed


def mend_time_stamps(
    inputs: Iterable[str | os.PathLike] = (),
    ledger: Path = LEDGER,
    state: Path = STATE,
    say: Callable[[str], None] | None = None,
) -> None:
    """Give files from the future (the clock was wrong, now or then) the time stamp of now.

    An output from the future would hide every later change of its inputs; if Snakemake's record shows that an input
    is not what it was, the output is removed. An input from the future would be newer than all that is made of it.
    """
    say, now = say or _to_stderr, time.time()
    for path in _files(inputs):
        if _from_future(path, now):
            say(f"{path}: from the future; its time stamp is now set to now")
            _stamp(path, now)
    for path in read_ledger(ledger):
        if _from_future(path, now):
            if _inputs_changed(path, state):
                os.unlink(path)
                say(f"{path}: from the future, and its inputs changed; made again now")
            else:
                _stamp(path, now)


def _files(inputs: Iterable[str | os.PathLike]) -> Iterator[str]:
    for item in inputs:
        if os.path.isdir(item):
            for folder, folders, names in os.walk(item):
                folders[:] = [name for name in folders if name != "__pycache__"]
                yield from (os.path.join(folder, name) for name in names)
        else:
            yield os.fspath(item)


def _from_future(path: str, now: float) -> bool:
    try:
        return os.stat(path).st_mtime > now + 1.0
    except OSError:
        return False


def _stamp(path: str, now: float) -> None:
    try:
        os.utime(path, (now, now))
    except OSError as error:
        raise ValueError(
            f"{path}: from the future, and its time stamp cannot be set ({error.strerror}); touch it, or set the clock"
        ) from None


def _inputs_changed(path: str, state: Path) -> bool:
    """Whether a small input of a file differs from what Snakemake recorded when the file was made."""
    name = urlsafe_b64encode(path.encode()).decode()
    try:
        record = json.loads((state / "metadata" / name).read_text(encoding="utf-8"))
        recorded = record["input_checksums"]
    except (OSError, ValueError, KeyError):
        return True
    for source, checksum in recorded.items():
        if not os.path.isfile(source):
            return True
        expected = checksum if ":" in checksum else f"sha256:{checksum}"
        if checksum_of(source, expected.partition(":")[0]) != expected:
            return True
    return False


def _to_stderr(line: str) -> None:
    print(line, file=sys.stderr, flush=True)
