"""Diffuseness: the law of a known lobe, its order in roughness, and materials without a lobe."""

import numpy as np
import pytest

from brdfatlas.angles import above_horizon, grid_axes, theta_h_centres
from brdfatlas.measured import Measured
from brdfatlas.measures.diffuseness import diffuseness, material_class, mean_of_d


def material(base):
    table = np.repeat(np.broadcast_to(base, (90, 90, 180))[..., None], 3, -1).astype(np.float32)
    table[~above_horizon()] = np.nan
    return Measured("m", table)


def test_mean_of_d_of_known_lobes():
    assert mean_of_d(np.ones(90)) == pytest.approx(np.pi, rel=1e-3)
    exponent = 50  # 2 pi int cos^n cos sin = 2 pi / (n + 2), relative to the first cell's centre
    assert mean_of_d(np.cos(theta_h_centres()) ** exponent) == pytest.approx(2 * np.pi / 52, rel=1e-2)


def test_a_separable_material_returns_its_own_d():
    theta_h, theta_d, _ = grid_axes()
    lobe = np.exp(-((theta_h / 0.3) ** 2))
    found = diffuseness(material(0.05 + 2 * lobe * (1 - 0.5 * np.sin(theta_d))))
    assert found == pytest.approx(mean_of_d(lobe.ravel()), rel=0.1)


def test_rougher_is_more_diffuse_and_classes_follow():
    theta_h, _, _ = grid_axes()
    found = [diffuseness(material(0.01 + 30 * np.exp(-((theta_h / width) ** 2)))) for width in (0.005, 0.25, 1.5)]
    assert found == sorted(found)
    assert [material_class(value) for value in found] == ["specular", "glossy", "diffuse"]


@pytest.mark.parametrize("level", [0.0, 0.3])
def test_dark_and_constant_materials_are_diffuse(level):
    assert material_class(diffuseness(material(level))) == "diffuse"
