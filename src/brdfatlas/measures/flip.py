"""FLIP for displayed pictures (Andersson et al. 2020, "FLIP: A difference evaluator for alternating images").

Notation and numbers are the paper's (section 4; the filters of version 1.1). What FLIP needs of one picture alone is a
:class:`Seen`, so that a reference that many pictures are compared with is filtered once. All filters of a picture are
products of its spectrum, of edge-extended pixels.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy import fft

#: Pixels a degree of visual angle, FLIP's default.
SCALE = 67.0
#: Linear sRGB to XYZ (D65), each row over its sum: XYZ relative to the white.
_XYZ = np.array(
    [[10135552, 8788810, 4435075], [2613072, 8788810, 887015], [1425312, 8788810, 70074185]],
)  # fmt: skip
_XYZ = (_XYZ / _XYZ.sum(1, keepdims=True)).astype(np.float32)
#: XYZ relative to the white to Y C_x C_z (divided by 100): linear, and what Lab is of the cube roots. L and Y lose 16.
_OPPONENT = np.array([[0, 1.16, 0], [5, -5, 0], [0, 2, -2]], np.float32)
_TO_OPPONENT = (_OPPONENT @ _XYZ).T
_FROM_OPPONENT = np.linalg.inv(_TO_OPPONENT)
#: Contrast sensitivity of Y, C_x and C_z as sums of Gaussians: (a, b) each.
_SENSITIVITY = (((1.0, 0.0047),), ((1.0, 0.0053),), ((34.1, 0.04), (13.5, 0.025)))
#: Exponent q_c of colour, share p_c of the largest difference that takes p_t of the range, exponent q_f of features.
_QC, _PC, _PT, _QF = 0.7, 0.4, 0.95, 0.5
#: Width of a feature in degrees.
_FEATURE = 0.082


@dataclass(frozen=True)
class Seen:
    """A picture as FLIP compares it: Hunt-adjusted ``lab`` of the filtered colours (h, w, 3), ``features`` (2, h, w):
    strengths of edges and points. ``scale``: pixels a degree."""

    lab: np.ndarray
    features: np.ndarray
    scale: float


@lru_cache(maxsize=16)
def _filters(shape: tuple[int, int], scale: float) -> tuple[int, tuple[int, int], np.ndarray]:
    """Pixels by which a picture is extended, size of the transforms, and spectra (7, ...): of the three contrast
    sensitivities, the derivatives of first and second order across and down."""
    widest = max(b for terms in _SENSITIVITY for _, b in terms)
    sd = 0.5 * _FEATURE * scale
    radius, reach = int(np.ceil(3 * np.sqrt(widest / (2 * np.pi**2)) * scale)), int(np.ceil(3 * sd))
    pad = max(radius, reach)
    size = tuple(fft.next_fast_len(n + 2 * pad, real=True) for n in shape)

    def spectrum(down: np.ndarray, across: np.ndarray) -> np.ndarray:
        """Of the product of two filters (2 r + 1,), centred at pixel 0."""
        placed = (np.roll(np.pad(f, (0, n - f.size)), -(f.size // 2)) for f, n in zip((down, across), size))
        rows, columns = placed
        return fft.fft(rows)[:, None] * fft.rfft(columns)

    found = []
    x = np.arange(-radius, radius + 1) / scale
    for terms in _SENSITIVITY:
        parts = [(a * np.sqrt(np.pi / b), np.exp(-(np.pi**2) * x**2 / b)) for a, b in terms]
        total = sum(weight * line.sum() ** 2 for weight, line in parts)
        found.append(sum(weight / total * spectrum(line, line) for weight, line in parts))
    x = np.arange(-reach, reach + 1)
    gauss = np.exp(-(x**2) / (2 * sd**2))
    for line in (-x * gauss, (x**2 / sd**2 - 1) * gauss):
        # positive weights add up to 1, negative ones to -1
        line = np.where(line < 0, line / -line[line < 0].sum(), line / line[line > 0].sum())
        found += [spectrum(gauss / gauss.sum(), line), spectrum(line, gauss / gauss.sum())]
    return pad, size, np.array(found, np.complex64)


def _hunt_lab(relative: np.ndarray) -> np.ndarray:
    """Lab of XYZ relative to the white (..., 3), a and b scaled by L / 100."""
    root = np.where(relative > 216 / 24389, np.maximum(relative, 1e-3) ** np.float32(1 / 3), 0)
    root = np.where(relative > 216 / 24389, root, relative * np.float32(841 / 108) + np.float32(4 / 29))
    lab = 100 * (root @ _OPPONENT.T)
    lab[..., 0] -= 16
    lab[..., 1:] *= 0.01 * lab[..., :1]
    return lab


def _hyab(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    d = a - b
    return np.abs(d[..., 0]) + np.hypot(d[..., 1], d[..., 2])


def see(display: np.ndarray, scale: float = SCALE) -> Seen:
    """What :func:`flip` needs of a picture (h, w, 3) of sRGB values in [0, 1]; ``scale``: pixels a degree."""
    display = np.asarray(display, np.float32)
    height, width = display.shape[:2]
    linear = np.where(
        display <= 0.04045, display / np.float32(12.92), ((display + np.float32(0.055)) / np.float32(1.055)) ** 2.4
    )
    pad, size, filters = _filters((height, width), float(scale))
    # Y, C_x and C_z without Y's offset of 16, which filters let through and features divide out
    extended = np.pad(np.moveaxis(linear @ _TO_OPPONENT, -1, 0), [(0, 0), (pad, pad), (pad, pad)], mode="edge")
    spectra = fft.rfft2(extended, size)
    filtered = fft.irfft2(np.concatenate([spectra, spectra[[0, 0, 0, 0]]]) * filters, size)
    filtered = filtered[:, pad : pad + height, pad : pad + width]
    colour = np.clip(np.moveaxis(filtered[:3], 0, -1) @ _FROM_OPPONENT, 0, 1)
    features = np.hypot(filtered[3::2], filtered[4::2]) / np.float32(1.16)
    return Seen(_hunt_lab(colour @ _XYZ.T), features, scale)


def flip(a: Seen, b: Seen) -> np.ndarray:
    """FLIP per pixel, (h, w) float32 in [0, 1]. ValueError for pictures seen at different scales."""
    if a.scale != b.scale:
        raise ValueError(f"pictures seen at {a.scale:g} and {b.scale:g} pixels a degree")
    green, blue = _hunt_lab(np.eye(3, dtype=np.float32)[1:] @ _XYZ.T)
    largest = float(_hyab(green, blue)) ** _QC
    colour, knee = _hyab(a.lab, b.lab) ** np.float32(_QC), _PC * largest
    colour = np.where(colour < knee, colour * (_PT / knee), _PT + (colour - knee) * ((1 - _PT) / (largest - knee)))
    feature = np.minimum((np.abs(a.features - b.features).max(0) / np.float32(np.sqrt(2))) ** np.float32(_QF), 1)
    return colour ** (1 - feature)
