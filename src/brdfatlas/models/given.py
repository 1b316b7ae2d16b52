"""Given parameters: rows of a comparison that are not fitted (models.yaml, ``parameters: FILE``).

What others published, or a user's own values, by material, in one of three forms:

- CSV: a column ``material``, then a column for each number: ``name`` for one number, ``name_r, name_g, name_b`` or
  ``name_1, name_2, ...`` for several, in any order but none left out. Other columns are ignored.
- JSON: {material: {parameter: number or list}}.
- The text format of the public collection of fits by P. Peers (github.com/bsdfbenchmark/bbm, folder fits/): one line a
  material, ``name = Aggregate(Lambertian(albedo = [...]), Lobe(key = value, ...))``. A model says which of its
  parameters stands where (:attr:`.base.Model.public_names`). It is read by its grammar; nothing of it is executed.

A file that has no line for a material is not at fault: :func:`materials_of` says which it has.
"""

import csv
import json
import os
import re
from collections.abc import Iterator, Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from brdfatlas.files import digits
from brdfatlas.models.base import Model

#: Rows of the authors' own parameters are named so. A stand-in is made of published fits: it has no such row.
PUBLISHED = "_published"
#: Where `snakemake published_fits` puts what it fetches.
FETCHED = Path("data") / "published_fits"


class ParameterFileError(ValueError):
    """A file of parameters that cannot be used; the message is one line with file, material and remedy."""


def why_no_row(entry: str, path: str | os.PathLike, material: str, *, standin: bool) -> str:
    """Why an entry with ``parameters: path`` has no row for a material; empty if it has one.

    ``entry``: its name; those that end in "_published" have none for a stand-in, which is made of published fits.
    """
    if standin and entry.endswith(PUBLISHED):
        return "a stand-in is itself made of published fits"
    if Path(path).parent == FETCHED and not Path(path).is_file():
        return f"{path} is not there; `snakemake published_fits` fetches it"
    if material not in materials_of(path):
        return f"{path} has no parameters for it"
    return ""


def materials_of(path: str | os.PathLike) -> list[str]:
    """The materials of a file of parameters, in its order. ParameterFileError if it cannot be read."""
    return list(_read(path))


def read_parameters(path: str | os.PathLike, model: Model, material: str) -> dict[str, np.ndarray]:
    """The parameters of one material in the form of ``model.parameters``, float64.

    Raises ParameterFileError for a file that cannot be read, a material that it lacks, a parameter that is missing, has
    another number of values or is not finite.
    """
    rows = _read(path)
    if material not in rows:
        raise ParameterFileError(f"{path}: no parameters for {material}; it has {len(rows)} materials")
    given = _by_public_name(path, model, material, rows[material])
    parameters = {}
    for parameter in model.parameters:
        where = f"{path}: {material}: {parameter.name}"
        if parameter.name not in given:
            near = ", ".join(name for name in given if name.startswith(f"{parameter.name}_"))
            name = parameter.name
            form = f"; {near[:80]} are not {name}_r, {name}_g, {name}_b or {name}_1, {name}_2, ..." if near else ""
            raise ParameterFileError(f"{where}: is missing{form}; model {model.name} needs {_named(model)}")
        try:
            nested = np.array(given[parameter.name], object)
            value = nested.reshape(-1)
            if any(isinstance(item, bool) for item in value):
                raise ValueError
            values = np.array([digits(item) if isinstance(item, str) else item for item in value], object).astype(float)
        except (TypeError, ValueError):
            told = repr(given[parameter.name])[:80]
            raise ParameterFileError(f"{where}: {told} is no number or list of numbers") from None
        if not model.variable_size and values.size != parameter.count:
            raise ParameterFileError(f"{where}: has {values.size} values instead of {parameter.count}")
        if not np.isfinite(values).all():
            raise ParameterFileError(f"{where}: holds NaN or Inf")
        shape = nested.shape if model.variable_size else parameter.shape
        if len(shape) != len(parameter.shape):
            raise ParameterFileError(
                f"{where}: has shape {shape}; lists within lists, such as {parameter.shape}, are needed"
            )
        parameters[parameter.name] = values.reshape(shape)
    fault = model.shape_fault(parameters, model.check_options({}))
    if fault:
        raise ParameterFileError(f"{path}: {material}: {fault}")
    return parameters


