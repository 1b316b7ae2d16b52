"""A fit: a model with numbers. After this point nothing knows which model it was."""

import os
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numba.core.event import TimingListener, install_listener

from brdfatlas.angles import above_horizon
from brdfatlas.files import read_npz, write_npz
from brdfatlas.measured import Measured
from brdfatlas.models import MODELS, Entry, load_model
from brdfatlas.models.base import Factors, FitError, Function, Model, Result
from brdfatlas.models.given import outside_range, read_parameters
from brdfatlas.sampling import Sampler


@dataclass(frozen=True, eq=False)
class Fit:
    """A fitted model: evaluates itself anywhere and puts itself on the MERL grid.

    ``model`` is the name of the model's class (or of an entry), ``entry`` the row of the run, ``source`` the file of a
    model that is not part of a package. ``parameters`` have the types of the model's storage: what is evaluated is what
    is stored. ``report`` says how the fit was found (objective, iterations, seconds, converged, message, details); it
    is not saved with the fit, so that equal fits are equal files.
    """

    model: str
    material: str
    parameters: Mapping[str, np.ndarray]
    options: Mapping[str, Any] = field(default_factory=dict)
    standin: bool = False
    report: Mapping[str, Any] = field(default_factory=dict)
    entry: str = ""
    source: str | None = None

    def __post_init__(self) -> None:
        if not self.entry:
            object.__setattr__(self, "entry", self.model)

    def __eq__(self, other: object) -> bool:
        """Whether both would be saved as equal files; how they were found does not count."""
        if not isinstance(other, Fit):
            return NotImplemented
        told = ("model", "material", "options", "standin", "entry", "source")
        return (
            all(getattr(self, name) == getattr(other, name) for name in told)
            and self.parameters.keys() == other.parameters.keys()
            and all(_same(array, other.parameters[name]) for name, array in self.parameters.items())
        )

    def __hash__(self) -> int:
        return hash((self.entry, self.model, self.material))

    @cached_property
    def instance(self) -> Model:
        """The model itself. KeyError or ImportError where it cannot be found."""
        return load_model(self.model, self.source) if self.source else MODELS[self.model]

    @property
    def bytes(self) -> int:
        """Storage of the parameters in bytes."""
        return sum(array.nbytes for array in self.parameters.values())

    def evaluate(self, wi, wo) -> np.ndarray:
        """rgb (..., 3) in 1/sr at unit vectors (..., 3); 0 where one direction is below the surface."""
        wi, wo = np.broadcast_arrays(np.asarray(wi, float), np.asarray(wo, float))
        seen = (wi[..., 2] > 0) & (wo[..., 2] > 0)
        if seen.all():
            return np.asarray(self.instance.evaluate(self.parameters, wi, wo))
        rgb = np.zeros(wi.shape)
        if seen.any():
            rgb[seen] = self.instance.evaluate(self.parameters, wi[seen], wo[seen])
        return rgb

    def table(self) -> np.ndarray:
        """The fit at the cell centres of the MERL grid, (90, 90, 180, 3) float32, NaN below the horizon."""
        table = np.array(self.instance.evaluate_grid(self.parameters), np.float32, copy=True)
        table[~above_horizon()] = np.nan
        return table

    def sampler(self) -> Sampler | None:
        """The importance sampler of the fit; None for a model without a sampling procedure."""
        return self.instance.sampler(self.parameters)

    def functions(self) -> tuple[Function, ...]:
        """The named functions of the fit, none for a model that has none."""
        return self.instance.functions(self.parameters)

    def factors(self) -> Factors | None:
        """The fit as a sum of products; None for a model that is none."""
        return self.instance.factors(self.parameters)

    def save(self, path: str | os.PathLike) -> None:
        """Write as npz without pickle; equal fits give equal bytes."""
        labels = {"model": self.model, "material": self.material}
        labels |= {"entry": self.entry} if self.entry != self.model else {}
        labels |= {"source": self.source} if self.source else {}
        options = {f"option/{key}": np.array(value) for key, value in self.options.items()}
        arrays = {f"parameter/{key}": value for key, value in self.parameters.items()}
        meta = {key: np.array(value) for key, value in labels.items()} | {"standin": np.array(self.standin)}
        write_npz(path, meta | options | arrays)


def _same(a, b) -> bool:
    a, b = np.asarray(a), np.asarray(b)
    return a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes()


def is_fit_file(path: str | os.PathLike) -> bool:
    """Whether a file is a fit and no ``.binary``: by its ending, else by its first bytes (npz is a zip archive)."""
    if str(path).endswith(".npz"):
        return True
    try:
        with open(path, "rb") as handle:
            return handle.read(2) == b"PK"
    except OSError:
        return False


