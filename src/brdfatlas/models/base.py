"""What a model is: a paper, its parameters, ``fit`` and ``evaluate``. Everything else works with that alone."""

import copy
import re
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from numbers import Integral, Real
from typing import Any, ClassVar

import numpy as np

from brdfatlas.angles import GRID_SHAPE, N_PHI_D, N_THETA_D, N_THETA_H, above_horizon, directions, grid_axes
from brdfatlas.constants import OBJECTIVE_NAMES
from brdfatlas.measured import Measured
from brdfatlas.sampling import Sampler

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

    def __post_init__(self) -> None:
        if not all(author.strip() for author in self.authors.split(", ")):
            raise ValueError(f"a paper by {self.authors!r}; write First Last, First Last")

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

    def __post_init__(self) -> None:
        kind = np.dtype(self.dtype).kind
        if not isinstance(self.name, str) or not re.fullmatch(r"\w+", self.name):
            raise ValueError(f"a parameter called {self.name!r}; letters, digits and _ make a name")
        if not isinstance(self.shape, tuple) or not all(isinstance(n, int) and n > 0 for n in self.shape):
            raise ValueError(f"parameter {self.name}: shape {self.shape!r}; a tuple of whole numbers from 1 is wanted")
        if kind not in "fiu" or not isinstance(self.low, Real) or not isinstance(self.high, Real):
            raise ValueError(f"parameter {self.name}: numbers, with numbers for low and high, are wanted")

    @property
    def count(self) -> int:
        """How many numbers it is."""
        return int(np.prod(self.shape))

    @property
    def bytes(self) -> int:
        """Its storage in bytes."""
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
            whole = isinstance(value, Integral)  # 2.0 is no count, 80 is an angle
            known = any(value == choice and (whole or not isinstance(choice, Integral)) for choice in self.choices)
            return "" if known and not isinstance(value, bool) else f"is not one of {', '.join(map(str, self.choices))}"
        if isinstance(self.default, bool):
            return "" if isinstance(value, bool) else "is not true or false"
        if not isinstance(self.default, Real):
            return "" if isinstance(value, type(self.default)) else "is not text"
        whole = isinstance(self.default, Integral)
        number = isinstance(value, Integral if whole else Real) and not isinstance(value, bool)
        if number and abs(value) < (2**63 if whole else np.inf) and self.low <= value <= self.high:
            return ""
        ends = f" of {self.low:g}" if np.isfinite(self.low) else ""
        ends += (f" to {self.high:g}" if np.isfinite(self.high) else " or more") if ends else ""
        return f"is not a {'whole ' if whole else ''}number{ends}"


def objective_option(default: str) -> Option:
    """The option ``objective`` of parametric models, with a model's own default."""
    text = "what is minimised: Bagher 2016's compressive metric, Löw 2012's E2, or Ngan 2005's cosine-weighted metric"
    return Option(default, text, tuple(OBJECTIVE_NAMES))


def grazing_option(default: float) -> Option:
    """The option ``grazing`` of models whose compressive metric counts in full within ``max_angle``, with a model's own
    default."""
    return Option(
        default,
        "compressive only: weight of the same metric over all angles to 89 degrees, beside 1 for the metric within "
        "max_angle; 1e6 leaves the metric as published",
        low=0.0,
    )


def objective_words(objective: str, max_angle: float, grazing: float | None = None) -> str:
    """The name of an objective as a report states it: with ``grazing``, the compressive metric that also counts beyond
    ``max_angle`` (degrees), else a metric that counts within it alone."""
    more = "both directions " if grazing is None else ""
    beyond = "" if grazing is None else f", plus {grazing:g} of that within 89"
    return f"{OBJECTIVE_NAMES[objective]}; {more}within {max_angle:g} degrees{beyond}"


