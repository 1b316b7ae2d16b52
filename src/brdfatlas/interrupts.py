"""The command, and a rule's script, while it imports, which takes the first second or two: Ctrl-C ends it at once,
without a traceback, and a number of threads that Numba refuses is told in one line.

Nothing changes for a program that imports the package, but that a SOURCE_DATE_EPOCH that is no time is named.
"""

import contextlib
import os
import signal
import sys
import threading
import time


def _is_command() -> bool:
    return os.path.basename(sys.argv[0] if getattr(sys, "argv", None) else "") == "brdfatlas"


def _is_job() -> bool:
    """Whether this is the script of a rule, which Snakemake runs as a program of its own."""
    return os.sep.join([".snakemake", "scripts", ""]) in (getattr(sys, "argv", None) or [""])[0]


def _swap(old: object, new: object) -> None:
    if threading.current_thread() is threading.main_thread() and signal.getsignal(signal.SIGINT) is old:
        signal.signal(signal.SIGINT, new)  # type: ignore[arg-type]


def as_exceptions() -> None:
    """What the command, and a rule's script, call when their imports are done: Ctrl-C is a KeyboardInterrupt again."""
    if _is_command() or _is_job():
        _swap(signal.SIG_DFL, signal.default_int_handler)


def _check_threads() -> None:
    """Numba, which every command imports, ends in a traceback where it is to have no thread."""
    with contextlib.suppress(ValueError):  # what is no number is left to Numba, which warns and goes on
        if int(os.environ.get("NUMBA_NUM_THREADS", "1")) < 1:
            sys.exit("brdfatlas: NUMBA_NUM_THREADS: less than one thread; set it to 1 or more, or unset it")


def _check_epoch() -> None:
    """NumPy's f2py, which SciPy imports, and Matplotlib end in a traceback that does not name the variable."""
    text = os.environ.get("SOURCE_DATE_EPOCH", "0")
    try:
        time.gmtime(int(text))
    except (ValueError, OverflowError, OSError):
        fault = f"SOURCE_DATE_EPOCH: {text!r:.40} is no time in whole seconds; correct it, or unset it"
        if _is_command():
            sys.exit(f"brdfatlas: {fault}")
        raise ValueError(fault) from None


_check_epoch()
if _is_command():
    _check_threads()
if _is_command() or _is_job():
    _swap(signal.default_int_handler, signal.SIG_DFL)