def outside_range(model: Model, parameters: Mapping[str, np.ndarray]) -> str:
    """One line that names given values beyond the ranges of a fit; empty where there are none."""
    beyond = [
        f"{p.name} ({p.low:g} to {p.high:g})"
        for p in model.parameters
        if (np.asarray(parameters[p.name]) < p.low).any() or (np.asarray(parameters[p.name]) > p.high).any()
    ]
    return f"beyond the range of our fits: {', '.join(beyond)}" if beyond else ""


def _named(model: Model) -> str:
    return ", ".join(f"{p.name} ({p.count})" for p in model.parameters)


def _by_public_name(path, model: Model, material: str, row: Mapping[str, Any]) -> Mapping[str, Any]:
    """A row of the text format under the model's own names; rows of CSV and JSON have them already."""
    if "()" not in row:
        return row
    if not model.public_names:
        raise ParameterFileError(f"{path}: model {model.name} has no names in this format; use CSV or JSON")
    values: dict[str, Any] = {}
    for name, (public, factor) in model.public_names.items():
        node, _, key = public.partition(".")
        key, _, index = key.partition(".")
        if key not in row["()"].get(node, {}):
            raise ParameterFileError(f"{path}: {material}: no {node}({key} = ...); is it of model {model.name}?")
        value = row["()"][node][key]
        try:
            values[name] = np.array(value[int(index)] if index else value, float) * factor
        except (TypeError, ValueError, IndexError):
            raise ParameterFileError(f"{path}: {material}: {node}({key} = {value}) is not what was expected") from None
    return values


def _read(path: str | os.PathLike) -> Mapping[str, Mapping[str, Any]]:
    try:
        stamp = Path(path).stat()
    except OSError as error:
        raise ParameterFileError(f"{path}: cannot be read ({error.strerror}); correct `parameters`") from None
    return _read_once(str(path), stamp.st_mtime_ns, stamp.st_size)


@lru_cache(maxsize=32)
def _read_once(path: str, _time: int, _size: int) -> Mapping[str, Mapping[str, Any]]:
    """material -> its row: parameter -> values, or {"()": {node: {key: value}}} for the text format."""
    try:
        text = Path(path).read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise ParameterFileError(f"{path}: cannot be read as text ({error})") from None
    reader = {".csv": _read_csv, ".json": _read_json}.get(Path(path).suffix.lower(), _read_public)
    rows: dict[str, Mapping[str, Any]] = {}
    try:
        for material, row in reader(path, text):
            if material in rows:
                raise ParameterFileError(f"{path}: {material} is in it twice; keep one")
            rows[material] = row
    except RecursionError:
        raise ParameterFileError(f"{path}: nested too deeply; it is no file of parameters") from None
    except csv.Error as error:
        raise ParameterFileError(f"{path}: {error}; correct the table") from None
    if not rows:
        raise ParameterFileError(f"{path}: holds no parameters")
    return rows


def _read_csv(path: str, text: str) -> Iterator[tuple[str, Mapping[str, Any]]]:
    table = csv.DictReader(text.splitlines(), skipinitialspace=True)
    if "material" not in (table.fieldnames or ()):
        raise ParameterFileError(f"{path}: has no column 'material'")
    columns = list(table.fieldnames or ())
    doubled = next((column for column in columns if columns.count(column) > 1), None)
    if doubled is not None:
        raise ParameterFileError(f"{path}: column {doubled!r} is there twice; rename one")
    groups = _groups(columns)
    both = next((stem for stem in groups if stem in columns), None)
    if both is not None:
        raise ParameterFileError(f"{path}: columns {both} and {', '.join(groups[both])[:80]}; keep one or the others")
    for line in table:
        if None in line or None in line.values():
            raise ParameterFileError(
                f"{path}: line {table.line_num}: not {len(columns)} cells; the columns are so many"
            )
        yield str(line["material"]), line | {stem: [line[name] for name in names] for stem, names in groups.items()}


