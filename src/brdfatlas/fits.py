"""A fit: a model with numbers. After this point nothing knows which model it was."""

import os
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from brdfatlas.angles import above_horizon
from brdfatlas.files import read_npz, write_npz
from brdfatlas.measured import Measured
from brdfatlas.models import MODELS
from brdfatlas.models.base import FitError, Model


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
        """rgb (..., 3) in 1/sr at unit vectors (..., 3): ``wi`` towards the light, ``wo`` towards the viewer, which
        matters to a model that is not reciprocal. 0 where one direction is below the surface, NaN where one is NaN."""
        wi, wo = np.broadcast_arrays(np.asarray(wi, float), np.asarray(wo, float))
        unknown = np.isnan(wi).any(-1) | np.isnan(wo).any(-1)
        if unknown.any():  # compiled look-ups make indices of angles
            wi, wo = (np.where(unknown[..., None], [0.0, 0.0, 1.0], w) for w in (wi, wo))
        with np.errstate(all="ignore"):
            rgb = MODELS[self.model].evaluate(self.parameters, wi, wo)
        rgb = np.where(((wi[..., 2] > 0) & (wo[..., 2] > 0))[..., None], rgb, 0.0)
        return np.where(unknown[..., None], np.nan, rgb)

    def table(self) -> np.ndarray:
        """The fit at the cell centres of the grid, float32, NaN below the horizon: the MERL grid, (90, 90, 180, 3), or
        for a model that is not reciprocal the full circle, (90, 90, 360, 3) (:func:`brdfatlas.measured.fold` makes a
        MERL table of either)."""
        model = MODELS[self.model]
        table = np.array(model.evaluate_grid(self.parameters), np.float32, copy=True)
        table[~above_horizon()] = np.nan
        # phi_d -> -phi_d mirrors both directions at the plane of the half vector and the normal.
        return table if model.reciprocal else np.concatenate([table, table[:, :, ::-1]], 2)

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
        with open(path, "rb") as handle:
            return handle.read(2) == b"PK"
    except OSError:
        return False


def load_fit(path: str | os.PathLike) -> Fit:
    """Read a fit. ValueError names the file if it is not one."""
    try:
        store = read_npz(path)
        parameters = {k.removeprefix("parameter/"): v for k, v in store.items() if k.startswith("parameter/")}
        options = {k.removeprefix("option/"): v.item() for k, v in store.items() if k.startswith("option/")}
        return Fit(str(store["model"]), str(store["material"]), parameters, options, bool(store["standin"]))
    except FileNotFoundError:
        raise ValueError(f"{path}: no such fit") from None
    except Exception as error:
        raise ValueError(f"{path}: not a brdfatlas fit ({type(error).__name__}: {error})") from None


def fit(model: str | Model, measured: Measured, seed: int = 0, **options: Any) -> Fit:
    """Fit ``model`` (a name or a Model) to a material.

    Raises KeyError for an unknown model, ValueError for an unknown option, FitError where the model has no finite
    fit for this material.
    """
    model = MODELS[model] if isinstance(model, str) else model
    chosen = model.check_options(options)
    start = time.perf_counter()
    with np.errstate(all="ignore"):
        result = model.fit(measured, seed=seed, **chosen)
    seconds = time.perf_counter() - start
    parameters = {}
    for parameter in model.parameters:
        array = np.asarray(result.parameters[parameter.name], parameter.dtype)
        if not model.variable_size:
            array = array.reshape(parameter.shape)
        if not np.isfinite(array).all():
            raise FitError(f"{model.name} on {measured.name}: {parameter.name} is not finite ({result.message})")
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
    fitted = Fit(model.name, measured.name, parameters, chosen, measured.standin, report)
    assert model.variable_size or fitted.bytes == model.bytes
    return fitted
