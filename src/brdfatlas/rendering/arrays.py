"""NumPy arrays for Dr.Jit."""

from typing import Any

import numpy as np


def aligned(size: int, dtype: type = np.float32) -> np.ndarray:
    """``size`` numbers that are 0, in memory aligned to 64 bytes.

    Dr.Jit takes over the memory of NumPy arrays, and writes its alignment, which is chance, into its kernels: a kernel
    would seldom be found again by a later process.
    """
    count = size * np.dtype(dtype).itemsize
    room = np.zeros(count + 64, np.uint8)
    start = -room.ctypes.data % 64
    return room[start : start + count].view(dtype)


def upload(kind: type, values: np.ndarray) -> Any:
    """A Dr.Jit array of type ``kind`` with ``values``, flattened, in memory of its own (:func:`aligned`)."""
    flat = aligned(np.size(values), np.float32 if "Float" in kind.__name__ else np.uint32)
    flat[:] = np.ravel(values)
    return kind(flat)
