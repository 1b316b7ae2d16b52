"""A job's output goes to its log file; a fault goes to the log and to the terminal."""

import re
import sys
import traceback
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from pathlib import Path

from threadpoolctl import threadpool_limits

from brdfatlas.files import shown, stamps
from brdfatlas.interrupts import as_exceptions, is_job

#: The name of a file that a run made, in an error's text.
RESULT = re.compile(r"\b(results|reports)/[A-Za-z0-9._/-]*[A-Za-z0-9]")


@contextmanager
def logged(path: str | Path, planned: Mapping[str, str] | None = None) -> Iterator[Callable[[str], None]]:
    """Send what the block prints to ``path``; on a fault print one line to the terminal, the whole to the log.

    The block gets a function that says a line to both, for jobs that a person waits for. Linear algebra uses one
    thread in it: jobs run beside each other, and sums have one order. ``planned``: file -> its stamp
    (:func:`brdfatlas.files.stamps`) when the run was planned. A file that is another before or after the block is
    a fault: what is made of it would stand beside what other jobs made of the old one.
    """
    as_exceptions()
    if is_job():  # a worker that a model spawns imports the main program by this name: it would be the job once more
        vars(sys.modules["__main__"]).pop("__file__", None)
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    terminal = sys.stderr
    with open(path, "w", encoding="utf-8", buffering=1) as log, redirect_stdout(log), redirect_stderr(log):

        def say(line: str) -> None:
            print(line, file=log)
            print(line, file=terminal, flush=True)

        try:
            with threadpool_limits(1):
                _check_unchanged(planned or {})
                yield say
                _check_unchanged(planned or {})
        except SystemExit as stop:
            print(stop.code, file=log)
            print(stop.code, file=terminal)
            raise SystemExit(1) from None
        except BaseException as error:
            traceback.print_exc(file=log)
            print(f"{fault(error)} (log: {path})", file=terminal)
            raise SystemExit(1) from None


def _check_unchanged(planned: Mapping[str, str]) -> None:
    for path, stamp in stamps(planned).items():
        if stamp != planned[path]:
            what = "has changed" if stamp else "is gone"
            raise SystemExit(f"{shown(path)}: {what} during the run; see that it is whole and start the run again")


def fault(error: BaseException) -> str:
    """An error in one line; with the remedy where it names a file that a run made."""
    words = f"{type(error).__name__}: {' '.join(str(error).split())}".removesuffix(": ")
    named = RESULT.search(words)
    if (
        named
        and "delete it" not in words
        and Path(named[0]).exists()
        and (isinstance(error, IsADirectoryError) or not getattr(error, "errno", None))
    ):
        damaged = Path(named[0]).is_file() or re.search("a folder|[nN]ot a regular file|Is a directory", words)
        return f"{words}; if {named[0]} is damaged, delete it: the next run makes it again" if damaged else words
    return words
