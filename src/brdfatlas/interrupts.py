"""Ctrl-C while the command imports, which takes its first second or two: it ends at once, without a traceback.

Nothing changes for a program that imports the package.
"""

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


if _is_command():
    _swap(signal.default_int_handler, signal.SIG_DFL)
