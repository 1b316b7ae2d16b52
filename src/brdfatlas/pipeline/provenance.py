"""What a result is made of besides its inputs: source files and libraries, in one line a rule.

Snakemake sees inputs, parameters and scripts. It does not see the modules that a script imports, nor the versions of
libraries. :func:`provenance` says both in a short text that rules take as a parameter, so that a result is made anew
when one of them changes. A comment, a docstring or an empty line changes no result and counts for nothing.
"""

import ast
import dis
import hashlib
from collections.abc import Iterator, Sequence
from functools import cache
from importlib.metadata import version
from pathlib import Path
from types import CodeType

PACKAGE = "brdfatlas"
ROOT = Path(__file__).resolve().parent.parent


def module_path(module: str) -> Path | None:
    """The file of a module of this package, or of a room's ``__init__``; None for what is not ours.

    None also for the package itself and the registry of models, which must not tie every model to every other.
    """
    return None if module in (PACKAGE, f"{PACKAGE}.models") else _modules().get(module)


@cache
def _modules() -> dict[str, Path]:
    """Dotted name -> file of every module of this package."""
    paths = {path: (PACKAGE, *path.relative_to(ROOT).with_suffix("").parts) for path in ROOT.rglob("*.py")}
    return {".".join(parts).removesuffix(".__init__"): path for path, parts in paths.items()}


@cache
def _compiled(path: Path) -> CodeType:
    """The code of a file without docstrings; of a file of the package without assertions too."""
    if path.is_relative_to(ROOT):
        return compile(path.read_bytes(), path.name, "exec", dont_inherit=True, optimize=2)
    tree = ast.parse(path.read_bytes())
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef) and ast.get_docstring(
            node
        ):
            node.body[:1] = [] if len(node.body) > 1 else [ast.Pass()]
    return compile(tree, path.name, "exec", dont_inherit=True)


def _blocks(code: CodeType) -> Iterator[CodeType]:
    """The code of a module and of everything defined in it, at every depth."""
    yield code
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _blocks(constant)


@cache
def imports_of(path: Path) -> tuple[str, ...]:
    """Modules of this package that a file names in its import statements, anywhere in it."""
    names: list[str] = []
    for block in _blocks(_compiled(path)):
        if not any(name == PACKAGE or name.startswith(f"{PACKAGE}.") for name in block.co_names):
            continue
        members: Sequence[str] | None = None
        for instruction in dis.get_instructions(block):
            if instruction.opname == "IMPORT_NAME":
                names.append(instruction.argval)
                names += [f"{instruction.argval}.{member}" for member in members or ()]
            elif instruction.opname == "LOAD_CONST":
                members = instruction.argval if isinstance(instruction.argval, tuple) else None
    return tuple(name for name in names if name.startswith(f"{PACKAGE}."))


def _beside(path: Path) -> Iterator[Path]:
    """Files of its own package, or of its folder, that a model from outside imports, by its import statements."""
    top, own = path.parent, ""  # where the names of absolute imports are looked for, and what they begin with
    while (top / "__init__.py").is_file():
        top, own = top.parent, top.name
    for block in _blocks(_compiled(path)):
        level, members = None, None
        for instruction in dis.get_instructions(block):
            if instruction.opname == "LOAD_CONST":
                level, members = members, instruction.argval
            elif instruction.opname == "IMPORT_NAME":
                parts = instruction.argval.split(".")
                if level:
                    folder = path.parents[min(level, len(path.parents)) - 1]
                elif parts[0] == PACKAGE or (parts[0] != own if own else top.name.endswith("-packages")):
                    continue  # another package's
                else:
                    folder = top
                place = folder.joinpath(*parts)
                for module in (place, *(place / member for member in members or ())):
                    yield from filter(_compiles, (Path(f"{module}.py").resolve(), (module / "__init__.py").resolve()))


def _compiles(path: Path) -> bool:
    try:
        return path.is_file() and bool(_compiled(path))
    except (SyntaxError, ValueError):  # the import says so, if it comes to that
        return False


@cache
def sources_of(*modules: str) -> tuple[Path, ...]:
    """Source files that ``modules`` (dotted names, or paths of model files) depend on, transitively.

    FileNotFoundError for a module that has no file.
    """
    pending: list[Path] = []
    for module in modules:
        path = Path(module) if module.endswith(".py") else module_path(module)
        if path is None or not path.is_file():
            raise FileNotFoundError(f"no source file for {module}")
        pending.append(path.resolve())
    found: set[Path] = set()
    while pending:
        path = pending.pop()
        if path not in found:
            found.add(path)
            pending += [target for name in imports_of(path) if (target := module_path(name))]
            pending += [] if path.is_relative_to(ROOT) else _beside(path)
    return tuple(sorted(found))


def _content(code: CodeType) -> tuple:
    """What a block does: instructions, names and constants; neither its place in the file nor its docstring."""
    names = (code.co_name, code.co_names, code.co_varnames, code.co_freevars, code.co_cellvars)
    arguments = (code.co_argcount, code.co_posonlyargcount, code.co_kwonlyargcount, code.co_flags)
    return code.co_code, names, arguments, tuple(_constant(item) for item in code.co_consts)


def _constant(item: object) -> object:
    if isinstance(item, CodeType):
        return _content(item)
    return sorted(map(repr, item)) if isinstance(item, frozenset) else item  # its own order changes with the process


@cache
def _source_digest(path: Path) -> str:
    return hashlib.sha256(repr((path.name, _content(_compiled(path)))).encode()).hexdigest()


@cache
def _file_digest(path: Path) -> str:
    return hashlib.sha256(path.name.encode() + b"\0" + path.read_bytes()).hexdigest()


def shipped(pattern: str) -> list[Path]:
    """Files of the package that are no modules, by a pattern below its folder: "reports/templates/*.j2"."""
    return sorted(path for path in ROOT.glob(pattern) if not path.name.startswith("."))


@cache
def provenance(*modules: str, libraries: tuple[str, ...] = (), files: tuple[str, ...] = ()) -> str:
    """One line that changes with what a result is made of: "3f0a... numpy 2.2.1, scipy 1.15.0".

    ``modules``: what the job calls (with all that it imports); ``libraries``: distributions whose version counts;
    ``files``: patterns of :func:`shipped` files.
    """
    parts = [_source_digest(path) for path in sources_of(*modules)]
    parts += [_file_digest(path) for pattern in files for path in shipped(pattern)]
    digest = hashlib.sha256("\n".join(parts).encode()).hexdigest()[:16]
    return f"{digest} {', '.join(f'{name} {version(name)}' for name in libraries)}".strip()
