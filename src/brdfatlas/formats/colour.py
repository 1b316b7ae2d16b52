"""Spectra to linear rgb, by the colour-science library."""

from functools import cache

import numpy as np

#: What is assumed, as pages and terminal say it.
ILLUMINATION = "illuminant D65, CIE 1931 2 degrees, linear sRGB"


@cache
def _observer() -> tuple[np.ndarray, np.ndarray]:
    """Wavelengths 360 to 780 nm, and for each the rgb that reflectance 1 there adds under D65: (421,), (421, 3)."""
    with np.printoptions():  # importing it changes them for the whole process
        import colour

    shape = colour.SpectralShape(360, 780, 1)
    functions = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"].copy().align(shape).values
    light = colour.SDS_ILLUMINANTS["D65"].copy().align(shape).values
    xyz = functions * light[:, None] / (functions[:, 1] @ light)
    weights = xyz @ colour.RGB_COLOURSPACES["sRGB"].matrix_XYZ_to_RGB.T
    return shape.wavelengths, weights / weights.sum(0)  # 1 everywhere is (1, 1, 1), the white of D65


def check_wavelengths(wavelengths: np.ndarray) -> None:
    """ValueError for wavelengths (n), nm, that do not rise or do not cover the visible range from 450 to 650 nm."""
    if wavelengths.ndim != 1 or wavelengths.size < 2 or not (np.diff(wavelengths) > 0).all():
        raise ValueError("wavelengths must rise; sort them and their values")
    if wavelengths[0] > 450 or wavelengths[-1] < 650:
        raise ValueError(
            f"wavelengths from {wavelengths[0]:g} to {wavelengths[-1]:g}, 450 to 650 nm are the least; are they in nm?"
        )


def rgb_weights(wavelengths) -> np.ndarray:
    """(n, 3): ``spectra @ rgb_weights(wavelengths)`` are linear sRGB under D65, linear between wavelengths in nm and
    constant beyond the first and last. A constant spectrum is grey. ValueError as of :func:`check_wavelengths`."""
    wavelengths = np.asarray(wavelengths, float)
    check_wavelengths(wavelengths)
    fine, weights = _observer()
    hats = np.stack([np.interp(fine, wavelengths, unit) for unit in np.eye(wavelengths.size)], -1)
    return hats.T @ weights
