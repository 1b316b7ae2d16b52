"""Is a fit a possible surface? Reciprocity, energy and sane values, checked for every fit."""

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from brdfatlas.angles import above_horizon
from brdfatlas.files import shown
from brdfatlas.fits import Fit
from brdfatlas.measured import TABLE_SHAPES, look_up

#: incidence angles of the albedo, degrees; up to 89, where some models reflect several times the light that arrives
INCIDENCE = (*range(0, 86, 5), 87, 88, 89)
Evaluate = Callable[[np.ndarray, np.ndarray], np.ndarray]


@cache
def _direction_pairs(n: int = 4096, max_angle: float = np.deg2rad(85.0)) -> tuple[np.ndarray, np.ndarray]:
    """A fixed set of pairs (wi, wo), each (n, 3), within ``max_angle`` of the normal; half of them near the mirror
    direction, where BRDFs are large. Additive recurrence (R-sequence), no random numbers."""
    root = 1.1673039782614187  # the real root of x^5 = x + 1: four dimensions
    points = np.mod(0.5 + np.outer(np.arange(1, n + 1), root ** -np.arange(1.0, 5.0)), 1.0)
    cos_i, cos_o = 1 - points[:, :2].T * (1 - np.cos(max_angle))
    azimuth = 2 * np.pi * points[:, 2]
    near = np.arange(n) % 2 == 0
    spread = points[:, 3] ** 4
    theta_i = np.arccos(cos_i)
    theta_o = np.where(near, np.clip(theta_i + 0.2 * spread * np.cos(40 * azimuth), 0, max_angle), np.arccos(cos_o))
    difference = np.where(near, np.pi + 0.3 * spread, azimuth)

    def vectors(theta: np.ndarray, phi: np.ndarray) -> np.ndarray:
        return np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], -1)

    return vectors(theta_i, azimuth), vectors(theta_o, azimuth + difference)


def reciprocity_error(evaluate: Evaluate) -> float:
    """max |f(i, o) - f(o, i)| / max(|f(i, o)|, |f(o, i)|, 1e-6 / sr) over a fixed set of pairs and rgb.

    NaN if a value is not finite.
    """
    wi, wo = _direction_pairs()
    a, b = np.asarray(evaluate(wi, wo), float), np.asarray(evaluate(wo, wi), float)
    return float(np.max(np.abs(a - b) / np.maximum(np.maximum(np.abs(a), np.abs(b)), 1e-6)))


def directional_albedo(evaluate: Evaluate, theta_i: ArrayLike, *, n_theta: int = 64, n_phi: int = 96) -> np.ndarray:
    """integral of f(wi, wo) cos theta_o dwo at incidence angles ``theta_i`` (...) in radians; (..., 3).

    Gauss-Legendre points in sqrt(theta_h) and equal steps of phi_h, dwo = 4 (wi·h) dwh: dense where a highlight is, at
    h = n. For each phi_h the half vectors end where wo meets the horizon, tan of which is known, so that the integrand
    is smooth: the white surface comes out at 1 within 1e-6, a lobe of 0.5 degrees within 1e-4.
    """
    shape = np.shape(theta_i)
    theta_i = np.asarray(theta_i, float).reshape(-1, 1, 1)
    phi = ((np.arange(n_phi) + 0.5) / n_phi * 2 * np.pi)[None, :, None]
    nodes, weights = np.polynomial.legendre.leggauss(n_theta)
    sin_i, cos_i = np.sin(theta_i), np.cos(theta_i)
    # wo_z = 0 where sin_i cos(phi) sin(2 theta_h) + cos_i cos(2 theta_h) = 0
    theta_end = 0.5 * (np.arctan2(sin_i * np.cos(phi), cos_i) + np.pi / 2)
    x_end = np.sqrt(theta_end)
    x = 0.5 * x_end * (nodes + 1)
    theta_h = x * x
    measure = weights * 0.5 * x_end * 2 * x * np.sin(theta_h) * (2 * np.pi / n_phi)
    h = np.stack(np.broadcast_arrays(np.sin(theta_h) * np.cos(phi), np.sin(theta_h) * np.sin(phi), np.cos(theta_h)), -1)
    wi = np.broadcast_to(np.concatenate([sin_i, 0 * sin_i, cos_i], -1)[:, :, None, :], h.shape)
    i_h = np.sum(wi * h, -1)
    wo = 2 * i_h[..., None] * h - wi
    wo[..., 2] = np.maximum(wo[..., 2], 1e-12)
    rgb = np.asarray(evaluate(wi, wo), float)
    return np.einsum("ipt,iptc->ic", measure * 4 * i_h * wo[..., 2], rgb).reshape(*shape, 3)


def bad_cells(table: np.ndarray) -> float:
    """Share of the cells of a table (90, 90, 180 or 360, 3) above the horizon where a channel is negative or not
    finite; 0 to 1."""
    above = above_horizon()
    with np.errstate(invalid="ignore"):
        good = np.logical_and.reduce([(f >= 0) & (f < np.inf) for f in np.moveaxis(table, -1, 0)])
    halves = good.reshape(*above.shape[:2], -1, above.shape[2])
    return float(1 - np.count_nonzero(halves & above[:, :, None]) / (above.sum() * halves.shape[2]))


def physics_checks(fit_or_table: Fit | np.ndarray, table: np.ndarray | None = None) -> dict[str, Any]:
    """The checks of one fit, or of a table (90, 90, 180 or 360, 3) in 1/sr looked up between its cells.

    ``table``: the fit's own, if it is at hand. Returns reciprocity_error (:func:`reciprocity_error`), max_albedo
    [r, g, b] (maximum of :func:`directional_albedo` over incidence of 0 to 89 degrees; above 1 more light leaves than
    arrives) and bad_cells (:func:`bad_cells`). A table (90, 90, 180, 3) is reciprocal by its coordinates.

    ValueError for what is neither.
    """
    if isinstance(fit_or_table, Fit):
        evaluate = fit_or_table.evaluate
        table = fit_or_table.table() if table is None else table
    else:
        table = np.asarray(fit_or_table)
        if table.shape not in TABLE_SHAPES:
            wanted = f"a Fit, or a table {' or '.join(map(str, TABLE_SHAPES))}, is needed"
            raise ValueError(f"{shown(repr(fit_or_table)):.40}: {wanted}")
        filled = np.nan_to_num(table)

        def evaluate(wi, wo):
            return look_up(filled, wi, wo)

    with np.errstate(all="ignore"):
        return {
            "reciprocity_error": reciprocity_error(evaluate),
            "max_albedo": directional_albedo(evaluate, np.deg2rad(INCIDENCE)).max(0).tolist(),
            "bad_cells": bad_cells(table),
        }
