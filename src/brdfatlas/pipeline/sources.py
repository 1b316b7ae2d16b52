"""Which source files a result depends on, so that editing a model's file refits that model and nothing else."""

import ast
from functools import cache
from pathlib import Path

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
