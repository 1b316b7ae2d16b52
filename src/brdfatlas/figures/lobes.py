"""BRDF lobes in the incidence plane, fit against reference (as in Dupuy et al. 2015, supplemental)."""

import os
import textwrap
from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib import pyplot

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
    columns: int = 5,
) -> None:
    """A plot a model, luminance (1/sr, logarithmic) over the signed outgoing angle: the reference filled, the fit as a
    line, one colour for each incidence angle. All share one scale, so that narrow and broad lobes can be read alike.

    ``reference``: (90, 90, 180, 3) in 1/sr with its mask ``valid``; ``fits``: title -> table. ValueError without a fit.
    """
    if not fits:
        raise ValueError(f"{path}: no fit to draw lobes of")
    angles = [np.deg2rad(a) for a in incidence]
    outgoing = [outgoing_angles(a) for a in angles]
    reference = extend(reference, valid)
    measured = [lobe(reference, a, o) ** 3 for a, o in zip(angles, outgoing)]
    top = max(max(float(r.max()) for r in measured), 1e-9)
    # The median of the darkest lobe lies well above the lower edge; seven decades are the most that can be read.
    low = max(min(float(np.median(r)) for r in measured) / 30, top * 1e-8)
    columns = min(columns, len(fits))
    rows = -(-len(fits) // columns)
    with style.paper():
        figure, axes = pyplot.subplots(
            rows, columns, figsize=(style.PAGE, 1.12 * rows + 0.6), squeeze=False, sharex=True, sharey=True,
            layout="constrained",
        )  # fmt: skip
        for axis, (title, table) in zip(axes.flat, fits.items()):
            filled = extend(np.nan_to_num(table), valid)
            for n, (theta_i, theta_o, expected) in enumerate(zip(angles, outgoing, measured)):
                degrees, colour = np.rad2deg(theta_o), style.COLOURS[n]
                outline = [low, *np.maximum(expected, low), low]
                axis.fill([degrees[0], *degrees, degrees[-1]], outline, color=colour, alpha=0.22, linewidth=0)
                fitted = lobe(filled, theta_i, theta_o) ** 3
                axis.plot(degrees, np.maximum(fitted, low * 1e-3), color=colour, linewidth=0.9)
            axis.set_title(textwrap.shorten(title, 28, placeholder="…"), fontsize=7, pad=2)
            axis.set(yscale="log", ylim=(low, 4 * top), xlim=(-90, 90), xticks=[-60, 0, 60])
        for axis in axes.flat[len(fits) :]:
            axis.set_visible(False)
        handles, names = [], []
        for n, angle in enumerate(incidence):
            handles.append(pyplot.Rectangle((0, 0), 1, 1, color=style.COLOURS[n], alpha=0.22))
            handles.append(pyplot.Line2D([], [], color=style.COLOURS[n]))
            names += [f"reference, θi = {angle:g}°", f"fit, θi = {angle:g}°"]
        figure.supxlabel("outgoing angle (degrees)", fontsize=7.5)
        figure.supylabel("BRDF (1/sr)", fontsize=7.5)
        figure.legend(handles, names, loc="outside upper center", ncols=len(incidence), columnspacing=1.2)
        style.save(figure, path)
