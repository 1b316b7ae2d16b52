"""Scripts that carry bytes: a page from file:// may not read a data file, but may run a script.

The script calls ``CALL(arguments, count, text)``. A character of ``text`` holds 15 bits, the first bit of the first
byte highest, as the code point :data:`FIRST` + bits; ``count`` bytes are meant. The file is UTF-16 with a byte order
mark, which every browser obeys before what a server says. That adds 7 % to the bytes; base64 adds 33 %.
"""

import json
import os
from pathlib import Path
from typing import Any

import numpy as np

from brdfatlas.files import atomic_path

#: Characters from here on: 2^15 of them, none of which is a surrogate or has to be escaped.
FIRST, BITS = 0x3000, 15


def pack(content: bytes) -> str:
    """Bytes as text, 15 bits a character."""
    bits = np.unpackbits(np.frombuffer(content, np.uint8))
    bits = np.pad(bits, (0, -len(bits) % BITS)).reshape(-1, BITS)
    return (bits @ (1 << np.arange(BITS)[::-1]) + FIRST).astype("<u2").tobytes().decode("utf-16-le")


def unpack(text: str, count: int) -> bytes:
    """The inverse of :func:`pack`: what assets/packed.js does."""
    codes = np.frombuffer(text.encode("utf-16-le"), "<u2") - FIRST
    return np.packbits((codes[:, None] >> np.arange(BITS)[::-1]) & 1).tobytes()[:count]


def write_script(path: str | os.PathLike, call: str, arguments: list[Any], content: bytes) -> None:
    """Write a script that calls ``window.CALL`` with ``arguments`` and ``content``; whole or not at all."""
    told = ",".join(json.dumps(item) for item in [*arguments, len(content)])
    with atomic_path(path) as temporary:
        temporary.write_text(f'window.{call}({told},"{pack(content)}");\n', encoding="utf-16")


def read_script(path: str | os.PathLike) -> bytes:
    """The bytes that a script of :func:`write_script` carries."""
    before, text, _ = Path(path).read_text(encoding="utf-16").rsplit('"', 2)
    return unpack(text, int(before.rstrip(",").rsplit(",", 1)[1]))
