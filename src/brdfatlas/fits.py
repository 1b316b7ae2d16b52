"""A fit: a model with numbers. After this point nothing knows which model it was."""

import json
import os
import stat
import threading
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from typing import Any

import numpy as np
from numba.core.event import TimingListener, install_listener
from threadpoolctl import threadpool_limits

from brdfatlas.angles import GRID_SHAPE, above_horizon, directions, unit_vectors
from brdfatlas.files import check_regular, file_digest, json_of, plain, read_npz, shown, write_npz
from brdfatlas.measured import Measured, fold
from brdfatlas.models import MODELS, Entry, is_ours, load_model, own_faults
from brdfatlas.models.base import Factors, FitError, Function, Model, Result, numbers
from brdfatlas.models.given import outside_range, read_parameters
from brdfatlas.models.loading import BUILTIN, check_model_file
from brdfatlas.sampling import Sampler

#: Most bytes that a fit may have: several times a table with a number of its own for every cell of the grid.
MOST_BYTES = 2**28


@dataclass(frozen=True, eq=False)
class Fit:
    """A fitted model: evaluates itself anywhere and puts itself on the MERL grid.

    ``model`` is the name of the model's class, else of an entry, ``entry`` the row of the run, ``source`` the file of a
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

    def __getstate__(self) -> dict[str, Any]:
        """Without a model that is from a file, as an entry."""
        return {name: value for name, value in vars(self).items() if name != "instance" or not self.source}

    @cached_property
    def instance(self) -> Model:
        """The model itself. KeyError or ImportError where it cannot be found."""
        try:  # a class before an entry: a row called "ggx" may be of another class
            return load_model(self.model, self.source)
        except KeyError:
            return MODELS[self.model]

    @property
    def bytes(self) -> int:
        """Storage of the parameters in bytes."""
        return sum(array.nbytes for array in self.parameters.values())

    def evaluate(self, wi, wo) -> np.ndarray:
        """rgb (..., 3) in 1/sr at unit vectors (..., 3): ``wi`` towards the light, ``wo`` towards the viewer, which
        matters to a model that is not reciprocal. 0 where one direction is below the surface, NaN where one is not
        finite. ValueError for another shape and for vectors of another length."""
        wi, wo = unit_vectors(wi, wo)
        finite = (np.isfinite(wi) & np.isfinite(wo)).all(-1)  # compiled look-ups take directions as indices
        seen = finite & (wi[..., 2] > 0) & (wo[..., 2] > 0)
        if seen.all():
            return self._values(wi, wo)
        rgb = np.zeros(wi.shape)
        rgb[~finite] = np.nan
        if seen.any():
            rgb[seen] = self._values(wi[seen], wo[seen])
        return rgb

    def _values(self, wi: np.ndarray, wo: np.ndarray) -> np.ndarray:
        with own_faults(self.instance, self.material):
            rgb = numbers(self.instance.evaluate(self.parameters, wi, wo))
            if rgb.shape != wi.shape:
                raise ValueError(f"evaluate gives shape {rgb.shape} for directions {wi.shape}")
            return rgb

    def table(self) -> np.ndarray:
        """The fit at the cell centres of the grid, float32 in 1/sr, NaN below the horizon: the MERL grid,
        (90, 90, 180, 3), or for a model that is not reciprocal the full circle, (90, 90, 360, 3)
        (:func:`brdfatlas.measured.fold` makes a MERL table of either). FitError for a fault in a model from outside
        the package, ValueError if one of ours gives another shape or no numbers."""
        with own_faults(self.instance, self.material):
            table = np.array(numbers(self.instance.evaluate_grid(self.parameters)), np.float32, copy=True)
            if table.shape != (*GRID_SHAPE, 3):
                raise ValueError(f"evaluate_grid gives shape {table.shape}, not {(*GRID_SHAPE, 3)}")
        np.copyto(table, np.nan, where=_below_horizon())
        # phi_d -> -phi_d mirrors both directions at the plane of the half vector and the normal.
        return table if self.instance.reciprocal else np.concatenate([table, table[:, :, ::-1]], 2)

    def sampler(self) -> Sampler | None:
        """The importance sampler of the fit; None for a model without a sampling procedure. FitError, as those below,
        for a fault in a model from outside the package."""
        return self._told("sampler", Sampler | None)

    def functions(self) -> tuple[Function, ...]:
        """The named functions of the fit, none for a model that has none."""
        return self._told("functions", tuple)

    def factors(self) -> Factors | None:
        """The fit as a sum of products; None for a model that is none."""
        return self._told("factors", Factors | None)

    def material_for(self, target: str) -> Mapping[str, Any] | None:
        """The fit as a material of ``target`` ("mitsuba", "materialx", "gltf"); None where that cannot be exact."""
        return plain(self._told("material", Mapping | None, target))

    def _told(self, hook: str, kind: Any, *more: str) -> Any:
        """What the model says of itself in answer to a hook."""
        with own_faults(self.instance, self.material):
            found = getattr(self.instance, hook)(self.parameters, *more)
            wrong = [] if isinstance(found, kind) else [found]
            if kind is tuple and not wrong:
                wrong = [item for item in found if not isinstance(item, Function)]
            if wrong:
                raise TypeError(f"{hook} gives a {type(wrong[0]).__name__}")
            return found

    def save(self, path: str | os.PathLike) -> None:
        """Write as npz without pickle; equal fits give equal bytes."""
        labels = {"model": self.model, "material": self.material}
        labels |= {"entry": self.entry} if self.entry != self.model else {}
        labels |= {"source": self.source} if self.source else {}
        options = {f"option/{key}": np.array(value) for key, value in self.options.items()}
        arrays = {f"parameter/{key}": value for key, value in self.parameters.items()}
        meta = {key: np.array(value) for key, value in labels.items()} | {"standin": np.array(self.standin)}
        write_npz(path, meta | options | arrays)


@cache
def _below_horizon() -> np.ndarray:
    """Cells below the horizon, bool (90, 90, 180, 3): a mask that is broadcast takes ten times as long."""
    return np.repeat(~above_horizon()[..., None], 3, -1)


def _same(a, b) -> bool:
    a, b = np.asarray(a), np.asarray(b)
    return a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes()


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


def load_fit(path: str | os.PathLike, source: str | os.PathLike | None = None) -> Fit:
    """Read a fit and check it against its model. ``source``: where the file of its model is now, for a model of one's
    own whose file has moved.

    ValueError names the file if it is not a fit, if its model cannot be found, or if it is not what the model states.
    TypeError for what is no path.
    """
    name = shown(path)
    try:
        if check_regular(path).stat().st_size == 0:
            raise ValueError("empty, the mark of a fit that failed; fit again")
        if json_of(path) == "fit":
            raise ValueError("an export as JSON, which brdfatlas.export.fit_json.import_json reads")
        fitted = _fit_of(read_npz(path, most_bytes=MOST_BYTES))
        fitted = with_source(fitted, source)
    except FileNotFoundError:
        raise ValueError(f"{name}: no such fit") from None
    except OSError as error:
        raise ValueError(f"{name}: cannot be read ({error.strerror or error})") from None
    except ValueError as error:
        raise ValueError(f"{name}: not a brdfatlas fit ({str(error).removeprefix(f'{name}: ')})") from None
    check_fit(fitted, path, trusted=bool(source))
    return fitted


def with_source(fitted: Fit, source: str | os.PathLike | None) -> Fit:
    """A stored fit with the place of its model's file: ``source``, else, where its own is not there, the one that the
    user named for this model. A model of the package has no file: that of another fit is read and left. ValueError for
    a file that cannot be used."""
    if source and not fitted.source and fitted.model in BUILTIN:
        try:
            check_model_file(source)
        except ImportError as error:
            raise ValueError(str(error)) from None
        return fitted
    if not source and fitted.source and not os.path.isfile(fitted.source):
        source = MODELS.source_of(fitted.entry, fitted.model)
    return replace(fitted, source=str(source)) if source else fitted


def load_reported(path: str | os.PathLike, report: Mapping[str, Any], entry: str, material: str) -> Fit:
    """A fit of a run; ValueError if it is not the fit of this entry to this material, or not the one that its report is
    about, such as a file copied over it."""
    fitted = load_fit(path)
    told = {
        "its report": (report.get("entry", entry), report.get("material", material)),
        "its place": (entry, material),
    }
    for what, wanted in told.items():
        if wanted != (fitted.entry, fitted.material):
            fault = f"a fit of {fitted.entry} to {fitted.material}, {what} is of another ({' to '.join(wanted)})"
            raise ValueError(f"{shown(path)}: {fault}; delete it, the next run makes it again")
    if report.get("sha256", digest := file_digest(path)) != digest:
        raise ValueError(f"{shown(path)}: not the fit that its report is about; delete it, the next run makes it again")
    return fitted


def _fit_of(store: dict[str, np.ndarray]) -> Fit:
    """The fit in the arrays of an npz file. ValueError if they are none."""
    labels: dict[str, Any] = {}
    for key, kind in {"model": "U", "material": "U", "standin": "b", "entry": "U", "source": "U"}.items():
        if key in store or key not in ("entry", "source"):
            if key not in store or store[key].dtype.kind != kind or store[key].ndim:
                raise ValueError(f"it does not state its {key}")
            labels[key] = store[key].item()
    parts: dict[str, dict[str, np.ndarray]] = {"parameter": {}, "option": {}}
    for key in (key for key in store if key not in labels):
        part, _, rest = key.partition("/")
        if part not in parts:
            raise ValueError(f"it holds {shown(key)}, which belongs to no fit")
        parts[part][rest] = store[key]
    if any(value.ndim for value in parts["option"].values()):
        raise ValueError("an option is an array")
    options = {key: value.item() for key, value in parts["option"].items()}
    return Fit(parameters=parts["parameter"], options=options, **labels)


def check_fit(fitted: Fit, path: str | os.PathLike, *, trusted: bool = False) -> None:
    """Check what was read from ``path`` against what its model states of itself: options, names, types, shapes, ranges.

    The Python file that a fit names is run only where the user named it as well (``trusted``) or it lies below the
    working directory. Raises ValueError, one line that names the file and the first fault.
    """
    name = shown(path)
    if fitted.source and not trusted and not MODELS.trusts(fitted.source):
        fault = f"its model's file {shown(fitted.source)} is outside the working directory and is not run unasked"
        raise ValueError(f"{name}: {fault}; if you trust it, name it: source=FILE.py, or --source FILE.py")
    try:
        model = fitted.instance
    except (KeyError, ImportError) as error:
        fault = f"its model {shown(fitted.model)!r} cannot be used ({shown(error.args[0])})"
        raise ValueError(
            f"{name}: {fault}; say where the model's file is: source=FILE.py, --source, or register_file"
        ) from None
    try:
        options = model.check_options(fitted.options)
    except ValueError as error:
        raise ValueError(f"{name}: damaged, or of another version ({error})") from None
    fault = fault_of(model, fitted.parameters, options)
    if fault:
        raise ValueError(f"{name}: damaged, or of another version of {model.name}: {fault}; fit again")
    for label in (fitted.material, fitted.entry):
        if not _is_name(label):
            raise ValueError(f"{name}: damaged, {label[:80]!r} is no name; fit again")


def _is_name(label: Any) -> bool:
    return isinstance(label, str) and 0 < len(label) < 256 and label.isprintable()


def check_material(measured: Measured, seed: int = 0) -> None:
    """ValueError for what is no material, one whose name would make its fit unreadable, or an impossible seed."""
    if not isinstance(measured, Measured):
        raise ValueError(f"{str(measured)[:80]!r} is no Measured; brdfatlas.read(PATH) makes one of a file")
    if measured.table.shape != (*GRID_SHAPE, 3):
        raise ValueError(
            f"{measured.name}: a table on the full circle; brdfatlas.measured.fold makes a MERL table of it"
        )
    negative = measured.table < 0  # such as MERL's own marks of cells that were not measured
    if negative.any():
        rule = "NaN is for cells that were not measured, 0 for a colour out of gamut"
        raise ValueError(
            f"{measured.name}: negative values in {int(negative.any(-1).sum()):,} cells of the table; {rule}"
        )
    if not isinstance(seed, int | np.integer) or seed < 0:
        raise ValueError(f"seed {seed!r}: a whole number from 0 is wanted")
    if not _is_name(measured.name):
        where = f"{shown(measured.path)}: " if measured.path else ""
        rule = "a material's name has 1 to 255 printable characters; rename the file, or give Measured another name"
        raise ValueError(f"{where}{str(measured.name)[:80]!r}: {rule}")


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
        array = parameters[parameter.name]
        bound = array.dtype.type if array.dtype.kind == "f" else float  # inf is no whole number
        if (array < bound(parameter.low)).any() or (array > bound(parameter.high)).any():
            return f"{parameter.name} is not within {parameter.low:g} to {parameter.high:g}"
    return ""


def _stored(model: Model, options: Mapping[str, Any], result: Result, where: str) -> dict[str, np.ndarray]:
    """The parameters of a result in the types of the model's storage. FitError if one is missing or not finite."""
    parameters = {}
    for parameter in model.parameters_of(options):
        if parameter.name not in result.parameters:
            raise FitError(f"{where}: the fit returns no {parameter.name}, which the model states")
        array = np.asarray(result.parameters[parameter.name], parameter.dtype)
        if not model.variable_size:
            array = array.reshape(parameter.shape)
        if not np.isfinite(array).all():
            raise FitError(f"{where}: {parameter.name} is not finite ({result.message})")
        parameters[parameter.name] = array
    return parameters