def _groups(columns: list[str]) -> dict[str, list[str]]:
    """Parameter -> its columns in their order, where name_r, name_g, name_b or name_1, name_2, ... are complete."""
    found: dict[str, list[str]] = {}
    for column in columns:
        stem, _, last = column.rpartition("_")
        if stem and (last in ("r", "g", "b") or last.isdigit()):
            found.setdefault(stem, []).append(column)
    groups = {}
    for stem, names in found.items():
        for suffixes in (("r", "g", "b"), range(1, len(names) + 1)):
            ordered = [f"{stem}_{suffix}" for suffix in suffixes]
            if sorted(ordered) == sorted(names):
                groups[stem] = ordered
    return groups


def _read_json(path: str, text: str) -> Iterator[tuple[str, Mapping[str, Any]]]:
    def unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        keys = [key for key, _ in pairs]
        doubled = next((key for key in keys if keys.count(key) > 1), None) if len(set(keys)) < len(keys) else None
        if doubled is not None:
            raise ParameterFileError(f"{path}: {doubled!r:.80} is in it twice; keep one")
        return dict(pairs)

    try:
        found = json.loads(text, object_pairs_hook=unique, parse_int=float)
    except json.JSONDecodeError as error:
        raise ParameterFileError(f"{path}: line {error.lineno}: {error.msg}") from None
    if not isinstance(found, dict):
        raise ParameterFileError(f"{path}: is not {{material: {{parameter: values}}}}")
    for material, row in found.items():
        if not isinstance(row, dict):
            raise ParameterFileError(f"{path}: {material}: is not {{parameter: values}}")
        yield material, row


# The public text format ----------------------------------------------------------------------------------------------

_TOKEN = re.compile(r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?|[A-Za-z_]\w*|[()\[\],=])")


def _read_public(path: str, text: str) -> Iterator[tuple[str, Mapping[str, Any]]]:
    for number, line in enumerate(text.splitlines(), 1):
        material, equals, rest = line.partition("=")
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        try:
            if not equals or not material.strip():
                raise ValueError("is no `material = ...`")
            nodes: dict[str, dict[str, Any]] = {}
            tokens = _tokens(rest)
            _call(tokens, nodes)
            if tokens:
                raise ValueError(f"has {tokens[-1]!r} behind its end")
        except ValueError as error:
            raise ParameterFileError(f"{path}: line {number}: {error}") from None
        yield material.strip(), {"()": nodes}


def _tokens(text: str) -> list[str]:
    """The tokens of a line, last first: pop() takes the next."""
    tokens, place = [], 0
    text = text.rstrip()
    while place < len(text):
        found = _TOKEN.match(text, place)
        if not found:
            raise ValueError(f"cannot be read from {text[place : place + 20]!r} on")
        tokens.append(found[1])
        place = found.end()
    return tokens[::-1]


def _take(tokens: list[str], wanted: str = "") -> str:
    token = tokens.pop() if tokens else "the end of the line"
    if wanted and token != wanted:
        raise ValueError(f"has {token!r} where {wanted!r} belongs")
    return token


def _call(tokens: list[str], nodes: dict[str, dict[str, Any]]) -> None:
    """name(argument, ...); every call's named values go into ``nodes`` under its name."""
    name = _take(tokens)
    if name in nodes:
        raise ValueError(f"has two of {name}, which no model here has")
    own = nodes.setdefault(name, {})
    _take(tokens, "(")
    while tokens and tokens[-1] != ")":
        if len(tokens) > 1 and tokens[-2] == "=":
            key = _take(tokens)
            _take(tokens, "=")
            own[key] = _value(tokens)
        else:
            _call(tokens, nodes)
        if tokens and tokens[-1] == ",":
            tokens.pop()
    _take(tokens, ")")


def _value(tokens: list[str]) -> Any:
    """A number, or a list of values."""
    token = _take(tokens)
    if token != "[":
        return float(token)
    values = []
    while tokens and tokens[-1] != "]":
        values.append(_value(tokens))
        if tokens and tokens[-1] == ",":
            tokens.pop()
    _take(tokens, "]")
    return values
