"""Where a material was measured: its samples over the two angles that matter most."""

import os

import numpy as np
from matplotlib import pyplot

from brdfatlas.angles import theta_d_centres, theta_h_centres
from brdfatlas.figures import style
from brdfatlas.measured import Measured


def plot_samples(measured: Measured, path: str | os.PathLike) -> bool:
    """Draw the samples of scattered data in theta_h and theta_d over the distance to the nearest one (the mean over
    phi_d, white where nothing was measured). Returns whether there are any; nothing is written where there are none."""
    if measured.samples is None or measured.distance is None:
        return False
    known = ~np.isnan(measured.distance)
    total, count = np.where(known, measured.distance, 0).sum(2), known.sum(2)
    mean = np.where(count > 0, total / np.maximum(count, 1), np.nan)
    theta_h, theta_d = np.rad2deg(theta_h_centres()), np.rad2deg(theta_d_centres())
    with style.paper():
        figure, axis = pyplot.subplots(figsize=(style.PAGE / 2, 2.6), layout="constrained")
        image = axis.pcolormesh(theta_h, theta_d, mean.T, cmap="Blues", shading="nearest", rasterized=True)
        angles = np.rad2deg(measured.samples)
        axis.plot(angles[:, 0], angles[:, 1], ".", color=style.RGB[0], markersize=1.5, rasterized=True)
        style.root_axis(axis)
        axis.set_xlabel("θh (degrees)")
        axis.set_ylabel("θd (degrees)")
        axis.grid(False)
        figure.colorbar(image, label="degrees to the nearest sample")
        style.save(figure, path)
    return True
