"""A job's output goes to its log file; a fault goes to the log and to the terminal."""

import sys
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from pathlib import Path


@contextmanager
def logged(path: str | Path) -> Iterator[Callable[[str], None]]:
    """Send what the block prints to ``path``; on a fault print one line to the terminal, the whole to the log.

    The block gets a function that says a line to both, for jobs that a person waits for.
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    terminal = sys.stderr
    with open(path, "w", encoding="utf-8", buffering=1) as log, redirect_stdout(log), redirect_stderr(log):

        def say(line: str) -> None:
            print(line, file=log)
            print(line, file=terminal, flush=True)

        try:
            yield say
        except SystemExit as stop:
            print(stop.code, file=log)
            print(stop.code, file=terminal)
            raise SystemExit(1) from None
        except BaseException as error:
            traceback.print_exc(file=log)
            print(f"{type(error).__name__}: {error} (log: {path})", file=terminal)
            raise SystemExit(1) from None
