"""Loops that numba compiles, once for all runs where their code can be kept."""

from collections.abc import Callable
from typing import TypeVar

from numba import njit

F = TypeVar("F", bound=Callable)


def compiled(function: F) -> F:
    """``function``, compiled at its first call without the interpreter's lock.

    The code is kept beside the module or in the user's cache folder; where neither can be written (a shared
    installation, a container), every process compiles for itself.
    """
    try:
        return njit(cache=True, nogil=True)(function)
    except RuntimeError:  # numba: "no locator available"
        return njit(nogil=True)(function)
