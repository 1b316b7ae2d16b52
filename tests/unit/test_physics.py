"""Reciprocity, energy and sane cells of a fit."""

import numpy as np
import pytest
from scipy.integrate import dblquad

from brdfatlas.angles import GRID_SHAPE, above_horizon
from brdfatlas.measures.physics import INCIDENCE, bad_cells, directional_albedo, physics_checks, reciprocity_error

ANGLES = np.deg2rad(INCIDENCE)


def white(wi, wo):
    return np.full((*wi.shape[:-1], 3), 1 / np.pi)


def ggx(alpha):
    """Torrance-Sparrow with F = 1 and the separable Smith G of GGX, written from the textbook."""

    def evaluate(wi, wo):
        h = wi + wo
        cos_h = h[..., 2] / np.linalg.norm(h, axis=-1)
        ndf = alpha**2 / (np.pi * (cos_h**2 * (alpha**2 - 1) + 1) ** 2)

        def g1(cosine):
            return 2 / (1 + np.sqrt(1 + alpha**2 * (1 / cosine**2 - 1)))

        i, o = wi[..., 2], wo[..., 2]
        return np.repeat((ndf * g1(i) * g1(o) / (4 * i * o))[..., None], 3, -1)

    return evaluate


def test_a_white_surface_reflects_all_light():
    # smooth integrand in the half vector's coordinates: Gauss-Legendre is exact to many digits
    np.testing.assert_allclose(directional_albedo(white, ANGLES), 1.0, rtol=1e-6)


@pytest.mark.parametrize(("alpha", "degrees"), [(0.3, 0), (0.3, 50), (0.3, 80), (0.1, 50)])
def test_albedo_equals_adaptive_quadrature_over_outgoing_directions(alpha, degrees):
    theta_i = np.deg2rad(degrees)
    wi = np.array([np.sin(theta_i), 0, np.cos(theta_i)])
    f = ggx(alpha)

    def integrand(theta, phi):
        wo = np.array([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)])
        return float(f(wi, wo)[0]) * wo[2] * np.sin(theta)

    # the mirror direction is at phi = pi; by symmetry twice the half circle
    total, _ = dblquad(integrand, np.pi / 2, np.pi, 0, np.pi / 2, epsabs=1e-6)
    rest, _ = dblquad(integrand, 0, np.pi / 2, 0, np.pi / 2, epsabs=1e-6)
    assert directional_albedo(f, theta_i)[0] == pytest.approx(2 * (total + rest), abs=2e-5)


def test_a_sharp_lobe_loses_no_energy():
    # alpha = 0.002 is a lobe of a tenth of a degree; masking loses of order alpha^2.
    np.testing.assert_allclose(directional_albedo(ggx(0.002), np.deg2rad([0, 30, 60])), 1.0, atol=2e-4)


def test_energy_of_ggx_never_exceeds_one():
    for alpha in (0.05, 0.2, 0.6):
        albedo = directional_albedo(ggx(alpha), ANGLES)
        assert np.all(albedo <= 1 + 1e-4)
        assert np.all(albedo > 0.5)


def test_reciprocity_error_measures_the_asymmetry():
    assert reciprocity_error(ggx(0.2)) < 1e-9

    def skewed(wi, wo):
        return ggx(0.2)(wi, wo) * np.where(wi[..., :1] > wo[..., :1], 1.25, 1.0)

    assert reciprocity_error(skewed) == pytest.approx(0.2, abs=1e-6)


def test_bad_cells_counts_only_above_the_horizon():
    table = np.full((*GRID_SHAPE, 3), 0.1, np.float32)
    table[~above_horizon()] = np.nan
    assert bad_cells(table) == 0
    table[10, 10, 10, 1] = -1e-9
    table[10, 10, 11, 2] = np.inf
    assert bad_cells(table) == pytest.approx(2 / above_horizon().sum())


@pytest.mark.parametrize("wrong", [None, "felt.binary", np.zeros((4, 90, 180, 3)), np.zeros((*GRID_SHAPE, 1))])
def test_what_is_neither_fit_nor_table_is_refused(wrong):
    with pytest.raises(ValueError, match=r"a Fit, or a table \(90, 90, 180, 3\)"):
        physics_checks(wrong)


def test_a_table_is_checked_like_a_fit():
    table = np.full((*GRID_SHAPE, 3), [0.1, 0.2, 1 / np.pi], np.float32)
    checks = physics_checks(table)
    assert checks["reciprocity_error"] < 1e-6
    np.testing.assert_allclose(checks["max_albedo"], np.pi * table[0, 0, 0], rtol=1e-5)
    assert checks["bad_cells"] == 0
