"""The command while it imports, which takes its first second or two: Ctrl-C ends it at once, without a traceback, and a
number of threads that Numba refuses is told in one line.

Nothing changes for a program that imports the package.
"""

import contextlib
import os
import signal
import sys
import threading


def _is_command() -> bool:
    return os.path.basename(sys.argv[0] if getattr(sys, "argv", None) else "") == "brdfatlas"


def _swap(old: object, new: object) -> None:
    if threading.current_thread() is threading.main_thread() and signal.getsignal(signal.SIGINT) is old:
        signal.signal(signal.SIGINT, new)  # type: ignore[arg-type]


def as_exceptions() -> None:
    """What the command calls when its imports are done: Ctrl-C is a KeyboardInterrupt again."""
    if _is_command():
        _swap(signal.SIG_DFL, signal.default_int_handler)


def _check_threads() -> None:
    """Numba, which every command imports, ends in a traceback where it is to have no thread."""
    with contextlib.suppress(ValueError):  # what is no number is left to Numba, which warns and goes on
        if int(os.environ.get("NUMBA_NUM_THREADS", "1")) < 1:
            sys.exit("brdfatlas: NUMBA_NUM_THREADS: less than one thread; set it to 1 or more, or unset it")


if _is_command():
    _check_threads()
    _swap(signal.default_int_handler, signal.SIG_DFL)