@dataclass(frozen=True, eq=False)
class Function:
    """One named function of a fit, for figures, exports and the viewer.

    ``symbol``: "D", "F", "G", "G1" ..., once for each term of a sum; ``axis``: "theta_h", "theta_d", "phi_d" or "theta"
    (of either direction); ``angle`` (n,) in radians, rising; ``values`` (n,), or (n, 3) where rgb differ; ``unit`` of
    the values.
    """

    symbol: str
    axis: str
    angle: np.ndarray
    values: np.ndarray
    unit: str = ""

    def __post_init__(self) -> None:
        """ValueError for an unknown axis and other shapes, which only the figures would stumble over."""
        angle, values = (np.asarray(getattr(self, name), float) for name in ("angle", "values"))
        if self.axis not in ("theta_h", "theta_d", "phi_d", "theta"):
            raise ValueError(f"a function over {self.axis!r}; theta_h, theta_d, phi_d or theta is needed")
        if angle.ndim != 1 or values.shape not in (angle.shape, (*angle.shape, 3)):
            raise ValueError(f"a function with angle {angle.shape} and values {values.shape}; (n,) and (n,) or (n, 3)")
        vars(self).update(angle=angle, values=values)


@dataclass(frozen=True, eq=False)
class Factors:
    """A fit as a sum of products, never below 0:

        rho_d + rho_s sum_k d_k(theta_h) f_k(theta_d) h(phi_d) G(theta_i) G(theta_o) / (cos theta_i cos theta_o)

    ``rho_d`` (3,), ``d`` and ``f`` (3, k, 90) at the cells of the MERL grid; ``g`` (3, 90) at nodes evenly spaced over
    0 to 90 degrees, linear between them as the cosines are, None where the model has no G / cos; ``h`` (3, 180) at the
    phi_d cells, None where it is 1; ``rho_s`` (3,), None where it is 1.
    """

    rho_d: np.ndarray
    d: np.ndarray
    f: np.ndarray
    g: np.ndarray | None = None
    h: np.ndarray | None = None
    rho_s: np.ndarray | None = None

    def __post_init__(self) -> None:
        """ValueError for other shapes, which only figures, viewer and textures would stumble over."""
        count = np.shape(self.d)[1:2]
        shapes = {"rho_d": (3,), "d": (3, *count, N_THETA_H), "f": (3, *count, N_THETA_D)}
        shapes |= {"g": (3, 90), "h": (3, N_PHI_D), "rho_s": (3,)}
        for name, shape in shapes.items():
            value = getattr(self, name)
            if value is None and name in ("g", "h", "rho_s"):
                continue
            array = np.asarray(value, float)
            if array.shape != shape or not array.size:
                raise ValueError(f"factors with {name} {array.shape}; {shape} is needed")
            vars(self)[name] = array


@dataclass(eq=False)
class Result:
    """What ``Model.fit`` returns: the parameters and how they were found."""

    parameters: dict[str, np.ndarray]
    objective: float
    objective_name: str
    iterations: int
    converged: bool
    message: str = ""
    details: dict[str, Any] = field(default_factory=dict)


