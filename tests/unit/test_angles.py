"""Laws of the parameterisation: round trips, reciprocity, measures against quadrature over direction pairs."""

import numpy as np
import pytest

from brdfatlas import angles


def hemisphere(rng, n):
    """Directions uniform over the upper hemisphere, (n, 3)."""
    z, phi = rng.random(n), 2 * np.pi * rng.random(n)
    r = np.sqrt(1 - z * z)
    return np.stack([r * np.cos(phi), r * np.sin(phi), z], -1)


def test_grid_directions_return_their_angles():
    theta_h, theta_d, phi_d = angles.grid_axes()
    found = angles.half_difference(*angles.directions(theta_h, theta_d, phi_d))
    for value, wanted in zip(found, (theta_h, theta_d, phi_d), strict=True):
        np.testing.assert_allclose(value, np.broadcast_to(wanted, value.shape), atol=1e-12)


def test_directions_are_unit_vectors_and_mirror_about_h():
    rng = np.random.default_rng(1)
    wi, wo = angles.directions(*(rng.random((3, 1000)) * [[1.5], [1.5], [3.1]]))
    np.testing.assert_allclose(np.linalg.norm(wi, axis=-1), 1, atol=1e-12)
    h = (wi + wo) / np.linalg.norm(wi + wo, axis=-1, keepdims=True)
    np.testing.assert_allclose(2 * np.sum(wi * h, -1, keepdims=True) * h - wi, wo, atol=1e-12)


def test_angles_do_not_change_when_directions_swap_or_turn():
    rng = np.random.default_rng(2)
    wi, wo = hemisphere(rng, 1000), hemisphere(rng, 1000)
    turn = np.array([[np.cos(0.7), -np.sin(0.7), 0], [np.sin(0.7), np.cos(0.7), 0], [0, 0, 1]])
    base = angles.half_difference(wi, wo)
    for other in (angles.half_difference(wo, wi), angles.half_difference(wi @ turn.T, wo @ turn.T)):
        np.testing.assert_allclose(other[:2], base[:2], atol=1e-12)
        gap = np.abs(other[2] - base[2])
        assert np.minimum(gap, np.pi - gap).max() < 1e-7  # phi_d is a ratio of small numbers near theta_h = 0


@pytest.mark.parametrize("small", [1e-7, 1e-4])
def test_small_angles_keep_their_digits(small):
    found = angles.half_difference(*angles.directions(small, small, 1.0))
    np.testing.assert_allclose(found, [small, small, 1.0], rtol=1e-6)


def test_pair_measure_integrates_all_pairs_above_the_horizon():
    """The pairs with both directions above the surface have the measure (2 pi)^2."""
    total = (angles.pair_measure() * angles.above_horizon()).sum()
    # phi_d covers half of its circle by reciprocity; the horizon cuts cells, an error of about a cell's width
    assert 2 * total == pytest.approx((2 * np.pi) ** 2, rel=3e-3)


def test_pair_measure_weighs_cosines_as_quadrature_does():
    """Integral of cos i cos o over all pairs is pi^2."""
    cos_i, cos_o = angles.grid_cosines()
    weight = angles.pair_measure() * angles.above_horizon()
    assert 2 * (weight * cos_i * cos_o).sum() == pytest.approx(np.pi**2, rel=1e-3)


def test_slice_measure_is_the_volume_form_by_finite_differences():
    """sqrt(det J^T J) of (theta_h, theta_d, phi_d) -> (i, o) in R^6 (seed C, appendix)."""
    rng = np.random.default_rng(3)
    measure, step = angles.slice_measure(), 1e-6
    width_h, width_d, width_p = angles.cell_widths()
    for h, d, p in rng.integers(0, [90, 90, 180], (30, 3)):
        at = np.array([angles.theta_h_centres()[h], angles.theta_d_centres()[d], angles.phi_d_centres()[p]])
        columns = []
        for axis in range(3):
            shift = np.eye(3)[axis] * step
            ahead, behind = (
                np.concatenate(angles.directions(*(at + shift))),
                np.concatenate(angles.directions(*(at - shift))),
            )
            columns.append((ahead - behind) / (2 * step))
        jacobian = np.stack(columns, 1)
        volume = np.sqrt(np.linalg.det(jacobian.T @ jacobian)) * width_h[h] * width_d * width_p
        assert measure[h, d, p] == pytest.approx(volume, rel=1e-6)


def test_cell_widths_add_up_to_the_ranges():
    width_h, width_d, width_p = angles.cell_widths()
    assert width_h.sum() == pytest.approx(np.pi / 2, rel=1e-6)
    assert 90 * width_d == pytest.approx(np.pi / 2)
    assert 180 * width_p == pytest.approx(np.pi)
