"""BRDF lobes in the incidence plane, fit against reference (as in Dupuy et al. 2015, supplemental)."""

import os
from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib import pyplot
from matplotlib.axes import Axes

from brdfatlas.constants import LUMINANCE
from brdfatlas.figures import style
from brdfatlas.measured import extend, look_up

#: incidence angles, degrees
INCIDENCE = (15, 40, 65)


def lobe(table: np.ndarray, theta_i: float, theta_o: np.ndarray) -> np.ndarray:
    """Cubic root of the luminance of a table without NaN (90, 90, 180, 3), 1/sr, in the incidence plane.

    ``theta_i`` and signed ``theta_o`` (n,) in radians; the mirror direction is theta_o = theta_i. Shape (n,).
    """
    wi = np.array([-np.sin(theta_i), 0.0, np.cos(theta_i)])
    wo = np.stack([np.sin(theta_o), np.zeros_like(theta_o), np.cos(theta_o)], -1)
    return np.cbrt(np.maximum(look_up(table, wi, wo) @ LUMINANCE, 0))


def outgoing_angles(theta_i: float) -> np.ndarray:
    """Signed theta_o in radians from -89 to 89 degrees: every degree, and ten a degree around the mirror direction."""
    coarse, fine = np.arange(-89, 89.5), np.arange(-4, 4.05, 0.1)
    degrees = np.concatenate([coarse, np.rad2deg(theta_i) + fine])
    return np.deg2rad(np.unique(np.round(degrees[np.abs(degrees) <= 89], 6)))


def plot_lobes(
    reference: np.ndarray,
    valid: np.ndarray,
    fits: Mapping[str, np.ndarray],
    path: str | os.PathLike,
    *,
    incidence: Sequence[float] = INCIDENCE,
    columns: int = 4,
) -> None:
    """Half a disc a model: the reference as filled lobes, the fit as lines, one colour for each incidence angle.

    ``reference``: (90, 90, 180, 3) in 1/sr with its mask ``valid``; ``fits``: title -> table. Radii are cubic roots of
    luminance on one scale, that of the reference; a fit beyond the edge is cut there and marked by its peak's value.
    ValueError without a fit.
    """
    if not fits:
        raise ValueError(f"{path}: no fit to draw lobes of")
    angles = [np.deg2rad(a) for a in incidence]
    outgoing = [outgoing_angles(a) for a in angles]
    reference = extend(reference, valid)
    measured = [lobe(reference, a, o) for a, o in zip(angles, outgoing)]
    limit = 1.12 * max(max(float(r.max()) for r in measured), 1e-6)
    columns = min(columns, len(fits))
    rows = -(-len(fits) // columns)
    with style.paper():
        figure, axes = pyplot.subplots(
            rows, columns, figsize=(2.35 * columns, 1.65 * rows + 0.6), squeeze=False, layout="constrained"
        )
        for axis, (title, table) in zip(axes.flat, fits.items()):
            _set_up(axis, title, limit)
            filled = extend(np.nan_to_num(table), valid)
            for n, (theta_i, theta_o, expected) in enumerate(zip(angles, outgoing, measured)):
                colour = style.COLOURS[n]
                axis.fill(*_polar(theta_o, expected), color=colour, alpha=0.28, linewidth=0)
                fitted = lobe(filled, theta_i, theta_o)
                axis.plot(*_polar(theta_o, np.minimum(fitted, limit)), color=colour, linewidth=1.1)
                axis.plot(*_polar(np.full(2, -theta_i), np.array([0.9, 1.0]) * limit), color=colour, linewidth=2.2)
                if fitted.max() > limit:
                    top = _polar(theta_o[np.argmax(fitted)], 1.01 * limit)
                    axis.annotate(f"{fitted.max() ** 3:.3g}", top, fontsize=6, color=colour, ha="left", va="bottom")
        for axis in axes.flat[len(fits) :]:
            axis.set_visible(False)
        handles, names = [], []
        for n, angle in enumerate(incidence):
            handles.append(pyplot.Rectangle((0, 0), 1, 1, color=style.COLOURS[n], alpha=0.28))
            handles.append(pyplot.Line2D([], [], color=style.COLOURS[n]))
            names += [f"reference, θi = {angle:g}°", f"fit, θi = {angle:g}°"]
        figure.legend(handles, names, loc="outside lower center", ncols=len(incidence), columnspacing=1.2)
        style.save(figure, path)


def _polar(theta, radius) -> tuple[np.ndarray, np.ndarray]:
    """Points of the plane; theta from the normal, which is up."""
    return radius * np.sin(theta), radius * np.cos(theta)


def _set_up(axis: Axes, title: str, limit: float) -> None:
    """Half a disc; its circles are labelled with BRDF values, not with their roots."""
    axis.set_aspect("equal")
    axis.set_axis_off()
    axis.set(xlim=(-1.04 * limit, 1.04 * limit), ylim=(-0.16 * limit, 1.3 * limit))
    axis.text(0, 1.13 * limit, title, ha="center", va="bottom", fontsize=9)
    half = np.linspace(-np.pi / 2, np.pi / 2, 91)
    for angle in np.deg2rad([-60, -30, 0, 30, 60]):
        axis.plot(*_polar(np.full(2, angle), np.array([0, limit])), color=style.PALE, linewidth=0.5, zorder=0)
    for value in _round_values(limit**3):
        axis.plot(*_polar(half, np.cbrt(value)), color=style.PALE, linewidth=0.5, zorder=0)
        axis.annotate(f"{value:g}", (np.cbrt(value), -0.03 * limit), fontsize=6, ha="center", va="top")
    axis.plot(*_polar(half, limit), color="#777777", linewidth=0.7, zorder=0)
    axis.plot([-limit, limit], [0, 0], color="#777777", linewidth=0.7, zorder=0)


def _round_values(largest: float) -> np.ndarray:
    """Three BRDF values of one significant digit, 1/sr, at about 35, 65 and 95 % of the radius."""
    wanted = largest * np.array([0.35, 0.65, 0.95]) ** 3
    power = 10.0 ** np.floor(np.log10(wanted))
    return np.unique(np.floor(wanted / power) * power)
