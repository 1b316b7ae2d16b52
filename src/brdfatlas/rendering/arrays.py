"""NumPy arrays for Dr.Jit."""

from typing import Any

import numpy as np


def upload(kind: type, values: np.ndarray) -> Any:
    """A Dr.Jit array of type ``kind`` with ``values``, flattened, in memory aligned to 64 bytes.

    Dr.Jit takes over the memory of NumPy arrays, and writes its alignment, which is chance, into its kernels: a kernel
    would seldom be found again by a later process.
    """
    dtype = np.dtype(np.float32 if "Float" in kind.__name__ else np.uint32)
    flat = np.ascontiguousarray(values, dtype).ravel()
    room = np.empty(flat.nbytes + 64, np.uint8)
    start = -room.ctypes.data % 64
    aligned = room[start : start + flat.nbytes].view(dtype)
    aligned[:] = flat
    return kind(aligned)