def load_fit(path: str | os.PathLike, source: str | os.PathLike | None = None) -> Fit:
    """Read a fit. ``source``: where the file of its model is now, for a model of one's own whose file has moved.

    ValueError names the file if it is not a fit, or if its model cannot be found.
    """
    try:
        store = read_npz(path)
        parameters = {k.removeprefix("parameter/"): v for k, v in store.items() if k.startswith("parameter/")}
        options = {k.removeprefix("option/"): v.item() for k, v in store.items() if k.startswith("option/")}
        labels = {key: str(store[key]) for key in ("model", "material", "entry", "source") if key in store}
        if source:
            labels["source"] = str(source)
        fitted = Fit(parameters=parameters, options=options, standin=bool(store["standin"]), **labels)
    except FileNotFoundError:
        raise ValueError(f"{path}: no such fit") from None
    except Exception as error:
        raise ValueError(f"{path}: not a brdfatlas fit ({type(error).__name__}: {error})") from None
    try:
        _ = fitted.instance
    except (KeyError, ImportError) as error:
        reason = f"its model {fitted.model!r} cannot be used ({error.args[0]})"
        raise ValueError(f"{path}: {reason}; say where the model's file is: source=FILE.py, or --source") from None
    return fitted


def fit(model: str | Entry | Model, measured: Measured, seed: int = 0, **options: Any) -> Fit:
    """Fit ``model`` (a name, an entry or a Model) to a material; ``options`` stand over those of the entry.

    An entry with given parameters is not fitted: its row holds those of the material (:mod:`.models.given`).
    ``report["seconds"]`` leaves out what the first fit of an installation spends on compiling kernels.

    Raises KeyError for an unknown model, ValueError for an unknown option, FitError where the model has no finite
    fit for this material, ParameterFileError where its parameters are to be given and are not.
    """
    if isinstance(model, Model):
        entry = Entry(model.name, model.name)
    else:
        entry = MODELS.entry(model) if isinstance(model, str) else model
        model = entry.instance
    chosen = model.check_options(options)
    compiling = TimingListener()
    start = time.perf_counter()
    with install_listener("numba:compile", compiling):
        result = _given(entry, model, measured) if entry.parameters else model.fit(measured, seed=seed, **chosen)
    seconds = time.perf_counter() - start - (compiling.duration if compiling.done else 0.0)
    parameters = {}
    for parameter in model.parameters_of(chosen):
        array = np.asarray(result.parameters[parameter.name], parameter.dtype)
        if not model.variable_size:
            array = array.reshape(parameter.shape)
        if not np.isfinite(array).all():
            raise FitError(f"{entry.name} on {measured.name}: {parameter.name} is not finite ({result.message})")
        parameters[parameter.name] = array
    report = {
        "objective": float(result.objective),
        "objective_name": result.objective_name,
        "iterations": int(result.iterations),
        "converged": bool(result.converged),
        "message": result.message,
        "seconds": seconds,
        "seed": seed,
        "bytes": sum(array.nbytes for array in parameters.values()),
        "details": result.details,
    }
    labels = {"entry": entry.name, "source": entry.source}
    fitted = Fit(entry.model, measured.name, parameters, chosen, measured.standin, report, **labels)
    vars(fitted)["instance"] = model  # also one that no name leads to
    return fitted


def _given(entry: Entry, model: Model, measured: Measured) -> Result:
    """What stands for a fit where the parameters are given."""
    assert entry.parameters
    parameters = read_parameters(entry.parameters, model, measured.name)
    told = f"parameters given in {entry.parameters}, not fitted"
    beyond = outside_range(model, parameters)
    message = f"{told}; {beyond}" if beyond else told
    return Result(parameters, float("nan"), "none: the parameters are given", 0, True, message)


def describe_fit(fitted: Fit, measured: Measured, table: np.ndarray) -> dict[str, Any]:
    """The report of a fit with those parameters that a person can read; JSON-able. ``table``: :meth:`Fit.table`.

    FitError if the fit has no finite value where the material has one: no picture and no error could be made of it.
    """
    bad = int((~np.isfinite(table[measured.valid]).all(-1)).sum())
    if bad:
        raise FitError(f"{fitted.entry} on {fitted.material}: NaN or Inf at {bad:,} measured cells")
    return {
        "status": "ok",
        "reason": "",
        "entry": fitted.entry,
        "model": fitted.model,
        "material": fitted.material,
        "standin": fitted.standin,
        "options": dict(fitted.options),
        **fitted.report,
        "parameters": {name: array for name, array in fitted.parameters.items() if array.size <= 24},
    }
