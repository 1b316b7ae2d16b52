"""Every public name of the reference says what it gives, in which shape, and which errors it raises."""

import ast
import importlib
import inspect
import re
import textwrap
from collections.abc import Iterator
from functools import cached_property
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).parents[2]
MODULES = re.findall(r"^::: (\S+)", (ROOT / "docs" / "reference.md").read_text(), re.M)
#: How a text states a shape: (..., 3), (90,), (h, w), "any shape".
SHAPE = re.compile(
    r"\(\.\.\.\)|\((\.\.\.|\d+|[a-z]|batches|size),( ?(\.\.\.|\d+|[a-z]|batches|size),?)*\)|\bshape\b|GRID_SHAPE"
)
#: An array itself, not a mapping of arrays nor a function of them.
ARRAY = re.compile(r"^(tuple\[)?(np|numpy)\.ndarray|^<class 'numpy\.ndarray'>")


def function_of(item: object) -> object:
    """The function behind a method, a property or a class method."""
    if isinstance(item, cached_property):
        return item.func
    return item.fget if isinstance(item, property) else getattr(item, "__func__", item)


def public() -> Iterator[tuple[str, object, str]]:
    """(name, class or function, its text) of what the reference lists; a method's text may be that of its base."""
    for module in map(importlib.import_module, MODULES):
        names = getattr(module, "__all__", None) or [name for name in vars(module) if not name.startswith("_")]
        for name in names:
            item = getattr(module, name)
            own = hasattr(module, "__all__") or getattr(item, "__module__", "") == module.__name__
            if not own or not (inspect.isclass(item) or inspect.isfunction(item)):
                continue
            yield f"{module.__name__}.{name}", item, item.__doc__ or ""
            for key, member in vars(item).items() if inspect.isclass(item) else ():
                function = function_of(member)
                if not key.startswith("_") and inspect.isfunction(function):
                    text = inspect.getdoc(function) or inspect.getdoc(getattr(item, key)) or ""
                    yield f"{module.__name__}.{name}.{key}", function, text


def raised(function: object) -> set[str]:
    """Names of the errors that a function itself raises."""
    tree = ast.parse(textwrap.dedent(inspect.getsource(function)))
    calls = [node.exc for node in ast.walk(tree) if isinstance(node, ast.Raise) and isinstance(node.exc, ast.Call)]
    return {call.func.attr if isinstance(call.func, ast.Attribute) else call.func.id for call in calls}


def faults(item: object, text: str) -> list[str]:
    if not text.strip():
        return ["no docstring"]
    if inspect.isclass(item):
        return []
    missing = [f"{error} is raised and not said" for error in raised(item) if error not in text]
    arrays = [name for name, kind in item.__annotations__.items() if ARRAY.match(str(kind))]
    return missing + ([f"no shape of {', '.join(arrays)}"] if arrays and not SHAPE.search(text) else [])


def test_the_reference_states_shapes_and_errors():
    listed = list(public())
    assert len(listed) > 100
    found = {name: fault for name, item, text in listed if (fault := faults(item, text))}
    assert not found, "\n".join(f"{name}: {'; '.join(fault)}" for name, fault in found.items())


def silent():
    pass


def shapeless(table: np.ndarray) -> float:
    """The mean."""


def unsaid(number: int) -> int:
    """The number."""
    raise ValueError(number)


@pytest.mark.parametrize(("item", "fault"), [(silent, "no docstring"), (shapeless, "no shape"), (unsaid, "ValueError")])
def test_a_name_that_states_less_is_found(item, fault):
    assert any(fault in each for each in faults(item, item.__doc__ or ""))
