"""What a model is: a paper, its parameters, ``fit`` and ``evaluate``. Everything else works with that alone."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from numbers import Integral, Real
from typing import Any, ClassVar

import numpy as np

from brdfatlas.angles import GRID_SHAPE, directions, grid_axes
from brdfatlas.measured import Measured

Parameters = Mapping[str, np.ndarray]


class FitError(RuntimeError):
    """The model cannot be fitted to this material; the message says why in one line."""


@dataclass(frozen=True)
class Paper:
    """A citation; ``authors`` are full names, "First Last, First Last"."""

    authors: str
    title: str
    venue: str
    year: int
    doi: str = ""

    @property
    def short(self) -> str:
        """Such as "Dupuy et al. 2015"."""
        names = [author.split()[-1] for author in self.authors.split(", ")]
        first = f"{names[0]} et al." if len(names) > 2 else " and ".join(names)
        return f"{first} {self.year}"


@dataclass(frozen=True)
class Parameter:
    """One named array of a model: its shape, unit, range and meaning. A range is what a fit may return."""

    name: str
    shape: tuple[int, ...]
    description: str
    unit: str = ""
    low: float = -np.inf
    high: float = np.inf
    dtype: str = "float32"

    @property
    def count(self) -> int:
        return int(np.prod(self.shape))

    @property
    def bytes(self) -> int:
        return self.count * np.dtype(self.dtype).itemsize


@dataclass(frozen=True)
class Option:
    """A choice that a fit offers in config/models.yaml: one of ``choices`` where there are any, else a value of the
    default's kind (true or false, a whole number, a number, text), numbers within ``low`` and ``high``.

    ``check`` (value, model, key) raises ValueError for what else is wrong with it.
    """

    default: Any
    description: str
    choices: tuple[Any, ...] = ()
    low: float = -np.inf
    high: float = np.inf
    check: Callable[[Any, str, str], object] | None = None

    def fault(self, value: Any) -> str:
        """What is wrong with a value, such as "is not a whole number of 1 to 16"; empty if nothing is."""
        if self.choices:
            known = any(value == choice and type(value) is not bool for choice in self.choices)
            return "" if known else f"is not one of {', '.join(map(str, self.choices))}"
        if isinstance(self.default, bool):
            return "" if isinstance(value, bool) else "is not true or false"
        if not isinstance(self.default, Real):
            return "" if isinstance(value, type(self.default)) else "is not text"
        whole = isinstance(self.default, Integral)
        number = isinstance(value, Integral if whole else Real) and not isinstance(value, bool)
        if number and np.isfinite(value) and self.low <= value <= self.high:
            return ""
        ends = f" of {self.low:g}" if np.isfinite(self.low) else ""
        ends += (f" to {self.high:g}" if np.isfinite(self.high) else " or more") if ends else ""
        return f"is not a {'whole ' if whole else ''}number{ends}"


@dataclass
class Result:
    """What ``Model.fit`` returns: the parameters and how they were found."""

    parameters: dict[str, np.ndarray]
    objective: float
    objective_name: str
    iterations: int
    converged: bool
    message: str = ""
    details: dict[str, Any] = field(default_factory=dict)


class Model(ABC):
    """A reflectance model. A subclass states its class attributes and implements ``fit`` and ``evaluate``."""

    name: ClassVar[str]
    title: ClassVar[str]
    paper: ClassVar[Paper]
    equations: ClassVar[str]
    formula: ClassVar[str]
    parameters: ClassVar[tuple[Parameter, ...]]
    options: ClassVar[Mapping[str, Option]] = {}
    #: "" for a model as published; else what it is instead: "reconstruction: ..." or "ours: ...". Reports show it.
    status: ClassVar[str] = ""
    #: False for the few published models that are not reciprocal; reports flag them.
    reciprocal: ClassVar[bool] = True
    #: True where options or the material choose how many numbers a fit has; ``parameters`` then states the default.
    variable_size: ClassVar[bool] = False

    @property
    def bytes(self) -> int:
        """Storage of one fit, in bytes, parameters only."""
        return sum(parameter.bytes for parameter in self.parameters)

    @property
    def free_parameters(self) -> int:
        """How many numbers one fit has."""
        return sum(parameter.count for parameter in self.parameters)

    @abstractmethod
    def fit(self, measured: Measured, *, seed: int = 0, **options: Any) -> Result:
        """Fit to a material. Deterministic for a seed. Raises FitError if the model has no fit for it."""

    @abstractmethod
    def evaluate(self, parameters: Parameters, wi: np.ndarray, wo: np.ndarray) -> np.ndarray:
        """rgb (..., 3) in 1/sr, without the cosine, at unit vectors (..., 3) above the surface."""

    def evaluate_grid(self, parameters: Parameters) -> np.ndarray:
        """The model at every cell centre of the MERL grid, (90, 90, 180, 3) float32; cells below the horizon may
        hold anything. Override where the structure of the model allows more speed."""
        theta_h, theta_d, phi_d = grid_axes()
        table = np.empty((*GRID_SHAPE, 3), np.float32)
        for row in range(GRID_SHAPE[0]):
            wi, wo = directions(theta_h[row], theta_d[0], phi_d[0])
            with np.errstate(all="ignore"):
                table[row] = self.evaluate(parameters, wi, wo)
        return table

    def check_options(self, options: Mapping[str, Any]) -> dict[str, Any]:
        """Options completed with their defaults. ValueError names the model, the key and what is allowed."""
        for key, value in options.items():
            if key not in self.options:
                known = ", ".join(self.options) or "none"
                raise ValueError(f"model {self.name}: unknown option {key!r}; known options: {known}")
            option = self.options[key]
            fault = option.fault(value)
            if fault:
                raise ValueError(f"model {self.name}: {key} = {value!r} {fault}")
            if option.check:
                option.check(value, self.name, key)
        return {key: option.default for key, option in self.options.items()} | dict(options)
