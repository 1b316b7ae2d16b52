"""Classes of models by name: those of the package, of installed packages and of files outside any package."""

import importlib
import importlib.util
import inspect
import os
import sys
import traceback
from collections.abc import Iterator, Mapping
from contextlib import chdir, contextmanager, nullcontext
from functools import cache
from importlib.metadata import entry_points
from numbers import Integral, Real
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from brdfatlas.models import own
from brdfatlas.models.base import FitError, Model, Option, Paper, Parameter
from brdfatlas.models.own import module_of

#: name of a class -> its module.
BUILTIN = {
    "tabulated": "brdfatlas.models.dupuy2015.tabulated",
    "gaussian": "brdfatlas.models.dupuy2015.gaussian",
    "ggx": "brdfatlas.models.dupuy2015.ggx",
    "sgd": "brdfatlas.models.sgd",
    "abc": "brdfatlas.models.single_lobe.abc",
    "ngan": "brdfatlas.models.single_lobe.ngan",
    "ashikhmin_shirley": "brdfatlas.models.three_lobe.ashikhmin_shirley",
    "cook_torrance": "brdfatlas.models.three_lobe.cook_torrance",
    "edwards": "brdfatlas.models.three_lobe.edwards",
    "ward": "brdfatlas.models.three_lobe.ward",
    "ward_duer": "brdfatlas.models.three_lobe.ward_duer",
    "lawrence": "brdfatlas.models.factorised.lawrence",
    "tucker": "brdfatlas.models.factorised.tucker",
    "naive": "brdfatlas.models.bagher2016.naive",
    "g_from_d": "brdfatlas.models.bagher2016.g_from_d",
    "independent_g": "brdfatlas.models.bagher2016.independent_g",
    "bivariate": "brdfatlas.models.bagher2016.bivariate",
    "bivariate_g": "brdfatlas.models.bagher2016.bivariate_g",
    "low_rank": "brdfatlas.models.bagher2016.low_rank",
    "lambert": "brdfatlas.models.engine.lambert",
    "ggx_diffuse": "brdfatlas.models.engine.ggx_diffuse",
    "ggx2_diffuse": "brdfatlas.models.engine.ggx2_diffuse",
    "gltf": "brdfatlas.models.engine.gltf",
    "principled": "brdfatlas.models.engine.principled",
    "openpbr": "brdfatlas.models.engine.openpbr",
}
#: The group of entry points by which an installed package offers models, name = "package.module:Class".
GROUP = "brdfatlas.models"
#: What a class must say of its model, beside ``fit`` and ``evaluate``, and its type.
STATED = {"name": str, "title": str, "paper": Paper, "equations": str, "formula": str, "parameters": tuple}
#: What it may say beside.
TRUTH, SEVERAL = bool | np.bool_, tuple | list
OPTIONAL = {"status": str, "reciprocal": TRUTH, "variable_size": TRUTH, "public_names": Mapping, "targets": SEVERAL}
OPTIONAL |= dict.fromkeys(("bytes", "least_bytes", "free_parameters"), Integral)
WORDS = {TRUTH: "bool", SEVERAL: "tuple", Integral: "whole number"}


def installed_models() -> dict[str, str]:
    """Models of installed packages, name -> "package.module:Class"."""
    return {point.name: point.value for point in entry_points(group=GROUP)}


def load_model(name: str, source: str | Path | None = None) -> Model:
    """The model whose class has this name, with the options' defaults; ``source``: the file that holds the class.

    KeyError for a name that nobody knows, ImportError for a file or a package that cannot be used.
    """
    if source:
        path = Path(source)
        if not path.is_file():
            return load_model_file(path, name)  # which says what is wrong
        return _from_file(path, name, path.stat().st_mtime_ns)
    return _by_name(name)


def check_model_file(path: str | Path) -> None:
    """ImportError unless a Python file can be used and holds a model."""
    if not _classes(_module_of(path)):
        raise ImportError(f"{path}: holds no Model class")


def _module_of(path: str | Path) -> ModuleType:
    path = Path(path)
    if not path.is_file():
        raise ImportError(f"{path}: {'not a regular file' if path.exists() else 'no such model file'}")
    if path.suffix != ".py":
        raise ImportError(f"{path}: a model's file ends in .py; rename it")
    spec = importlib.util.spec_from_file_location(module_of(path), path)
    assert spec is not None
    assert spec.loader is not None
    module = sys.modules[spec.name] = importlib.util.module_from_spec(spec)  # dataclasses and pickle look there
    with _loading(str(path), str(spec.origin)):
        spec.loader.exec_module(module)
    return module


def load_model_file(path: str | Path, name: str | None = None) -> Model:
    """The model in a Python file outside the package. ImportError names the file and what is wrong with it."""
    module = _module_of(path)
    model = _only_model(module, str(path), name)
    with _loading(str(path), str(module.__file__)):
        return _checked(model())


@cache
def _from_file(path: Path, name: str, _time: int) -> Model:
    """A fit evaluates often: the file is read once, and again when it changes."""
    return load_model_file(path, name)


def _by_name(name: str) -> Model:
    if name in BUILTIN:
        return _only_model(importlib.import_module(BUILTIN[name]), BUILTIN[name], name)()
    for point in entry_points(group=GROUP):
        if point.name == name:
            with _loading(point.value):
                return _checked(point.load()())
    raise KeyError(f"unknown model {name!r}; known: {', '.join([*BUILTIN, *installed_models()])}")


