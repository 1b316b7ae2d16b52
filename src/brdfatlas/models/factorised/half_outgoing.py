"""Coordinates that the data-driven factorizations share: theta_h, phi, theta_o.

phi = |phi_h - phi_o| in [0, pi] is the azimuth between the half vector and wo. Lawrence et al. 2004 and Bilgili et al.
2011 index their arrays by (theta_o, phi_o, theta_h, phi_h). An isotropic BRDF does not change when both azimuths turn
together, so we measure phi_h from the azimuth of wo: everything is then constant along phi_o, whose axis has one entry,
and mirror symmetry folds phi onto half a turn. With absolute azimuths a sum of separable terms would need several
terms for each harmonic of phi_h - phi_o, and would make an isotropic material anisotropic.
"""

from functools import cache

import numpy as np

from brdfatlas.angles import directions, grid_axes
from brdfatlas.models.base import Option

Coordinates = tuple[np.ndarray, np.ndarray, np.ndarray]


def half_outgoing(wi, wo) -> Coordinates:
    """theta_h, phi, theta_o in radians of unit vectors (..., 3). phi is 0 where it is not defined."""
    wi, wo = np.broadcast_arrays(np.asarray(wi, float), np.asarray(wo, float))
    h = wi + wo
    theta_h = np.arctan2(np.hypot(h[..., 0], h[..., 1]), h[..., 2])
    theta_o = np.arctan2(np.hypot(wo[..., 0], wo[..., 1]), wo[..., 2])
    across = np.abs(h[..., 0] * wo[..., 1] - h[..., 1] * wo[..., 0])
    along = h[..., 0] * wo[..., 0] + h[..., 1] * wo[..., 1]
    return theta_h, np.arctan2(across, along), theta_o


def node_directions(theta_h, phi, theta_o) -> tuple[np.ndarray, np.ndarray]:
    """wi, wo (..., 3) with these coordinates and phi_h = 0; wi may lie below the surface, or wo behind h."""
    theta_h, phi, theta_o = np.broadcast_arrays(theta_h, phi, theta_o)
    sine = np.sin(theta_o)
    wo = np.stack([sine * np.cos(phi), -sine * np.sin(phi), np.cos(theta_o)], -1)
    h = np.stack([np.sin(theta_h), np.zeros_like(sine), np.cos(theta_h)], -1)
    return 2 * np.sum(wo * h, -1, keepdims=True) * h - wo, wo


@cache
def grid_coordinates() -> tuple[np.ndarray, np.ndarray]:
    """phi and theta_o at every cell centre of the MERL grid; two read-only float32 arrays of GRID_SHAPE."""
    theta_h, theta_d, phi_d = grid_axes()
    phi, theta_o = (np.empty((90, 90, 180), np.float32) for _ in range(2))
    for row in range(90):
        _, wo = directions(theta_h[row], theta_d[0], phi_d[0])
        # phi_h = 0 on the grid, so phi is |phi_o|
        phi[row] = np.arctan2(np.abs(wo[..., 1]), wo[..., 0])
        theta_o[row] = np.arctan2(np.hypot(wo[..., 0], wo[..., 1]), wo[..., 2])
    for values in (phi, theta_o):
        values.flags.writeable = False
    return phi, theta_o


def theta_h_nodes(n: int) -> np.ndarray:
    """n theta_h nodes, spaced quadratically like the cells of the MERL grid (equal to them for n = 90), radians."""
    return ((np.arange(n) + 0.5) / n) ** 2 * (np.pi / 2)


def phi_nodes(n: int) -> np.ndarray:
    """Centres of n equal parts of [0, pi], radians."""
    return (np.arange(n) + 0.5) / n * np.pi


def theta_o_nodes(n: int) -> np.ndarray:
    """Centres of n equal parts of [0, pi/2], radians."""
    return (np.arange(n) + 0.5) / n * (np.pi / 2)


def positions(theta_h, phi, theta_o, resolution: tuple[int, int, int]) -> Coordinates:
    """The coordinates in units of nodes, clamped to the first and last node (the nodes lie at centres)."""
    n_h, n_p, n_o = resolution
    x = np.sqrt(np.maximum(theta_h, 0) / (np.pi / 2)) * n_h - 0.5
    y, z = phi / np.pi * n_p - 0.5, theta_o / (np.pi / 2) * n_o - 0.5
    return np.clip(x, 0, n_h - 1), np.clip(y, 0, n_p - 1), np.clip(z, 0, n_o - 1)


def parse_resolution(text: str, model: str, key: str = "resolution") -> tuple[int, int, int]:
    """ "90x36x37" as (n theta_h, n phi, n theta_o). ValueError names model and key."""
    parts = str(text).lower().split("x")
    if len(parts) != 3 or not all(part.strip().isdecimal() and 2 <= int(part) <= 1024 for part in parts):
        raise ValueError(f"model {model}: {key} = {text!r} is not THETA_HxPHIxTHETA_O with whole numbers of 2 to 1024")
    n_h, n_p, n_o = (int(part) for part in parts)
    return n_h, n_p, n_o


def resolution_option(default: tuple[int, int, int]) -> Option:
    """The option "resolution", as text such as "90x36x37"."""
    return Option("x".join(map(str, default)), "nodes along theta_h x phi_h x theta_o", check=parse_resolution)