def numbers(values: Any) -> np.ndarray:
    """What a model gives for values, of any shape, if these are numbers: None would become NaN. ValueError if not."""
    array = np.asarray(values)
    if array.dtype.kind not in "fiu":
        raise ValueError(f"its values are {array.dtype}, not numbers")
    return array


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
    #: False for the few published models that are not reciprocal: they are rendered and judged on the full circle of
    #: phi_d, and reports flag them.
    reciprocal: ClassVar[bool] = True
    #: parameter -> (its name in the public collection of fits, "Node.key" or "Node.key.index", factor on its values);
    #: empty for a model that is not in it (:mod:`.given`).
    public_names: ClassVar[Mapping[str, tuple[str, Any]]] = {}
    #: True where the material chooses how many numbers a fit has; ``parameters`` then states the most common size.
    variable_size: ClassVar[bool] = False

    @property
    def bytes(self) -> int:
        """Storage of one fit, in bytes, parameters only."""
        return sum(parameter.bytes for parameter in self.parameters)

    @property
    def least_bytes(self) -> int:
        """Storage of the smallest fit, in bytes; of a model of variable size at least that of a number a parameter."""
        return sum(np.dtype(p.dtype).itemsize for p in self.parameters) if self.variable_size else self.bytes

    @property
    def free_parameters(self) -> int:
        """How many numbers one fit has."""
        return sum(parameter.count for parameter in self.parameters)

    @abstractmethod
    def fit(self, measured: Measured, *, seed: int = 0, **options: Any) -> Result:
        """Fit to a material. Deterministic for a seed. Raises FitError if the model has no fit for it."""

    @abstractmethod
    def evaluate(self, parameters: Parameters, wi: np.ndarray, wo: np.ndarray) -> np.ndarray:
        """rgb (..., 3) in 1/sr, without the cosine, at unit vectors (..., 3) above the surface: ``wi`` towards the
        light, ``wo`` towards the viewer. Turned about the normal or mirrored, two directions have the same value."""

    def evaluate_grid(self, parameters: Parameters) -> np.ndarray:
        """The model at every cell centre of the MERL grid, (90, 90, 180, 3) float32; cells below the horizon may
        hold anything. Override where the structure of the model allows more speed."""
        theta_h, theta_d, phi_d = grid_axes()
        table = np.zeros((*GRID_SHAPE, 3), np.float32)
        for row, seen in enumerate(above_horizon()):
            wi, wo = directions(theta_h[row], theta_d[0], phi_d[0])
            table[row][seen] = numbers(self.evaluate(parameters, wi[seen], wo[seen]))
        return table

    # What a model may say of itself beside its values: code outside models/ asks these and never tests a name.

    #: Targets that :meth:`material` knows: "mitsuba", "materialx", "gltf".
    targets: ClassVar[tuple[str, ...]] = ()

    def title_of(self, options: Mapping[str, Any]) -> str:
        """The title of an entry with these options; by default the options that differ from their defaults stand
        behind it."""
        defaults = {key: option.default for key, option in self.options.items()}
        changed = [f"{key} {value}" for key, value in options.items() if value != defaults.get(key)]
        return f"{self.title} ({', '.join(changed)})" if changed else self.title

    def parameters_of(self, options: Mapping[str, Any]) -> tuple[Parameter, ...]:
        """The parameters of a fit with these options. Override where an option chooses their shapes."""
        return self.parameters

    def shape_fault(self, parameters: Parameters, options: Mapping[str, Any]) -> str:
        """What is wrong with the shapes of a stored fit, in words; "" if nothing. A model of variable size overrides
        it: compiled code trusts shapes."""
        for parameter in () if self.variable_size else self.parameters_of(options):
            if parameters[parameter.name].shape != parameter.shape:
                return f"{parameter.name} has shape {parameters[parameter.name].shape}, not {parameter.shape}"
        return ""

    def with_options(self, options: Mapping[str, Any]) -> "Model":
        """This model with other defaults, and the title and the parameters that follow from them: an entry's model.

        ValueError for options that the model does not have.
        """
        if not options:
            return self
        chosen = self.check_options(options)
        model = copy.copy(self)
        stated = {
            "title": self.title_of(options),
            "parameters": self.parameters_of(chosen),
            "options": {key: replace(option, default=chosen[key]) for key, option in self.options.items()},
        }
        vars(model).update(stated)
        for name, value in stated.items():
            if getattr(model, name) is not value:  # a property would silently stay what it is
                raise ValueError(
                    f"model {self.name}: {name} is a property, which options cannot change; make it an attribute"
                )
        return model

    def sampler(self, parameters: Parameters) -> Sampler | None:
        """The importance sampler of a fit, None for a model without a sampling procedure."""
        return None

    def functions(self, parameters: Parameters) -> tuple[Function, ...]:
        """The named functions of a fit, none by default."""
        return ()

    def factors(self, parameters: Parameters) -> Factors | None:
        """The fit as a sum of products, for textures and the viewer; None for a model that is none."""
        return None

    def material(self, parameters: Parameters, target: str) -> Mapping[str, Any] | None:
        """The fit as parameters of a renderer's material, exact, for one of :attr:`targets`; else None."""
        return None

    def check_options(self, options: Mapping[str, Any]) -> dict[str, Any]:
        """Options completed with their defaults. ValueError names the model, the key and what is allowed."""
        for key, value in options.items():
            if key not in self.options:
                known = ", ".join(self.options) or "none"
                raise ValueError(f"model {self.name}: unknown option {key[:80]!r}; known options: {known}")
            option = self.options[key]
            fault = option.fault(value)
            if fault:
                raise ValueError(f"model {self.name}: {key} = {repr(value)[:80]} {fault}")
            if option.check:
                option.check(value, self.name, key)
        return {key: option.default for key, option in self.options.items()} | dict(options)