_fitting = threading.Lock()
_fits_at_work = 0
_limits: threadpool_limits | None = None


@contextmanager
def _one_blas_thread() -> Iterator[None]:
    """BLAS works with one thread in the block: the order of its sums, and so the last bit, depends on their number.

    It is a setting of the process: of fits in several threads the first makes it and the last takes it back.
    """
    global _fits_at_work, _limits
    with _fitting:
        if not _fits_at_work:
            _limits = threadpool_limits(1, user_api="blas")
        _fits_at_work += 1
    try:
        yield
    finally:
        with _fitting:
            _fits_at_work -= 1
            if not _fits_at_work:
                assert _limits is not None
                _limits.restore_original_limits()


def fit(model: str | Entry | Model, measured: Measured, seed: int = 0, **options: Any) -> Fit:
    """Fit ``model`` (a name, an entry or a Model) to a material; ``options`` stand over those of the entry.

    An entry with given parameters is not fitted: its row holds those of the material (:mod:`.models.given`). The model
    gets a read-only table. ``report["seconds"]`` leaves out what the first fit of an installation spends on compiling;
    it is None where nothing was fitted.

    Raises KeyError for an unknown model, TypeError for what is none, ValueError for an unknown option or a material
    without a name, FitError where the model has no finite fit for this material, or where the code of a model from
    outside fails, ParameterFileError where its parameters are to be given and are not.
    """
    if not isinstance(model, str | Entry | Model):
        raise TypeError(f"{shown(repr(model))[:80]} is no model; give a name of brdfatlas.MODELS, an entry or a Model")
    named = not isinstance(model, Model)
    if isinstance(model, Model):
        if model.name in BUILTIN and type(model) is not type(load_model(model.name)):
            raise ValueError(
                f"a model of your own called {model.name!r}, as one of the package is; give it another name"
            )
        entry = Entry(model.name, model.name)
    else:
        entry = MODELS.entry(model) if isinstance(model, str) else model
        model = entry.instance
    chosen = model.check_options(options)
    check_material(measured, seed)
    where = f"{entry.name} on {measured.name}"
    table = measured.table.view()
    table.flags.writeable = False
    given = replace(measured, table=table)
    compiling = TimingListener()
    start = time.perf_counter()
    with (
        own_faults(model, measured.name),
        _one_blas_thread(),
        install_listener("numba:compile", compiling),
    ):
        result = _given(entry, model, given) if entry.parameters else model.fit(given, seed=seed, **chosen)
        seconds = time.perf_counter() - start - (compiling.duration if compiling.done else 0.0)
        parameters = _stored(model, chosen, result, where)
        report = {
            "objective": float(result.objective),
            "objective_name": str(result.objective_name),
            "iterations": int(result.iterations),
            "converged": bool(result.converged),
            "message": str(result.message),
            "seconds": None if entry.parameters else seconds,
            "seed": seed,
            "bytes": sum(array.nbytes for array in parameters.values()),
            "details": result.details,
        }
    try:
        json.dumps(plain(report["details"]))
    except (TypeError, ValueError, RecursionError) as error:
        raise FitError(f"{where}: details cannot be written as JSON ({error})") from None
    labels = {"entry": entry.name, "source": entry.source}
    fitted = Fit(entry.model, measured.name, parameters, chosen, measured.standin, report, **labels)
    vars(fitted)["instance"] = model  # also one that no name leads to
    if not is_ours(model):
        _check_own(fitted, anew=named)
    return fitted


