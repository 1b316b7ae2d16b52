"""A fit as JSON: what it is, where it comes from, every parameter with its shape, unit and meaning."""

import os
from pathlib import Path
from typing import Any

import numpy as np

from brdfatlas.files import read_json, write_json
from brdfatlas.fits import Fit

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
            # str() of a float32 is its shortest decimal; float() of a float32 shows digits it does not have
            "values": np.vectorize(lambda x: float(str(x)), otypes=[float])(array).tolist(),
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
    """Write :func:`fit_as_json`, whole or not at all."""
    write_json(path, fit_as_json(fit))


def import_json(path: str | os.PathLike) -> Fit:
    """Read what :func:`export_json` wrote: the same fit. ValueError names the file and what is wrong with it."""
    path = Path(path)
    try:
        value = read_json(path)
    except FileNotFoundError:
        raise ValueError(f"{path}: no such file") from None
    except ValueError as error:
        raise ValueError(f"{path}: not JSON ({error})") from None
    if not isinstance(value, dict) or value.get("format") != FORMAT:
        raise ValueError(f"{path}: not a {FORMAT!r}")
    try:
        parameters = {
            name: np.array(item["values"], item["dtype"]).reshape(item["shape"])
            for name, item in value["parameters"].items()
        }
        labels = {"entry": value.get("entry") or "", "source": value.get("source")}
        return Fit(value["model"], value["material"], parameters, value["options"], bool(value["standin"]), **labels)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise ValueError(f"{path}: damaged ({type(error).__name__}: {error})") from None
