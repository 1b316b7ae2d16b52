"""Weights and measures: against slow definitions, limits and laws."""

import numpy as np
import pytest

from brdfatlas import objectives
from brdfatlas.angles import above_horizon, grid_axes, grid_cosines, half_difference, theta_h_centres


@pytest.fixture(scope="module")
def table():
    theta_h, theta_d, phi_d = grid_axes()
    base = 0.1 + 5 * np.exp(-((theta_h / 0.1) ** 2)) + 0.1 * theta_d + 0 * phi_d
    values = (base[..., None] * [1.0, 0.5, 0.0]).astype(np.float32)
    values[~above_horizon()] = np.nan
    return values


def test_weighted_median_is_the_median_for_equal_weights_and_repeats_for_whole_weights():
    rng = np.random.default_rng(0)
    values, weights = rng.random(101), rng.integers(1, 5, 101)
    assert objectives.weighted_median(values, np.ones(101)) == np.median(values)
    repeated = np.repeat(values, weights)
    assert objectives.weighted_median(values, weights) == np.sort(repeated)[(repeated.size - 1) // 2]


def test_the_fast_median_is_the_weighted_median():
    rng = np.random.default_rng(1)
    for _ in range(20):
        values = (10 ** rng.uniform(-6, 3, 500) * (rng.random(500) < 0.8)).astype(np.float32)
        weights = rng.random(500) * (rng.random(500) < 0.7)
        assert objectives.fast_median(values, weights) == objectives.weighted_median(values, weights)


def test_samples_beyond_89_degrees_or_invalid_have_no_weight(table):
    weights = objectives.compressive_weights(table)
    cos_i, cos_o = grid_cosines()
    out = (np.minimum(cos_i, cos_o) < np.cos(np.deg2rad(89))) | np.isnan(table[..., 0])
    assert (weights[out] == 0).all()
    assert (weights[~out][:, :2] > 0).all()


def test_compressive_weight_is_the_papers_formula(table):
    importance = objectives.importance_weight(above_horizon())
    weights = objectives.compressive_weights(table)[..., 0]
    median = objectives.weighted_median(np.nan_to_num(table[..., 0]), importance)
    for cell in [(0, 40, 90), (30, 30, 90), (60, 10, 90)]:
        x = float(table[(*cell, 0)]) / median
        f = (1 - np.exp(-np.log(2) * x)) / np.log(2)
        assert weights[cell] == pytest.approx(importance[cell] * (f / x) ** 1.4, rel=1e-5)


def test_a_negative_zero_is_a_zero(table):
    dark = np.where(np.random.default_rng(0).random(table.shape) < 0.4, np.float32(0), table)
    expected = objectives.compressive_weights(dark)
    np.testing.assert_array_equal(objectives.compressive_weights(np.where(dark == 0, -dark, dark)), expected)


def test_no_compression_at_power_zero_and_in_a_dark_channel(table):
    importance = objectives.importance_weight(above_horizon())
    np.testing.assert_array_equal(objectives.compressive_weights(table, power=0)[..., 0], importance)
    np.testing.assert_array_equal(objectives.compressive_weights(table)[..., 2], importance)


def test_measures_are_zero_for_equal_tables_grow_with_the_error_and_ignore_invalid_cells(table):
    weights = objectives.compressive_weights(table)
    measures = {
        "relative": lambda f: objectives.relative_objective(f, table, weights),
        "log": lambda f: objectives.log_deviation(f, table),
        "e2": lambda f: objectives.loew_e2(f, table),
        "cosine": lambda f: objectives.cosine_weighted(f, table),
    }
    for name, measure in measures.items():
        assert measure(table) == 0, name
        errors = [measure(table * factor) for factor in (1.01, 1.1, 2.0)]
        assert errors[0] < errors[1] < errors[2], name
        spoilt = np.where(np.isnan(table), np.float32(1e6), table * 1.1).astype(np.float32)
        assert measure(spoilt) == pytest.approx(errors[1], rel=1e-6), name


def test_log_deviation_is_symmetric(table):
    assert objectives.log_deviation(table, table * 2) == objectives.log_deviation(table * 2, table)


def test_e2_is_a_mean_over_direction_pairs_and_not_over_the_cells_of_the_file():
    """An error of 1 in ln(1 + rho cos) in one channel scores the share of random direction pairs that show it."""
    rng = np.random.default_rng(0)
    z, phi = rng.random((2, 200_000)), 2 * np.pi * rng.random((2, 200_000))
    sine = np.sqrt(1 - z**2)
    wi, wo = np.stack([sine * np.cos(phi), sine * np.sin(phi), z], -1)
    theta_h, theta_d, _ = half_difference(wi, wo)
    limit = np.deg2rad(80)
    counted = (theta_h <= limit) & (theta_d <= limit)
    base = np.where(above_horizon()[..., None], np.float32(0.1), np.float32(np.nan)) * np.ones(3, np.float32)
    cos_i = np.maximum(grid_cosines()[0], np.float32(1e-4))
    for edge in (5, 22, 50):
        inside = theta_h_centres() <= np.deg2rad(edge)
        changed = base.copy()
        shifted = (np.exp(1 + np.log1p(base[..., 0] * cos_i)) - 1) / cos_i
        changed[inside, ..., 0] = shifted[inside]
        share = (counted & (theta_h <= np.deg2rad(edge))).sum() / counted.sum()
        spread = np.sqrt(share * (1 - share) / counted.sum())
        # random pairs within four standard errors, and half a cell of theta_h at the edge
        cell = np.deg2rad(edge) * 2 / (90 * np.sqrt(edge / 90))
        assert objectives.loew_e2(changed, base) == pytest.approx(
            share, abs=4 * spread + 2 * share * cell / np.deg2rad(edge)
        )