def _check_own(fitted: Fit, *, anew: bool) -> None:
    """FitError for what every later command would find in a fit of a model from outside. ``anew``: whether its class
    can be made anew. Who reads the fit has such an object, which was never fitted: the stored parameters alone must
    give the values."""
    fault = fault_of(fitted.instance, fitted.parameters, fitted.options)
    if fault:
        raise FitError(f"{fitted.entry} on {fitted.material}: {fault}")
    for hook in (fitted.sampler, fitted.functions, fitted.factors):
        hook()
    if anew:
        read = replace(fitted)
        with own_faults(fitted.instance, fitted.material):
            vars(read)["instance"] = type(fitted.instance)()
            wi, wo = directions(*(angle.ravel() for angle in np.meshgrid([0.1, 0.5], [0.1, 0.6], [0.2, 1.3])))
            if not np.array_equal(fitted.evaluate(wi, wo), read.evaluate(wi, wo), equal_nan=True):
                raise ValueError("evaluate gives other values once the fit is saved: it uses more than its parameters")


def _given(entry: Entry, model: Model, measured: Measured) -> Result:
    """What stands for a fit where the parameters are given."""
    assert entry.parameters
    parameters = read_parameters(entry.parameters, model, measured.name)
    told = f"parameters given in {entry.parameters}, not fitted"
    beyond = outside_range(model, parameters)
    message = f"{told}; {beyond}" if beyond else told
    return Result(parameters, float("nan"), "none: the parameters are given", 0, True, message)


