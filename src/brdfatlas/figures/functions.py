"""Fresnel, NDF and Smith G1 of the fits that have them (as in Dupuy et al. 2015, supplemental)."""

import os
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from matplotlib import pyplot

from brdfatlas import microfacet
from brdfatlas.angles import theta_d_centres, theta_h_centres
from brdfatlas.figures import style
from brdfatlas.fits import Fit


@dataclass(frozen=True)
class Functions:
    """The functions of one fit: ``fresnel`` (90, 3) at the theta_d cells, ``ndf`` (90,) in 1/sr at the theta_h cells,
    ``g1`` (90,) at the angles ``theta`` (90,) in radians."""

    fresnel: np.ndarray
    ndf: np.ndarray
    theta: np.ndarray
    g1: np.ndarray


def functions_of(fit: Fit) -> Functions | None:
    """The functions of a fit of tabulated, gaussian or ggx; None for every other model."""
    theta_h, theta = theta_h_centres(), np.linspace(0, np.deg2rad(89.5), 90)
    if fit.model == "tabulated":
        ndf = np.asarray(fit.parameters["ndf"], float)
        g1 = microfacet.smith_g1(microfacet.smith_sigma(ndf), np.cos(theta))
    elif fit.model == "gaussian":
        alpha = float(fit.parameters["alpha"][0])
        ndf, g1 = microfacet.beckmann_ndf(np.cos(theta_h), alpha), microfacet.beckmann_g1(np.cos(theta), alpha)
    elif fit.model == "ggx":
        alpha = float(fit.parameters["alpha"][0])
        ndf, g1 = microfacet.ggx_ndf(np.cos(theta_h), alpha), microfacet.ggx_g1(np.cos(theta), alpha)
    else:
        return None
    return Functions(np.asarray(fit.parameters["fresnel"], float), np.asarray(ndf, float), theta, np.asarray(g1, float))


def plot_functions(
    fit: Fit, path: str | os.PathLike, *, others: Mapping[str, Fit] | None = None, title: str = ""
) -> bool:
    """Three plots side by side: F(theta_d) in red, green and blue, D(theta_h), G1(theta).

    ``others``: fits whose D and G1 are drawn thinly for comparison, by title. Returns False, and writes nothing, for a
    model without such functions.
    """
    own = functions_of(fit)
    if own is None:
        return False
    compared = {name: f for name, other in (others or {}).items() if (f := functions_of(other)) is not None}
    with style.paper():
        figure, (fresnel, ndf, g1) = pyplot.subplots(1, 3, figsize=(8.4, 2.5), layout="constrained")
        degrees = np.rad2deg(theta_d_centres())
        for channel, (colour, name, line) in enumerate(zip(style.RGB, ("R", "G", "B"), ("-", "--", ":"))):
            fresnel.plot(degrees, own.fresnel[:, channel], color=colour, linestyle=line, label=name)
        fresnel.set(
            xlabel="θd (degrees)", ylabel="Fresnel F", xlim=(0, 90), ylim=(0, max(1.02, own.fresnel.max() * 1.02))
        )
        fresnel.legend(loc="upper left")
        theta_h = np.rad2deg(theta_h_centres())
        ndf.plot(theta_h, own.ndf, color=style.INK, label=title or fit.model, zorder=3)
        g1.plot(np.rad2deg(own.theta), own.g1, color=style.INK, zorder=3)
        for number, (name, other) in enumerate(compared.items()):
            look = {"color": style.COLOURS[number], "linestyle": style.LINES[1 + number % 3], "linewidth": 1.0}
            ndf.plot(theta_h, other.ndf, label=name, **look)
            g1.plot(np.rad2deg(other.theta), other.g1, **look)
        # five decades hold all that a picture shows of a highlight; theta_h is spaced as the measurements are
        top = max([own.ndf.max(), *(other.ndf.max() for other in compared.values())])
        ndf.set(
            xlabel="θh (degrees)",
            ylabel="NDF D (1/sr)",
            yscale="log",
            ylim=(max(top, 1e-12) * 1e-6, max(top, 1e-12) * 2),
        )
        ndf.set_xscale("function", functions=(lambda x: np.sqrt(np.maximum(x, 0)), np.square))
        ndf.set_xticks([0, 1, 5, 15, 30, 60, 90])
        ndf.set_xlim(0, 90)
        if compared:
            ndf.legend(loc="upper right")
        g1.set(xlabel="θ (degrees)", ylabel="Smith G1", xlim=(0, 90), ylim=(0, 1.02))
        for axis in (fresnel, g1):
            axis.set_xticks([0, 30, 60, 90])
        style.save(figure, path)
    return True
