"""Materials for tests of rendering: analytic, asymmetric in phi_d, with holes like a measurement's."""

from functools import cache

import numpy as np
import pytest

from brdfatlas.angles import above_horizon, grid_axes, grid_cosines
from brdfatlas.measured import Measured


def variant(name="llvm_ad_rgb"):
    """Mitsuba in a variant; the test is skipped where no libLLVM can be had."""
    from brdfatlas.rendering import use_variant
    from brdfatlas.rendering.llvm import LlvmError

    try:
        return use_variant(name)
    except LlvmError as error:
        pytest.skip(str(error))


@cache
def material(alpha: float, diffuse: float = 0.2, specular: float = 0.5) -> Measured:
    """A GGX-like lobe on a diffuse ground, tinted by phi_d, unmeasured near the horizon and in a few holes."""
    theta_h, theta_d, phi_d = grid_axes()
    cos_i, cos_o = grid_cosines()
    tan2 = np.tan(theta_h) ** 2
    ndf = 1 / (np.pi * alpha**2 * np.cos(theta_h) ** 4 * (1 + tan2 / alpha**2) ** 2)
    fresnel = specular + (1 - specular) * (1 - np.cos(theta_d)) ** 5
    lobe = ndf * fresnel / (4 * np.maximum(cos_i * cos_o, 0.05))
    tint = 1 + 0.3 * np.sin(theta_d) ** 2 * np.cos(2 * phi_d + 0.7)
    table = np.stack([diffuse * c / np.pi + lobe * tint for c in (1.0, 0.7, 0.4)], -1).astype(np.float32)
    rng = np.random.default_rng(1)
    valid = above_horizon() & (cos_i > 0.05) & (cos_o > 0.05) & (rng.random(table.shape[:3]) > 0.001)
    table[~valid] = np.nan
    return Measured(f"test-{alpha}", table)


def z_limit(count: int, significance: float = 0.01) -> float:
    """The |z| that ``count`` independent tests exceed together with this probability (Šidák)."""
    from scipy.stats import norm

    return float(norm.isf(0.5 * (1 - (1 - significance) ** (1 / count))))
