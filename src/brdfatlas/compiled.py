"""``njit`` that also works where compiled code cannot be kept."""

import sys
from collections.abc import Callable
from typing import Any

import numba

_told: list[str] = []


def njit(**options: Any) -> Callable[[Callable], Any]:
    """``numba.njit(**options)``; without ``cache`` where neither the package's folder, nor a home, nor NUMBA_CACHE_DIR
    can be written to (shared installs, containers). That is said once, in one line on stderr."""

    def compile_later(function: Callable) -> Any:
        try:
            return numba.njit(**options)(function)
        except RuntimeError as error:
            if "no locator available" not in str(error):
                raise
        if not _told:
            _told.append(function.__name__)
            print(
                "brdfatlas: compiled code cannot be kept and is compiled anew in each process; "
                "set NUMBA_CACHE_DIR to a folder that can be written to",
                file=sys.stderr,
            )
        return numba.njit(**(options | {"cache": False}))(function)

    return compile_later
