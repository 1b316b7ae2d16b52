"""Which source files a result depends on, so that editing a model's file refits that model and nothing else."""

import ast
import hashlib
from functools import cache
from pathlib import Path

from brdfatlas.files import write_text

PACKAGE = "brdfatlas"
ROOT = Path(__file__).resolve().parent.parent


def module_path(module: str) -> Path | None:
    """The file of a module of this package; None for a package's ``__init__`` and for what is not ours.

    An ``__init__`` only gathers names, and the registry's must not tie every model to every other.
    """
    parts = module.split(".")
    if parts[0] != PACKAGE or len(parts) == 1:
        return None
    path = ROOT.joinpath(*parts[1:]).with_suffix(".py")
    return path if path.is_file() else None


@cache
def imports_of(path: Path) -> tuple[str, ...]:
    """Modules of this package that a file names in its import statements, anywhere in it."""
    names: list[str] = []
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"), str(path))):
        if isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
            names.append(node.module)
            names += [f"{node.module}.{alias.name}" for alias in node.names]
    return tuple(name for name in names if name.startswith(f"{PACKAGE}."))


@cache
def sources_of(*modules: str) -> tuple[str, ...]:
    """Source files that ``modules`` (dotted names, or paths of model files) depend on, transitively.

    Paths are relative to the working directory where they lie below it, so that moving a checkout reruns nothing.
    """
    pending: list[Path] = []
    for module in modules:
        path = Path(module) if module.endswith(".py") else module_path(module)
        if path is None or not path.is_file():
            raise FileNotFoundError(f"no source file for {module}")
        pending.append(path)
    found: set[Path] = set()
    while pending:
        path = pending.pop()
        if path not in found:
            found.add(path)
            pending += [target for name in imports_of(path) if (target := module_path(name))]
    return tuple(sorted(_relative(path) for path in found))


def _relative(path: Path) -> str:
    path = path.absolute()
    try:
        return str(path.relative_to(Path.cwd()))
    except ValueError:
        return str(path)


@cache
def _checksum(path: str) -> str:
    return hashlib.sha256(Path(path).read_bytes()).hexdigest()


def list_sources(folder: str | Path, *modules: str) -> str:
    """Path of a file in ``folder`` that lists :func:`sources_of` with their checksums; written anew if one changed.

    Jobs take it as input in place of some twenty files each, which the scheduler would go through for every job that is
    ready, whenever it starts another.
    """
    files = sources_of(*modules)
    names = [Path(name).stem if name.endswith(".py") else name.removeprefix(f"{PACKAGE}.") for name in modules]
    # Two models of one's own may have files of one name in different folders.
    own = "".join(name for name in modules if name.endswith(".py"))
    names += [hashlib.sha256(own.encode()).hexdigest()[:8]] if own else []
    path = Path(folder) / f"{'+'.join(names)}.tsv"
    text = "".join(f"{file}\t{_checksum(file)}\n" for file in files)
    if not path.is_file() or path.read_text(encoding="utf-8") != text:
        write_text(path, text)
    return str(path)
