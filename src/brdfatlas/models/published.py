"""Figures that others published, as tables with their source: config/published, carried inside the package.

``published_data`` beside the package's modules links to config/published in a checkout; an installed
package has a copy.
"""

import difflib
from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd

FOLDER = Path(__file__).parent.parent / "published_data"
BILGILI2011 = "Bilgili, Öztürk and Kurt 2011, supplemental material"
#: The models whose published parameters are here.
THREE_LOBE = ("ashikhmin_shirley", "cook_torrance", "edwards", "ward", "ward_duer")


class UnknownMaterialError(KeyError):
    """A material without published figures; the message is one line with near matches."""

    def __str__(self) -> str:
        return str(self.args[0])


@cache
def _table(model: str) -> pd.DataFrame:
    return pd.read_csv(FOLDER / "bilgili2011" / f"{model}.csv", index_col="material")


def published_names() -> list[str]:
    """The 100 materials of the MERL database, spelled as the stems of its files."""
    return list(_table("psnr").index)


def published_table(model: str) -> pd.DataFrame:
    """All published fits of one model of :data:`THREE_LOBE`: materials × (kd_r .. ks_b, shape numbers, psnr_db).

    Source: Bilgili et al. 2011, supplemental tables. ValueError for a model without such a table.
    """
    if model not in THREE_LOBE:
        raise ValueError(f"no published parameters for model {model!r}; there are for {', '.join(THREE_LOBE)}")
    return _table(model).copy()


def published_parameters(model: str, material: str) -> dict[str, np.ndarray]:
    """The published fit in the form of the model's own parameters: kd (3,), ks (3,) and (3,) per shape number.

    float64, because float32 is our choice of storage and not the paper's. Raises UnknownMaterialError (one line,
    with near matches) or ValueError for a model without a table.
    """
    table = published_table(model)
    check_name(material)
    row = table.loc[material]
    parameters = {name: np.array([row[f"{name}_{c}"] for c in "rgb"], float) for name in ("kd", "ks")}
    for column in table.columns:
        if column.endswith("_1"):
            name = column[:-2]
            parameters[name] = np.array([row[f"{name}_{j}"] for j in (1, 2, 3)], float)
    return parameters


def published_psnr(material: str) -> dict[str, float]:
    """Published PSNR in dB by model (scene unknown); models whose caption did not survive are left out."""
    check_name(material)
    return {str(k): float(v) for k, v in _table("psnr").loc[material].items() if np.isfinite(v)}


def published_means() -> pd.DataFrame:
    """quantity, model, value, unit, materials, conditions, source: the summary figures of the papers."""
    return pd.read_csv(FOLDER / "means.csv")


def check_name(material: str) -> None:
    """Raise UnknownMaterialError unless ``material`` is one of the 100."""
    names = published_names()
    if material in names:
        return
    near = difflib.get_close_matches(material.lower().replace("_", "-"), names, n=3)
    hint = f"did you mean {' or '.join(near)}?" if near else f"the {len(names)} names start with {', '.join(names[:3])}"
    raise UnknownMaterialError(f"unknown material {material!r}; {hint}")
