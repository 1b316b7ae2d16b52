"""How the command, and a rule's script, ends. While it imports, its first second or two, a signal ends it at once,
without a traceback, and a number of threads that Numba refuses is told in one line. Later Ctrl-C unwinds it, and so do
SIGTERM and SIGHUP the command, while there is something to tidy up.

Nothing changes for a program that imports the package, but that a SOURCE_DATE_EPOCH that is no time is named.
"""

import contextlib
import os
import signal
import sys
import threading
import time
from collections.abc import Iterator

#: The signal that ends the command, 0 while none has come. Compiled code may raise another exception for ours, or none.
received = 0
_held = 0


def _is_command() -> bool:
    name = os.path.basename(sys.argv[0] if getattr(sys, "argv", None) else "")
    return name == "brdfatlas" or (name in ("-m", "__main__.py") and "brdfatlas" in sys.orig_argv)


def is_job() -> bool:
    """Whether this is the script of a rule, which Snakemake runs as a program of its own."""
    return os.sep.join([".snakemake", "scripts", ""]) in (getattr(sys, "argv", None) or [""])[0]


def _swap(number: int, old: object, new: object) -> bool:
    main = threading.current_thread() is threading.main_thread()
    if not main or signal.getsignal(number) is not old or not (_is_command() or is_job()):
        return False
    signal.signal(number, new)  # type: ignore[arg-type]
    return True


def _end(number: int, _: object) -> None:
    global received
    received = received or number
    if not _held:
        raise KeyboardInterrupt


@contextlib.contextmanager
def held() -> Iterator[None]:
    """A signal that comes in the block ends the command after it: a compiled library that is imported by half brings
    the process down."""
    global _held
    _held += 1
    try:
        yield
    finally:
        _held -= 1
    if received and not _held:
        raise KeyboardInterrupt


@contextlib.contextmanager
def unwound() -> Iterator[None]:
    """SIGTERM and SIGHUP unwind a block that has something to tidy up, an unfinished file or workers. Elsewhere they
    end the command at once, also within compiled code, where Python looks at signals after minutes."""
    names = ("SIGTERM", "SIGHUP") if _is_command() else ()
    numbers = [getattr(signal, name) for name in names if hasattr(signal, name)]
    swapped = [number for number in numbers if _swap(number, signal.SIG_DFL, _end)]
    try:
        yield
    finally:
        for number in swapped:
            _swap(number, _end, signal.SIG_DFL)


def as_exceptions() -> None:
    """What the command, and a rule's script, call when their imports are done: Ctrl-C is a KeyboardInterrupt again."""
    _swap(signal.SIGINT, signal.SIG_DFL, _end)


def at_once() -> None:
    """What the command calls last: while Python ends, a signal needs no words and no traceback."""
    _swap(signal.SIGINT, _end, signal.SIG_DFL)


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
_swap(signal.SIGINT, signal.default_int_handler, signal.SIG_DFL)
