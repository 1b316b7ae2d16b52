"""A fit as JSON: what it is, where it comes from, every parameter with its shape, unit and meaning."""

import json
import os
import re
from typing import Any

import numpy as np

from brdfatlas.files import plain, read_json, shortest_number, shown, write_text
from brdfatlas.fits import Fit, check_fit, with_source

FORMAT = "brdfatlas fit 1"


def fit_as_json(fit: Fit) -> dict[str, Any]:
    """The fit as plain values. Numbers of float32 parameters are written with the digits that give them back."""
    model = fit.instance
    described = {parameter.name: parameter for parameter in model.parameters}
    parameters = {}
    for name, array in fit.parameters.items():
        array = np.asarray(array)
        parameter = described[name]
        parameters[name] = {
            "description": parameter.description,
            "unit": parameter.unit,
            "dtype": str(array.dtype),
            "shape": list(array.shape),
            # float() of a float32 shows digits that it does not have, and np.vectorize calls float()
            "values": np.array([shortest_number(value) for value in array.ravel()]).reshape(array.shape).tolist(),
        }
    paper = model.paper
    return {
        "format": FORMAT,
        "entry": fit.entry,
        "model": fit.model,
        "source": fit.source,
        "title": model.title_of(fit.options),
        "status": model.status or "as published",
        "formula": model.formula,
        "paper": {"authors": paper.authors, "title": paper.title, "venue": paper.venue, "year": paper.year,
                  "doi": paper.doi},
        "material": fit.material,
        "standin": bool(fit.standin),
        "options": dict(fit.options),
        "bytes": fit.bytes,
        "parameters": parameters,
    }  # fmt: skip


def export_json(fit: Fit, path: str | os.PathLike) -> None:
    """Write :func:`fit_as_json`, a line a row of numbers; whole or not at all."""
    text = json.dumps(plain(fit_as_json(fit)), indent=1, ensure_ascii=False, allow_nan=False)
    rows = re.sub(r"\[\n\s+([-\d.eE+,\s]+?)\n\s*\]", lambda row: f"[{' '.join(row[1].split())}]", text)
    write_text(path, rows + "\n")


def import_json(path: str | os.PathLike, source: str | os.PathLike | None = None) -> Fit:
    """Read what :func:`export_json` wrote: the same fit. ``source``: as of :func:`.fits.load_fit`. ValueError names the
    file and what is wrong with it."""
    name = shown(path)
    try:
        value = read_json(path)
    except FileNotFoundError:
        raise ValueError(f"{name}: no such file") from None
    if not isinstance(value, dict) or value.get("format") != FORMAT:
        raise ValueError(f"{name}: not a {FORMAT!r}")
    kinds = {"model": str, "material": str, "options": dict, "standin": bool, "parameters": dict}
    for key, kind in kinds.items():
        if type(value.get(key)) is not kind:
            raise ValueError(f"{name}: damaged, it does not state its {key}; export the fit again")
    parameters = {}
    for key, item in value["parameters"].items():
        try:
            parameters[key] = _array(item)
        except (KeyError, TypeError, ValueError, OverflowError) as error:
            fault = shown(error) if isinstance(error, ValueError) else "it states no dtype, shape and values"
            raise ValueError(f"{name}: damaged, {shown(key)}: {fault}; export the fit again") from None
    labels = {key: value.get(key) for key in ("entry", "source")}
    if not all(isinstance(label, str | None) for label in labels.values()):
        raise ValueError(f"{name}: damaged, its entry or source is no text; export the fit again")
    labels["entry"] = labels["entry"] or ""
    fit = Fit(value["model"], value["material"], parameters, value["options"], value["standin"], **labels)
    fit = with_source(fit, source)
    check_fit(fit, path, trusted=bool(source))
    return fit


def _array(item: dict[str, Any]) -> np.ndarray:
    """The numbers of one parameter. ValueError, KeyError, TypeError for what :func:`fit_as_json` does not write."""
    if item["dtype"] not in ("float32", "float64", "int32", "int64"):
        raise ValueError(f"dtype {item['dtype']!r} is none of numbers")
    values = np.array(item["values"])
    if values.dtype.kind not in "fiu":
        raise ValueError("its values are not numbers alone, or rows differ in length")
    if list(values.shape) != item["shape"]:
        raise ValueError(f"its values have shape {list(values.shape)}, not {item['shape']}")
    with np.errstate(over="ignore"):
        return values.astype(item["dtype"])
