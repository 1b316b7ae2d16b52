"""Modules of models from files outside any package: ``brdfatlas.models.own.STEM_PATH``, the path in hexadecimal.

By that name any process with this package finds them: the workers that a model starts unpickle its functions.
Files of one name in two folders are two modules.
"""

import importlib.util
import os
import sys
from importlib.machinery import ModuleSpec
from pathlib import Path

__path__: list[str] = []


def module_of(path: str | os.PathLike) -> str:
    """The name of the module of a Python file."""
    return f"{__name__}.{Path(path).stem}_{os.fsencode(os.path.abspath(path)).hex()}"


class _Finder:
    @staticmethod
    def find_spec(name: str, path: object = None, target: object = None) -> ModuleSpec | None:
        if not name.startswith(f"{__name__}."):
            return None
        try:
            file = os.fsdecode(bytes.fromhex(name.rpartition("_")[2]))
        except ValueError:
            return None
        return importlib.util.spec_from_file_location(name, file) if os.path.isfile(file) else None


sys.meta_path.append(_Finder)
