"""A fit: a model with numbers. After this point nothing knows which model it was."""

import json
import os
import stat
import time
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from brdfatlas.angles import GRID_SHAPE, above_horizon
from brdfatlas.files import check_regular, plain, read_npz, shown, write_npz
from brdfatlas.measured import Measured
from brdfatlas.models import MODELS, own_faults
from brdfatlas.models.base import FitError, Model, Result, numbers

#: Most bytes that a fit may have: several times a table with a number of its own for every cell of the grid.
MOST_BYTES = 2**28


@dataclass(frozen=True)
class Fit:
    """A fitted model: evaluates itself anywhere and puts itself on the MERL grid.

    ``parameters`` have the types of the model's storage: what is evaluated is what is stored. ``report`` says how
    the fit was found (objective, iterations, seconds, converged, message, details); it is not saved with the fit,
    so that equal fits are equal files.
    """

    model: str
    material: str
    parameters: Mapping[str, np.ndarray]
    options: Mapping[str, Any] = field(default_factory=dict)
    standin: bool = False
    report: Mapping[str, Any] = field(default_factory=dict, compare=False)

    @property
    def bytes(self) -> int:
        """Storage of the parameters in bytes."""
        return sum(array.nbytes for array in self.parameters.values())

    def evaluate(self, wi, wo) -> np.ndarray:
        """rgb (..., 3) in 1/sr at unit vectors (..., 3); 0 where one direction is below the surface, NaN where one is
        not finite."""
        wi, wo = np.broadcast_arrays(np.asarray(wi, float), np.asarray(wo, float))
        finite = (np.isfinite(wi) & np.isfinite(wo)).all(-1, keepdims=True)
        if not finite.all():  # compiled look-ups take directions as indices
            wi, wo = (np.where(finite, w, [0.0, 0.0, 1.0]) for w in (wi, wo))
        model = MODELS[self.model]
        with np.errstate(all="ignore"), own_faults(model, self.material):
            rgb = numbers(model.evaluate(self.parameters, wi, wo))
            if rgb.shape != wi.shape:
                raise ValueError(f"evaluate gives shape {rgb.shape} for directions {wi.shape}")
        rgb = np.where(((wi[..., 2] > 0) & (wo[..., 2] > 0))[..., None], rgb, 0.0)
        return np.where(finite, rgb, np.nan)

    def table(self) -> np.ndarray:
        """The fit at the cell centres of the MERL grid, (90, 90, 180, 3) float32, NaN below the horizon."""
        model = MODELS[self.model]
        with own_faults(model, self.material):
            table = np.array(numbers(model.evaluate_grid(self.parameters)), np.float32, copy=True)
            if table.shape != (*GRID_SHAPE, 3):
                raise ValueError(f"evaluate_grid gives shape {table.shape}, not {(*GRID_SHAPE, 3)}")
        table[~above_horizon()] = np.nan
        return table

    def save(self, path: str | os.PathLike) -> None:
        """Write as npz without pickle; equal fits give equal bytes."""
        labels = {"model": self.model, "material": self.material}
        options = {f"option/{key}": np.array(value) for key, value in self.options.items()}
        arrays = {f"parameter/{key}": value for key, value in self.parameters.items()}
        meta = {key: np.array(value) for key, value in labels.items()} | {"standin": np.array(self.standin)}
        write_npz(path, meta | options | arrays)


def is_fit_file(path: str | os.PathLike) -> bool:
    """Whether a file is a fit and no ``.binary``: by its ending, else by its first bytes (npz is a zip archive)."""
    if str(path).endswith(".npz"):
        return True
    try:
        if not stat.S_ISREG(os.stat(path).st_mode):
            return False
        with open(path, "rb") as handle:
            return handle.read(2) == b"PK"
    except OSError:
        return False


def load_fit(path: str | os.PathLike) -> Fit:
    """Read a fit and check it against its model. ValueError names the file if it is not one."""
    name = shown(path)
    try:
        if check_regular(path).stat().st_size == 0:
            raise ValueError("empty, the mark of a fit that failed; fit again")
        fitted = _fit_of(read_npz(path, most_bytes=MOST_BYTES))
    except FileNotFoundError:
        raise ValueError(f"{name}: no such fit") from None
    except OSError as error:
        raise ValueError(f"{name}: cannot be read ({error.strerror or error})") from None
    except ValueError as error:
        raise ValueError(f"{name}: not a brdfatlas fit ({str(error).removeprefix(f'{name}: ')})") from None
    check_fit(fitted, path)
    return fitted