def describe_fit(fitted: Fit, measured: Measured, table: np.ndarray) -> dict[str, Any]:
    """The report of a fit with those parameters that a person can read; JSON-able.

    ``table``: :meth:`Fit.table`, (90, 90, 180, 3) or (90, 90, 360, 3) in 1/sr.

    FitError if the fit has no finite value where the material has one: no picture and no error could be made of it.
    """
    finite = np.logical_and.reduce([np.isfinite(channel) for channel in np.moveaxis(fold(table), -1, 0)])
    bad = int(np.count_nonzero(measured.valid & ~finite))
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


def known_details(report: Mapping[str, Any]) -> dict[str, Any]:
    """Of the details of a fit's report those that pages and figures show, ``channels``, ``bound`` and ``bounds``, where
    they have the form that ours have: in a model from outside a key may mean anything."""
    details = report.get("details")
    details = details if isinstance(details, Mapping) else {}
    channels, bound, bounds = (details.get(key) for key in ("channels", "bound", "bounds"))
    return {
        "channels": channels if isinstance(channels, list) and all(map(_is_channel, channels)) else [],
        "bound": bound if isinstance(bound, Mapping) and _is_bound(bound) else {},
        "bounds": bounds if isinstance(bounds, list) else [],
    }


def _is_bound(item: Mapping[str, Any]) -> bool:
    return isinstance(item.get("factor"), str) and _has_numbers(item, ("held", "count", "value"))


