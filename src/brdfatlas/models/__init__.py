"""The registry: every model by name, imported when it is asked for.

A model from outside joins by an entry point in the group ``brdfatlas.models`` (name = "package.module:Class"), or by
``source: path/to/model.py`` in config/models.yaml.
"""

import importlib
import importlib.util
import inspect
import json
import os
import traceback
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import cache
from importlib.metadata import entry_points
from pathlib import Path

from brdfatlas.models.base import FitError, Model

#: name -> module; the order is that of tables and pages.
BUILTIN = {
    "tabulated": "brdfatlas.models.dupuy2015.tabulated",
    "gaussian": "brdfatlas.models.dupuy2015.gaussian",
    "ggx": "brdfatlas.models.dupuy2015.ggx",
    "sgd": "brdfatlas.models.sgd",
    "abc": "brdfatlas.models.single_lobe.abc",
    "abc_compressive": "brdfatlas.models.single_lobe.abc_compressive",
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
    "low_rank_2": "brdfatlas.models.bagher2016.low_rank_2",
    "low_rank_4": "brdfatlas.models.bagher2016.low_rank_4",
}


#: What a class must say of its model, beside ``fit`` and ``evaluate``.
STATED = ("name", "title", "paper", "equations", "formula", "parameters")


def _classes(module) -> list[type[Model]]:
    """The models that a module defines itself."""
    return [
        item
        for item in vars(module).values()
        if inspect.isclass(item)
        and issubclass(item, Model)
        and not inspect.isabstract(item)
        and item.__module__ == module.__name__
    ]


def _only_model(module, origin: str, name: str | None = None) -> type[Model]:
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

    ``sys.exit`` is one of them: it would end the program with whatever status the model names.
    """
    try:
        yield
    except (Exception, SystemExit) as error:
        lines = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == file]
        if isinstance(error, SyntaxError) and error.filename == file:
            lines = [error.lineno]
        place = f"line {lines[-1]}: " if lines else ""
        message = error.msg if isinstance(error, SyntaxError) else str(error)
        raise ImportError(" ".join(f"{origin}: {place}{type(error).__name__}: {message}".split())) from error


def _load_file(path: Path):
    """The module in a Python file outside the package. ImportError names the file and what is wrong with it."""
    if not path.is_file():
        raise ImportError(f"{path}: {'not a regular file' if path.exists() else 'no such model file'}")
    if path.suffix != ".py":
        raise ImportError(f"{path}: a model's file ends in .py; rename it")
    spec = importlib.util.spec_from_file_location(f"brdfatlas_user_{path.stem}", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    with _loading(str(path), str(spec.origin)):
        spec.loader.exec_module(module)
    return module


def load_model_file(path: str | Path, name: str | None = None) -> Model:
    """The model in a Python file outside the package. ImportError names the file and what is wrong with it."""
    module = _load_file(Path(path))
    model = _only_model(module, str(path), name)
    with _loading(str(path), module.__file__ or ""):
        return model()


@contextmanager
def own_faults(model: Model, material: str) -> Iterator[None]:
    """Any fault in the code of a model from outside as FitError: one line with its place in the model's file."""
    file = getattr(getattr(model.fit, "__code__", None), "co_filename", "")
    try:
        yield
    except (MemoryError, OSError, FitError):
        raise
    except (Exception, SystemExit) as error:
        if type(model).__module__.startswith("brdfatlas."):
            raise
        lines = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == file]
        place = f"{file}: line {lines[-1]}: " if lines else ""
        message = " ".join(f"{place}{type(error).__name__}: {error}".split())
        raise FitError(f"{model.name} on {material}: {message}") from error


#: Environment variable with a JSON object, name -> file of a model: a run tells every job it starts of its own models.
VARIABLE = "BRDFATLAS_MODELS"


class Registry(Mapping[str, Model]):
    """Models by name; ``register_file`` adds one from a path for this process."""

    __hash__ = object.__hash__  # Mapping defines __eq__ and drops the hash that @cache needs

    def __init__(self) -> None:
        self._files = {name: Path(path) for name, path in json.loads(os.environ.get(VARIABLE) or "{}").items()}

    def register_file(self, name: str, path: str | Path) -> None:
        self._files[name] = Path(path)
        self._load.cache_clear()

    def register_source(self, path: str | Path) -> None:
        """Every model of a Python file, for this process. ImportError names the file and what is wrong with it."""
        names = [getattr(model, "name", None) for model in _classes(_load_file(Path(path)))]
        if not names:
            raise ImportError(f"{path}: defines no Model class")
        for name in filter(None, names):
            self.register_file(name, path)

    def _external(self) -> dict[str, str]:
        return {point.name: point.value for point in entry_points(group="brdfatlas.models")}

    def __iter__(self) -> Iterator[str]:
        return iter(dict.fromkeys([*BUILTIN, *self._external(), *self._files]))

    def __len__(self) -> int:
        return len(list(iter(self)))

    @cache  # noqa: B019 (one registry a process)
    def _load(self, name: str) -> Model:
        if name in self._files:
            return load_model_file(self._files[name], name)
        if name in BUILTIN:
            return _only_model(importlib.import_module(BUILTIN[name]), BUILTIN[name], name)()
        for point in entry_points(group="brdfatlas.models"):
            if point.name == name:
                with _loading(point.value):
                    return point.load()()
        raise KeyError(f"unknown model {name!r}; known: {', '.join(self)}")

    def __getitem__(self, name: str) -> Model:
        return self._load(name)


MODELS = Registry()
