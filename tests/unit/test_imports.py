"""The rooms of the package and the one way in which they import each other."""

import ast
import graphlib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2] / "src" / "brdfatlas"
#: A room imports from rooms below it, and from its own. Names without a folder are modules of the root.
LAYERS = (
    ("constants", "compiled", "angles", "microfacet", "settings", "files", "interrupts"),
    ("formats", "measured"),
    ("solvers", "objectives", "sampling"),
    ("models",),
    ("fits",),
    ("rendering", "measures"),
    ("cli", "pipeline", "reports", "figures", "export", "recommend", "__main__"),
)
LEVEL = {room: level for level, rooms in enumerate(LAYERS) for room in rooms}


def name_of(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


MODULES = {name_of(path): path for path in sorted(ROOT.rglob("*.py"))}


def imports_of(path: Path, *, everywhere: bool) -> set[str]:
    """Modules of the package that a file imports, without "brdfatlas."; ``everywhere``: in its functions too."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    nodes = ast.walk(tree) if everywhere else iter(tree.body)
    found = set()
    for node in nodes:
        names: list[str] = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module:
            names = [f"{node.module}.{alias.name}" for alias in node.names]
        for name in names:
            if name.split(".")[0] == "brdfatlas":
                inner = name.removeprefix("brdfatlas").removeprefix(".")
                found.add(inner if inner in MODULES else inner.rpartition(".")[0])
    return found - {""}


@pytest.mark.parametrize("name", [name for name in MODULES if name])
def test_imports_go_one_way(name):
    """Also those inside functions."""
    own = name.split(".")[0]
    for other in imports_of(MODULES[name], everywhere=True):
        room = other.split(".")[0]
        assert room == own or LEVEL[room] <= LEVEL[own], f"{name} imports {other}"


def test_there_is_no_circle():
    graph = {name: imports_of(path, everywhere=True) - {name} for name, path in MODULES.items() if name}
    try:
        list(graphlib.TopologicalSorter(graph).static_order())
    except graphlib.CycleError as error:
        pytest.fail(f"a circle: {' -> '.join(error.args[1])}")


def test_solvers_know_no_model():
    for name, path in MODULES.items():
        if name.split(".")[0] in ("solvers", "objectives", "sampling"):
            assert not {other for other in imports_of(path, everywhere=True) if other.startswith(("models", "fits"))}


def test_functions_are_of_a_size_to_be_read():
    long = [
        f"{path.name}: {node.name}"
        for path in ROOT.rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) and node.end_lineno - node.lineno >= 60
    ]
    assert long == []
