"""The command line: how it runs and how it ends."""

import argparse
import contextlib
import errno
import json
import os
import signal
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from brdfatlas import interrupts
from brdfatlas.cli.commands import emit
from brdfatlas.cli.grammar import check_arguments, parser
from brdfatlas.files import ENDINGS, FileFault, plain, shown
from brdfatlas.measured import MeasuredError
from brdfatlas.models.base import FitError

#: What a user can repair: one line on stderr and exit status 1; anything else is our fault and keeps its traceback.
USER_FAULTS = (MeasuredError, FitError, ValueError, KeyError, ImportError, OSError, MemoryError)
#: Exit status of a shell for a command that SIGPIPE ended; for another signal it is 128 and its number, too.
BROKEN_PIPE = 141


def run(args: argparse.Namespace) -> None:
    """Run a command and print what it has to say; with ``-o -`` print the file that it would write."""
    check_arguments(args)
    if getattr(args, "output", None) != "-":
        # with --json the result alone is printed: not what a model prints
        with contextlib.redirect_stdout(sys.stderr if args.json else sys.stdout):
            result = args.function(args)
        if args.json:
            emit(json.dumps(plain(result), indent=1, ensure_ascii=False) + "\n")
    else:
        with interrupts.unwound(), tempfile.TemporaryDirectory() as folder:
            args.named = args.output = os.path.join(folder, "out" + ENDINGS[args.writes][0])
            args.json = True
            with contextlib.redirect_stdout(sys.stderr):
                args.function(args)
            if len(os.listdir(folder)) > 1:
                raise FileFault("-o -: this fit is written beside its export, in a file of its own; name a file")
            emit(Path(args.output).read_text(encoding="utf-8"))
    emit("", flush=True)


def reason(error: BaseException) -> str:
    """An error in one line."""
    if isinstance(error, MemoryError):
        return "not enough memory; take a smaller size, or close other programs"
    if isinstance(error, KeyError) and error.args:
        return shown(error.args[0])
    if isinstance(error, OSError) and error.errno in (errno.EMFILE, errno.ENFILE):
        return f"{error.strerror}; allow more, `ulimit -n 256`, or close other programs"
    if isinstance(error, OSError) and error.strerror and error.filename:
        return f"{shown(error.filename)}: {error.strerror}"
    if isinstance(error, FileNotFoundError) and not error.filename:
        return "the working folder is gone; change to one that exists"
    return shown(" ".join(str(error).split("\n")).strip() or type(error).__name__)


def _open_streams() -> None:
    """Standard streams that the caller has closed lead nowhere. Without them the next file to be opened would have the
    number of one, and get what libraries print."""
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            number = os.open(os.devnull, os.O_RDWR)  # the lowest that is free: the stream's own
            setattr(sys, name, os.fdopen(number, mode, closefd=False))


def main(argv: Sequence[str] | None = None) -> int:
    """Entry point; exit status 0, or 1 after one line that says what is wrong; 128 + n where signal n ended it."""
    _open_streams()
    with contextlib.suppress(AttributeError):
        sys.stdout.reconfigure(errors="backslashreplace")  # names of files that are no text in this locale
    try:
        interrupts.as_exceptions()
        args = parser().parse_args(argv)
        run(args)
    except BrokenPipeError:  # `| head` has read enough
        return BROKEN_PIPE
    except BaseException as error:
        number = interrupts.received or (signal.SIGINT if isinstance(error, KeyboardInterrupt) else 0)
        if number:
            with contextlib.suppress(OSError):  # of a terminal that was closed
                print("brdfatlas: interrupted, nothing was written", file=sys.stderr)
            return 128 + number
        if isinstance(error, Exception | SystemExit) and not isinstance(error, USER_FAULTS):
            raise
        kind = "" if isinstance(error, USER_FAULTS) else f"{type(error).__name__}: "  # a model's own
        print(f"brdfatlas {args.command}: {kind}{reason(error)}", file=sys.stderr)
        return 1
    finally:
        interrupts.at_once()
    return 0
