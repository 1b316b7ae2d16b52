"""Laws of a ranking under noise: what is below the detection limit cannot lose, and no order inverts there."""

import itertools

import numpy as np
import pandas as pd
import pytest

from brdfatlas.measures.errors import DETECTION, psnr
from brdfatlas.measures.ranking import RANKED, SIGNIFICANT, best_rows, count_missing, significant

INF = float("inf")


def reported(mse: float, error: float) -> tuple[float, float]:
    """PSNR and its error as the tables have them, for an estimate of the MSE (errors.linear_errors)."""
    if mse < DETECTION * error:
        return psnr(1.0, max(mse, 0.0) + DETECTION * error), INF
    return psnr(1.0, mse), 10 / np.log(10) * error / mse


def test_the_order_of_two_errors_never_inverts_at_the_detection_limit():
    """A smaller MSE is never significantly worse, on whichever side of the limit the two lie."""
    grid = [(mse, error) for error in (1e-5, 1e-4) for mse in error * np.linspace(-1, 6, 57)]
    for (mse, error), (other, _) in itertools.product(grid, grid):
        if mse >= other:
            continue
        (a, a_error), (b, b_error) = reported(mse, error), reported(other, error)
        if a < b:
            assert not significant(a, a_error, b, b_error)


def test_telling_apart_is_symmetric_and_needs_two_joint_errors():
    rng = np.random.default_rng(0)
    a, b = rng.uniform(20, 60, (2, 500))
    a_error, b_error = np.where(rng.random((2, 500)) < 0.2, INF, rng.uniform(0, 5, (2, 500)))
    np.testing.assert_array_equal(significant(a, a_error, b, b_error), significant(b, b_error, a, a_error))
    finite = np.isfinite(a_error + b_error)
    expected = np.abs(a - b) > SIGNIFICANT * np.hypot(a_error, b_error)
    np.testing.assert_array_equal(significant(a, a_error, b, b_error)[finite], expected[finite])


@pytest.mark.parametrize(
    ("a", "b", "apart"),
    [
        ((40, INF), (60, 0.1), False),  # the bound may be anything above 40
        ((40, INF), (60, INF), False),
        ((60, INF), (40, 0.1), True),  # a bound stands for itself against what lies below
        ((60, INF), (59.9, 0.1), False),
        ((INF, 0), (60, 1), True),
        ((INF, 0), (60, INF), False),
        ((INF, 0), (INF, 0), False),
        ((40, np.nan), (41, np.nan), True),  # one batch: no error is known
    ],
)
def test_bounds_and_exact_matches(a, b, apart):
    assert significant(*a, *b) == apart


def table(rows) -> pd.DataFrame:
    columns = ["material", "model", "scene", "status", "psnr_db", "psnr_se_db"]
    return pd.DataFrame(rows, columns=columns)


def test_the_best_of_a_picture_is_shared_by_all_that_are_indistinguishable_from_it():
    rows = [
        ("a", "top", "s", "ok", 50.0, 0.3),
        ("a", "near", "s", "ok", 49.5, 0.3),
        ("a", "below", "s", "ok", 48.0, 0.3),
        ("a", "bound", "s", "ok", 30.0, INF),
        ("a", "failed", "s", "failed", np.nan, np.nan),
        ("a", "reference_again", "s", "ok", 99.0, 0.1),
        ("b", "below", "s", "ok", 20.0, 0.1),
    ]
    models = ["top", "near", "below", "bound", "failed"]
    best = best_rows(table(rows), models, measure="psnr_db")
    assert set(zip(best["material"], best["model"])) == {("a", "top"), ("a", "near"), ("a", "bound"), ("b", "below")}
    assert best_rows(table(rows)[:0], models, measure="psnr_db").empty


def test_a_model_lacks_what_any_other_has_and_not_what_all_lack():
    rows = [
        ("a", "x", "s", "ok", 50.0, 0.3),
        ("b", "x", "s", "failed", np.nan, np.nan),
        ("c", "x", "s", "failed", np.nan, np.nan),
        ("a", "y", "s", "ok", 50.0, 0.3),
        ("b", "y", "s", "ok", 50.0, 0.3),
        ("c", "y", "s", "failed", np.nan, np.nan),
        ("c", "reference_again", "s", "ok", 99.0, 0.1),
    ]
    assert count_missing(table(rows), ["x", "y"]) == {"x": 1, "y": 0}


def shared_noise(rng, truth=(3.0, 3.2), common=0.3, own=0.02):
    """dE00 of two models of a picture whose errors are mostly shared, and the standard error of their difference."""
    shift = rng.normal(0, common)
    a, b = (value + shift + rng.normal(0, own) for value in truth)
    rows = [("a", name, "s", "ok", value, np.hypot(common, own)) for name, value in (("x", a), ("y", b))]
    errors = pd.DataFrame(rows, columns=["material", "model", "scene", "status", "de00_mean", "de00_se"])
    pairs = pd.DataFrame({"material": ["a"], "scene": ["s"], "model": ["y"], "other": ["x"], "de00_se": [own * 2**0.5]})
    return errors, pairs


def test_models_of_one_picture_differ_by_the_error_of_their_difference():
    """A difference of 7 of its own standard errors, half of one of two independent ones."""
    rng = np.random.default_rng(1)
    for _ in range(20):
        errors, pairs = shared_noise(rng)
        assert list(best_rows(errors, ["x", "y"], measure="de00_mean", pairs=pairs)["model"]) == ["x"]
        assert list(best_rows(errors, ["x", "y"], measure="de00_mean")["model"]) == ["x", "y"]


def test_equal_models_do_not_differ_by_the_error_of_their_difference():
    rng, wrong = np.random.default_rng(2), 0
    for _ in range(400):
        errors, pairs = shared_noise(rng, truth=(3.0, 3.0))
        wrong += len(best_rows(errors, ["x", "y"], measure="de00_mean", pairs=pairs)) < 2
    assert 0.02 < wrong / 400 < 0.08  # two standard errors: 4.6 %


@pytest.mark.parametrize(("measure", "better", "worse"), [("de00_mean", 2.0, 2.6), ("flip_mean", 0.1, 0.13)])
def test_a_margin_is_a_ratio_of_errors_in_db(measure, better, worse):
    ranked = RANKED[measure]
    assert ranked.margin(better, worse) == pytest.approx(20 * np.log10(1.3))
    assert ranked.margin(worse, better) == -ranked.margin(better, worse)
    assert ranked.margin(0.0, worse) == INF
    assert ranked.margin(0.0, 0.0) == 0


def test_margins_of_ssim_and_psnr():
    assert RANKED["ssim"].margin(0.99, 0.9) == pytest.approx(20)  # a tenth of the distance to 1
    assert RANKED["psnr_db"].margin(45.0, 40.0) == 5
