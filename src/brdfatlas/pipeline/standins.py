"""Built-in materials: stand-ins for measurements, made of published fits.

A stand-in is, cell by cell, the median of the five fits that Bilgili et al. 2011 published for that material, with
everything below the horizon invalid as in a MERL file. One of the five, Edwards, is not reciprocal: the mean of both
orders of its directions is taken, so that a stand-in is reciprocal, as a material is. It is no measurement, and
everything that shows it must say so (:attr:`Measured.standin`).
"""

import os

import numpy as np

from brdfatlas.angles import GRID_SHAPE, above_horizon
from brdfatlas.formats.merl import write_merl
from brdfatlas.measured import Measured
from brdfatlas.models.published import check_published, published_names, published_parameters
from brdfatlas.models.three_lobe.ashikhmin_shirley import AshikhminShirley
from brdfatlas.models.three_lobe.base import LobeModel
from brdfatlas.models.three_lobe.cook_torrance import CookTorrance
from brdfatlas.models.three_lobe.edwards import Edwards
from brdfatlas.models.three_lobe.ward import Ward
from brdfatlas.models.three_lobe.ward_duer import WardDuer

PUBLISHED_MODELS = (AshikhminShirley(), CookTorrance(), Edwards(), Ward(), WardDuer())


def standin_names() -> list[str]:
    """The 100 materials that have a stand-in: the names of the MERL database."""
    return published_names()


def make_standin(material: str) -> Measured:
    """The stand-in of one of the 100 materials: the per-sample median of its five published fits, 1/sr.

    Raises UnknownMaterialError (one line with near matches).
    """
    check_published(material)
    tables = [_reciprocal_table(model, material) for model in PUBLISHED_MODELS]
    table = _median_of_five(tables)
    table[~above_horizon()] = np.nan
    return Measured(material, table, standin=True)


def write_standin(material: str, path: str | os.PathLike) -> Measured:
    """Write a stand-in as a MERL ``.binary`` file and return it."""
    measured = make_standin(material)
    write_merl(path, measured.table, standin=True)
    return measured


def _reciprocal_table(model: LobeModel, material: str) -> np.ndarray:
    """A published fit on the MERL grid, the mean of both orders of the directions where it is not reciprocal.

    Swapping them turns phi_d by pi, and a mirror image turns that into pi - phi_d.
    """
    table = model.evaluate_grid(published_parameters(model.name, material))
    return table if model.reciprocal else 0.5 * (table + table[:, :, ::-1])


def _median_of_five(tables: list[np.ndarray]) -> np.ndarray:
    """By a network of minima and maxima, several times faster than a sort of five numbers in each cell."""
    a, b, c, d, e = tables
    assert a.shape == (*GRID_SHAPE, 3)
    a, b = np.minimum(a, b), np.maximum(a, b)
    c, d = np.minimum(c, d), np.maximum(c, d)
    low, high = np.maximum(a, c), np.minimum(b, d)  # neither the smallest nor the largest of the four
    return np.maximum(np.minimum(low, high), np.minimum(e, np.maximum(low, high)))