def _checked(model: Model) -> Model:
    """``model``, if what it states is of its type: pages, fits and exports rely on that. TypeError or ValueError."""
    for name, kind in (STATED | OPTIONAL).items():
        value = getattr(model, name)
        if not isinstance(value, kind):
            raise TypeError(f"{name} is a {type(value).__name__}, not a {WORDS.get(kind) or kind.__name__}")
        if isinstance(value, str) and not _is_text(value):
            raise ValueError(f"{name} {value!a} is no text that a page can show")
    names = [parameter.name for parameter in model.parameters if isinstance(parameter, Parameter)]
    if not names or len(names) != len(model.parameters) or len(set(names)) != len(names):
        raise TypeError("parameters is no tuple of Parameter, each of another name")
    if not all(isinstance(key, str) and isinstance(option, Option) for key, option in dict(model.options).items()):
        raise TypeError("options is no mapping of names to Option")
    for key, option in model.options.items():  # a fit stores their values
        if not isinstance(option.default, str | Real | np.bool_) or option.fault(option.default):
            raise ValueError(
                f"option {key}: its default {option.default!r} is no text, number or choice that it allows"
            )
    if "seed" in model.options:
        raise ValueError("an option called seed, which every fit has; rename it")
    _check_told(model, {})
    return model


def _is_text(value: str) -> bool:
    """Whether a file can hold it: half a surrogate pair is no character."""
    return not any("\ud800" <= c <= "\udfff" for c in value)


def _check_told(model: Model, options: Mapping[str, Any]) -> None:
    """TypeError unless what a model says of itself with these options, in every page of a run, is of its type."""
    chosen = model.check_options(options)
    title = model.title_of(chosen)
    if not isinstance(title, str) or not _is_text(title):
        raise TypeError("title_of gives no text that a page can show")
    stated = model.parameters_of(chosen)
    if not isinstance(stated, tuple) or not all(isinstance(item, Parameter) for item in stated):
        raise TypeError("parameters_of gives no tuple of Parameter")


def with_options(model: Model, options: Mapping[str, Any]) -> Model:
    """``model.with_options(options)``. ValueError for a wrong option, ImportError for a fault in the code of a
    model from outside, which may choose its title and its parameters by them."""
    model.check_options(options)
    if is_ours(model):
        return model.with_options(options)
    file = inspect.getfile(type(model))
    with _loading(file, file):
        _check_told(model, options)
        chosen = model.with_options(options)
        if not isinstance(chosen, Model):
            raise TypeError(f"with_options gives a {type(chosen).__name__}, not a Model")
        return chosen


def _classes(module: ModuleType) -> list[type[Model]]:
    return [
        item
        for item in vars(module).values()
        if inspect.isclass(item)
        and issubclass(item, Model)
        and not inspect.isabstract(item)
        and item.__module__ == module.__name__
    ]


def _only_model(module: ModuleType, origin: str, name: str | None = None) -> type[Model]:
    classes = _classes(module)
    found = [item for item in classes if name is None or getattr(item, "name", None) == name]
    for item in found or classes:
        for attribute in STATED:
            if not hasattr(item, attribute):
                raise ImportError(f"{origin}: class {item.__name__} states no {attribute}")
    if len(found) != 1:
        wanted = f"named {name!r}" if name else "and no more"
        raise ImportError(f"{origin}: expected one Model class {wanted}, found {len(found)}")
    return found[0]


@contextmanager
def _loading(origin: str, file: str = "") -> Iterator[None]:
    """Any fault in the code of a model from outside as ImportError: one line, with the number of that in ``file``.

    Every exception but Ctrl-C is one, ``sys.exit`` too, which would end the program with whatever status the model
    names. Code that goes elsewhere takes no relative path with it.
    """
    try:
        with chdir("."):
            yield
    except KeyboardInterrupt:
        raise
    except BaseException as error:
        lines = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == file]
        if isinstance(error, SyntaxError) and error.filename == file:
            lines = [error.lineno]
        place = f"line {lines[-1]}: " if lines else ""
        message = error.msg if isinstance(error, SyntaxError) else _words(error)
        raise ImportError(" ".join(f"{origin}: {place}{type(error).__name__}: {message}".split())) from error


def is_ours(model: Model) -> bool:
    """Whether a model's class is of this package."""
    module = type(model).__module__
    return module.startswith("brdfatlas.") and not module.startswith(f"{own.__name__}.")


@contextmanager
def own_faults(model: Model, material: str) -> Iterator[None]:
    """Any fault in the code of a model from outside as FitError: one line with its place in the model's file. Code that
    goes to another folder takes no relative path with it."""
    file = getattr(getattr(model.fit, "__code__", None), "co_filename", "")
    try:
        with nullcontext() if is_ours(model) else chdir("."):
            yield
    except (MemoryError, OSError, FitError, KeyboardInterrupt):
        raise
    except BaseException as error:
        if is_ours(model):
            raise
        lines = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == file]
        # pages show the reason: where a project lies on this machine is nobody's business
        near = os.path.relpath(file) if Path(file).is_relative_to(os.path.abspath(".")) else file
        place = f"{near}: line {lines[-1]}: " if lines else ""
        message = " ".join(f"{place}{type(error).__name__}: {_words(error)}".split())
        # contextlib takes a RuntimeError with this cause for Python's own, and lets the cause through
        cause = None if isinstance(error, StopIteration) else error
        raise FitError(f"{model.name} on {material}: {message}") from cause


def _words(error: BaseException) -> str:
    """The text of an exception of others, whose ``__str__`` may fail."""
    try:
        return str(error)
    except Exception:
        return "an exception without a text"
