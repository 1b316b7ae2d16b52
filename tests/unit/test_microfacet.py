"""Laws of the shared microfacet parts."""

import numpy as np
import pytest

from brdfatlas import microfacet
from brdfatlas.angles import theta_h_centres

ANGLES = np.deg2rad(np.array([0.0, 10, 30, 50, 70, 85]))
NDFS = {
    "beckmann": (microfacet.beckmann_ndf, microfacet.beckmann_g1),
    "ggx": (microfacet.ggx_ndf, microfacet.ggx_g1),
}


def hemisphere(n_theta: int = 2000, n_phi: int = 256):
    """Midpoint quadrature of the hemisphere in (sqrt(theta), phi): unit vectors and solid angles."""
    root = (np.arange(n_theta) + 0.5) / n_theta * np.sqrt(np.pi / 2)
    theta, phi = np.meshgrid(root**2, (np.arange(n_phi) + 0.5) / n_phi * 2 * np.pi, indexing="ij")
    weight = np.sin(theta) * (2 * root * np.sqrt(np.pi / 2) / n_theta)[:, None] * 2 * np.pi / n_phi
    return np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], -1), weight


@pytest.mark.parametrize("kind", NDFS)
@pytest.mark.parametrize("alpha", [0.05, 0.2, 0.6])
def test_ndf_is_normalised(kind, alpha):
    h, weight = hemisphere(n_phi=1)
    assert (NDFS[kind][0](h[..., 2], alpha) * h[..., 2] * weight).sum() == pytest.approx(1, abs=2e-5)


@pytest.mark.parametrize("kind", NDFS)
@pytest.mark.parametrize("alpha", [0.05, 0.2, 0.6])
def test_closed_g1_projects_the_area_of_the_surface(kind, alpha):
    """The visible area: int G1 (k·h)+ D dw_h = cos theta_k, with G1 independent of h (Smith)."""
    ndf, g1 = NDFS[kind]
    h, weight = hemisphere()
    for angle in ANGLES:
        k = np.array([np.sin(angle), 0, np.cos(angle)])
        sigma = (np.maximum(h @ k, 0) * ndf(h[..., 2], alpha) * weight).sum()
        assert g1(np.cos(angle), alpha) * sigma == pytest.approx(np.cos(angle), rel=1e-4)


@pytest.mark.parametrize("kind", NDFS)
@pytest.mark.parametrize("alpha", [0.05, 0.2, 0.6])
def test_tabulated_g1_agrees_with_the_closed_form(kind, alpha):
    ndf, g1 = NDFS[kind]
    sigma = microfacet.smith_sigma(ndf(np.cos(theta_h_centres()), alpha))
    cosine = np.cos(np.linspace(0, np.deg2rad(89), 500))
    # 90 rows resolve alpha = 0.05 to about 1e-3
    np.testing.assert_allclose(microfacet.smith_g1(sigma, cosine), g1(cosine, alpha), atol=2e-3)


def test_phi_integral_equals_brute_force():
    rng = np.random.default_rng(0)
    a, b = rng.uniform(0, np.pi / 2, (2, 50))
    phi = (np.arange(20000) + 0.5) / 20000 * 2 * np.pi
    dot = np.cos(a)[:, None] * np.cos(b)[:, None] + np.sin(a)[:, None] * np.sin(b)[:, None] * np.cos(phi)
    brute = np.maximum(dot, 0).mean(1) * 2 * np.pi
    closed = microfacet.phi_integral(np.cos(a), np.sin(a), np.cos(b), np.sin(b))
    np.testing.assert_allclose(closed, brute, atol=1e-6)
    assert microfacet.phi_integral(0.0, 1.0, 0.0, 1.0) == pytest.approx(2)  # both grazing: int max(0, cos)


def test_dielectric_agrees_with_fresnel_equations():
    """Against the two polarisations written with Snell's law."""
    theta = np.linspace(0, np.deg2rad(89.9), 200)
    for eta in (1.04, 1.5, 3.0, 100.0):
        inside = np.arcsin(np.sin(theta) / eta)
        s = ((np.cos(theta) - eta * np.cos(inside)) / (np.cos(theta) + eta * np.cos(inside))) ** 2
        p = ((eta * np.cos(theta) - np.cos(inside)) / (eta * np.cos(theta) + np.cos(inside))) ** 2
        np.testing.assert_allclose(microfacet.dielectric(np.cos(theta), eta), (s + p) / 2, rtol=1e-9)
    assert microfacet.dielectric(1.0, 1.5) == pytest.approx(0.04)
    assert microfacet.dielectric(0.0, 1.5) == pytest.approx(1)


def test_v_groove_is_one_at_the_normal_and_reciprocal():
    assert microfacet.v_groove(1.0, 1.0, 1.0, 1.0) == 1
    assert microfacet.v_groove(0.6, 0.2, 0.9, 0.7) == microfacet.v_groove(0.6, 0.9, 0.2, 0.7) < 1