def _has_numbers(item: Mapping[str, Any], keys: Iterable[str]) -> bool:
    return all(type(item.get(key)) in (int, float) for key in keys)


def _is_channel(item: Any) -> bool:
    """Whether this is how the fit of a channel went, with a curve of its own or those of its starts."""
    starts = item.get("starts", []) if isinstance(item, Mapping) else None
    if not isinstance(starts, list):
        return False
    named = all(isinstance(start, Mapping) and isinstance(start.get("name"), str) for start in starts)
    return named and all(map(_is_curve, [item, *starts]))


def _is_curve(item: Mapping[str, Any]) -> bool:
    history = item.get("history", [])
    if not isinstance(history, list) or not all(type(value) in (int, float, type(None)) for value in history):
        return False
    counts = {"golden_section_calls", "iterations"} & item.keys()
    return _has_numbers(item, counts) and (not history or any(value is not None for value in history))


def report_faults(report: Mapping[str, Any]) -> list[str]:
    """What is not of its type in the report of a fit (:func:`describe_fit`, or of one that failed), in words."""
    kinds = dict.fromkeys(("seconds", "iterations", "objective", "seed", "bytes"), (int, float, type(None)))
    kinds |= {"objective_name": (str,), "options": (dict, type(None)), "parameters": (dict, type(None))}
    return [f"its {key} is of another type" for key in kinds if key in report and type(report[key]) not in kinds[key]]
