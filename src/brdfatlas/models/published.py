"""Figures that others published, as tables with their source: config/published, carried inside the package.

The folder config beside the package's modules is a link in a checkout and a copy in an installed package.
"""

import csv
import difflib
from functools import cache
from typing import Any

import numpy as np

from brdfatlas.settings import CONFIG

FOLDER = CONFIG / "published"
BILGILI2011 = "Bilgili, Öztürk and Kurt 2011, supplemental material"
#: The models whose published parameters are here.
THREE_LOBE = ("ashikhmin_shirley", "cook_torrance", "edwards", "ward", "ward_duer")


class UnknownMaterialError(KeyError):
    """A material without published figures; the message is one line with near matches."""

    def __str__(self) -> str:
        return str(self.args[0])


def _rows(name: str) -> list[dict[str, str]]:
    with open(FOLDER / name, encoding="utf-8", newline="") as handle:
        return list(csv.DictReader(handle))


@cache
def _table(model: str) -> dict[str, dict[str, float]]:
    """material -> column -> value; NaN where the source has none."""
    table = {row.pop("material"): row for row in _rows(f"bilgili2011/{model}.csv")}
    return {name: {key: float(text or "nan") for key, text in row.items()} for name, row in table.items()}


def published_names() -> list[str]:
    """The 100 materials of the MERL database, spelled as the stems of its files."""
    return list(_table("psnr"))


def published_table(model: str) -> dict[str, dict[str, float]]:
    """All published fits of one model of :data:`THREE_LOBE`: material -> kd_r .. ks_b, shape numbers, psnr_db.

    Source: Bilgili et al. 2011, supplemental tables. ValueError for a model without such a table.
    """
    if model not in THREE_LOBE:
        raise ValueError(f"no published parameters for model {model!r}; there are for {', '.join(THREE_LOBE)}")
    return {name: dict(row) for name, row in _table(model).items()}


def published_parameters(model: str, material: str) -> dict[str, np.ndarray]:
    """The published fit in the form of the model's own parameters: kd (3,), ks (3,) and (3,) per shape number.

    float64, because float32 is our choice of storage and not the paper's. Raises UnknownMaterialError (one line,
    with near matches) or ValueError for a model without a table.
    """
    table = published_table(model)
    check_published(material)
    row = table[material]
    parameters = {name: np.array([row[f"{name}_{c}"] for c in "rgb"], float) for name in ("kd", "ks")}
    for column in row:
        if column.endswith("_1"):
            name = column[:-2]
            parameters[name] = np.array([row[f"{name}_{j}"] for j in (1, 2, 3)], float)
    return parameters


def published_psnr(material: str) -> dict[str, float]:
    """Published PSNR in dB by model (scene unknown); models whose caption did not survive are left out."""
    check_published(material)
    return {model: value for model, value in _table("psnr")[material].items() if np.isfinite(value)}


def published_means() -> list[dict[str, Any]]:
    """Rows of quantity, model, value, unit, materials, conditions, source: the summary figures of the papers."""
    return [row | {"value": float(row["value"]), "materials": int(row["materials"])} for row in _rows("means.csv")]


def check_published(material: str) -> None:
    """Raise UnknownMaterialError unless ``material`` is one of the 100."""
    names = published_names()
    if material in names:
        return
    near = difflib.get_close_matches(material.lower().replace("_", "-"), names, n=3)
    hint = f"did you mean {' or '.join(near)}?" if near else f"the {len(names)} names start with {', '.join(names[:3])}"
    raise UnknownMaterialError(f"unknown material {material!r}; {hint}")