def _fit_of(store: dict[str, np.ndarray]) -> Fit:
    """The fit in the arrays of an npz file. ValueError if they are none."""
    kinds = {"model": "U", "material": "U", "standin": "b"}
    for key, kind in kinds.items():
        if key not in store or store[key].dtype.kind != kind or store[key].ndim:
            raise ValueError(f"it does not state its {key}")
    parts: dict[str, dict[str, np.ndarray]] = {"parameter": {}, "option": {}}
    for key in (key for key in store if key not in kinds):
        part, _, rest = key.partition("/")
        if part not in parts:
            raise ValueError(f"it holds {shown(key)}, which belongs to no fit")
        parts[part][rest] = store[key]
    if any(value.ndim for value in parts["option"].values()):
        raise ValueError("an option is an array")
    options = {key: value.item() for key, value in parts["option"].items()}
    return Fit(str(store["model"]), str(store["material"]), parts["parameter"], options, bool(store["standin"]))


def check_fit(fitted: Fit, path: str | os.PathLike) -> None:
    """Check what was read from ``path`` against what its model states of itself: options, names, types, shapes, ranges.

    Raises ValueError, one line that names the file and the first fault.
    """
    name = shown(path)
    try:
        model = MODELS[fitted.model]
    except KeyError:
        known = f"the model {shown(fitted.model)!r} is not known here"
        raise ValueError(f"{name}: {known}; if it is one of your own, give its file as source") from None
    try:
        options = model.check_options(fitted.options)
    except ValueError as error:
        raise ValueError(f"{name}: damaged, or of another version ({error})") from None
    fault = fault_of(model, fitted.parameters, options)
    if fault:
        raise ValueError(f"{name}: damaged, or of another version of {model.name}: {fault}; fit again")
    if not 0 < len(fitted.material) < 256 or not fitted.material.isprintable():
        raise ValueError(f"{name}: damaged, {fitted.material[:80]!r} is no name of a material; fit again")


def fault_of(model: Model, parameters: Mapping[str, np.ndarray], options: Mapping[str, Any]) -> str:
    """What is wrong with the parameters of a fit, in words; "" if they are what the model states."""
    stated = model.parameters_of(options)
    if parameters.keys() != {parameter.name for parameter in stated}:
        return f"it holds {', '.join(sorted(parameters)) or 'nothing'}, not {', '.join(p.name for p in stated)}"
    for parameter in stated:
        array = parameters[parameter.name]
        if array.dtype != np.dtype(parameter.dtype):
            return f"{parameter.name} is {array.dtype}, not {parameter.dtype}"
        if array.ndim != len(parameter.shape) or array.size == 0:
            return f"{parameter.name} has shape {array.shape}"
        if not np.isfinite(array).all():
            return f"{parameter.name} is not finite"
    fault = model.shape_fault(parameters, options)
    if fault:
        return fault
    for parameter in stated:
        array, bound = parameters[parameter.name], np.dtype(parameter.dtype).type
        if (array < bound(parameter.low)).any() or (array > bound(parameter.high)).any():
            return f"{parameter.name} is not within {parameter.low:g} to {parameter.high:g}"
    return ""


def _stored(model: Model, result: Result, material: str) -> dict[str, np.ndarray]:
    """The parameters of a result in the types of the model's storage. FitError if one is missing or not finite."""
    parameters = {}
    for parameter in model.parameters:
        if parameter.name not in result.parameters:
            raise FitError(f"{model.name} on {material}: the fit returns no {parameter.name}, which the model states")
        array = np.asarray(result.parameters[parameter.name], parameter.dtype)
        if not model.variable_size:
            array = array.reshape(parameter.shape)
        if not np.isfinite(array).all():
            raise FitError(f"{model.name} on {material}: {parameter.name} is not finite ({result.message})")
        parameters[parameter.name] = array
    return parameters


def fit(model: str | Model, measured: Measured, seed: int = 0, **options: Any) -> Fit:
    """Fit ``model`` (a name or a Model) to a material. The model gets a read-only table.

    Raises KeyError for an unknown model, ValueError for an unknown option, FitError where the model has no finite
    fit for this material, or where the code of a model from outside the package fails.
    """
    model = MODELS[model] if isinstance(model, str) else model
    chosen = model.check_options(options)
    table = measured.table.view()
    table.flags.writeable = False
    start = time.perf_counter()
    with np.errstate(all="ignore"), own_faults(model, measured.name):
        result = model.fit(replace(measured, table=table), seed=seed, **chosen)
        seconds = time.perf_counter() - start
        parameters = _stored(model, result, measured.name)
        report = {
            "objective": float(result.objective),
            "objective_name": str(result.objective_name),
            "iterations": int(result.iterations),
            "converged": bool(result.converged),
            "message": str(result.message),
            "seconds": seconds,
            "seed": seed,
            "bytes": sum(array.nbytes for array in parameters.values()),
            "details": result.details,
        }
    try:
        json.dumps(plain(report["details"]))
    except (TypeError, ValueError, RecursionError) as error:
        raise FitError(f"{model.name} on {measured.name}: details cannot be written as JSON ({error})") from None
    return Fit(model.name, measured.name, parameters, chosen, measured.standin, report)
