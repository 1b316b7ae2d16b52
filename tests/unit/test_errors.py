"""Image and BRDF-space measures: laws of the estimators, published values of the colour difference, bad input."""

import time
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from scipy.ndimage import gaussian_filter
from skimage.metrics import structural_similarity

from brdfatlas.measures import errors
from brdfatlas.measures.errors import Tone
from brdfatlas.measures.flip import flip, see
from brdfatlas.measures.ranking import RANKED
from brdfatlas.measures.tsv import read_tsv, write_tsv
from brdfatlas.rendering.images import Render, load_render, save_render, tone_map

TONE = Tone(1.0, 2.2)


def scene(size=24, seed=0):
    """A noise-free image with a wide range and a disk as its mask."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[0:size, 0:size] / (size - 1) - 0.5
    shade = np.clip(1 - 3 * (x**2 + y**2), 0.02, None)[..., None] * np.array([0.8, 0.5, 0.3])
    shade += 6 * np.exp(-80 * ((x - 0.1) ** 2 + (y + 0.1) ** 2))[..., None]
    return shade * (1 + 0.05 * rng.random((size, size, 1))), np.hypot(x, y) < 0.45


def render(truth, mask, noise, **meta):
    """A Render whose batches are ``truth`` plus ``noise`` (n, h, w, 3)."""
    batches = (truth + noise).astype(np.float32)
    return Render(mean=batches.mean(0, dtype=np.float64).astype(np.float32), batches=batches, mask=mask, meta=meta)


def noisy_pair(offset, rng, n=8, sigma=0.3, shared=0.95):
    """Reference and fit = reference + offset, with correlated noise as from common random numbers."""
    truth, mask = scene()
    common = rng.normal(0, sigma, (n, *truth.shape))
    own = rng.normal(0, sigma, (n, *truth.shape))
    reference = render(truth, mask, common)
    image = render(truth + offset, mask, shared * common + (1 - shared) * own)
    return reference, image


def test_mse_estimate_is_unbiased_where_the_plain_one_is_not():
    rng, offset = np.random.default_rng(1), 0.02
    estimates, plain = [], []
    for _ in range(300):
        a, b = noisy_pair(offset, rng)
        products = errors.batch_products(a.batches[:, a.mask], b.batches[:, a.mask])
        estimates.append(errors.mean_squared_error(products)[0])
        plain.append(errors.mean_squared_error(products, unbiased=False)[0])
    z = (np.mean(estimates) - offset**2) / (np.std(estimates) / np.sqrt(len(estimates)))
    assert abs(z) < 4  # false alarm 6e-5
    assert (np.mean(plain) - offset**2) / (np.std(plain) / np.sqrt(len(plain))) > 10


def test_u_statistic_equals_the_slow_sum_over_pairs_of_batches():
    a, b = noisy_pair(0.1, np.random.default_rng(2), n=5)
    difference = (b.batches.astype(float) - a.batches)[:, a.mask]
    pairs = [np.mean(difference[i] * difference[j]) for i in range(5) for j in range(5) if i != j]
    products = errors.batch_products(a.batches[:, a.mask], b.batches[:, a.mask])
    value, without = errors.mean_squared_error(products)
    assert value == pytest.approx(np.mean(pairs), rel=1e-9)
    kept = [np.mean(difference[i] * difference[j]) for i in range(1, 5) for j in range(1, 5) if i != j]
    assert without[0] == pytest.approx(np.mean(kept), rel=1e-9)
    plain, _ = errors.mean_squared_error(products, unbiased=False)
    assert plain == pytest.approx(np.mean(difference.mean(0) ** 2), rel=1e-9)


@pytest.mark.parametrize("offset", [0.01, 0.2])
def test_jackknife_error_is_the_spread_of_psnr_over_repeated_renders(offset):
    rng = np.random.default_rng(3)
    rows = [errors.linear_errors(*noisy_pair(offset, rng)) for _ in range(300)]
    spread = np.std([row["psnr_db"] for row in rows])
    claimed = np.sqrt(np.mean([row["psnr_se_db"] ** 2 for row in rows]))
    # A variance from 300 draws and 300 averaged variances from 8 batches: 4 + 3 % each; the peak is the largest of
    # noisy pixels, not a smooth statistic, so the jackknife may exceed the spread, which is the safe side.
    assert 0.85 * spread < claimed < 1.5 * spread


def test_without_noise_psnr_is_the_definition():
    truth, mask = scene()
    silent = np.zeros((4, *truth.shape))
    a, b = render(truth, mask, silent), render(1.1 * truth + 0.01, mask, silent)
    expected = 10 * np.log10(a.mean[mask].max() ** 2 / np.mean((a.mean[mask].astype(float) - b.mean[mask]) ** 2))
    values = errors.linear_errors(a, b)
    assert values["psnr_db"] == pytest.approx(expected, abs=1e-4)
    assert values["psnr_se_db"] == pytest.approx(0, abs=1e-6)
    assert values["rmse"] == pytest.approx(np.sqrt(np.mean((a.mean[mask] - b.mean[mask]) ** 2)), rel=1e-4)


def test_identical_images_are_perfect_in_every_measure():
    a, _ = noisy_pair(0.0, np.random.default_rng(4))
    values = errors.image_errors(a, a, TONE)
    assert values["psnr_db"] == values["psnr_tonemapped_db"] == np.inf
    assert values["psnr_se_db"] == values["de00_mean"] == values["de00_p95"] == values["rmse"] == values["rel_mse"] == 0
    assert values["flip_mean"] == pytest.approx(0, abs=1e-6)
    assert values["ssim"] == pytest.approx(1, abs=1e-6)


def test_an_error_below_the_noise_is_a_lower_bound_and_said_to_be_one():
    rng, right, bounds = np.random.default_rng(5), 0, 0
    offset = 1e-3  # 30 times below the noise of a pixel's difference
    for _ in range(100):
        a, b = noisy_pair(offset, rng, shared=0.5)
        values = errors.linear_errors(a, b)
        truth = errors.psnr(float(a.mean[a.mask].max()), offset**2)
        if np.isinf(values["psnr_se_db"]):
            bounds += 1
            right += values["psnr_db"] < truth
        assert np.isfinite(values["psnr_db"])
    assert bounds > 80
    assert right > 0.9 * bounds  # 2 standard errors, one-sided, with a jackknife of 8: about 96 %


def test_every_measure_gets_worse_with_a_larger_perturbation():
    truth, mask = scene(48)
    silent = np.zeros((3, *truth.shape))
    a = render(truth, mask, silent)
    pattern = np.random.default_rng(6).normal(0, 1, truth.shape)
    steps = [errors.image_errors(a, render(truth * (1 + s * pattern), mask, silent), TONE) for s in (0.02, 0.05, 0.12)]
    for name in errors.IMAGE_MEASURES:
        if name in errors.PAIR_ERRORS:
            continue
        series = [step[name] for step in steps]
        better_is_higher = name.startswith("psnr") or name == "ssim"
        assert series == sorted(series, reverse=better_is_higher), name
        assert series[0] != series[-1], name


def test_symmetric_measures_do_not_care_which_image_is_the_reference():
    a, b = noisy_pair(0.05, np.random.default_rng(7))
    forth, back = errors.image_errors(a, b, TONE), errors.image_errors(b, a, TONE)
    for name in ("rmse", "de00_mean", "psnr_tonemapped_db", "ssim"):
        assert forth[name] == pytest.approx(back[name], rel=0.02), name  # the background is the reference's


def test_what_lies_outside_the_mask_counts_in_no_measure():
    a, b = noisy_pair(0.05, np.random.default_rng(8))
    before = errors.image_errors(a, b, TONE)
    outside = ~b.mask
    b.mean[outside] = 50.0
    b.batches[:, outside] = 50.0
    assert errors.image_errors(a, b, TONE) == before


def test_the_noise_floor_is_the_variance_of_two_means():
    rng, sigma, n = np.random.default_rng(9), 0.3, 8
    truth, mask = scene()
    values = []
    for _ in range(20):
        a, b = (render(truth, mask, rng.normal(0, sigma, (n, *truth.shape))) for _ in range(2))
        values.append(errors.linear_errors(a, b, unbiased=False)["rmse"] ** 2)
    # 20 x ~1000 values of variance 2 sigma^2 / n: relative error of the mean 1 %
    assert np.mean(values) == pytest.approx(2 * sigma**2 / n, rel=0.05)


def test_one_batch_gives_the_plain_error_and_no_standard_error():
    a, b = noisy_pair(0.05, np.random.default_rng(10), n=1)
    values = errors.linear_errors(a, b)
    assert values["rmse"] == pytest.approx(np.sqrt(np.mean((a.mean - b.mean)[a.mask] ** 2)), rel=1e-4)
    assert np.isnan(values["psnr_se_db"])


# Sharma, Wu and Dalal 2005, Table 1: pairs of Lab that catch the usual mistakes, and their dE00.
SHARMA = """
50 2.6772 -79.7751 50 0 -82.7485 2.0425
50 3.1571 -77.2803 50 0 -82.7485 2.8615
50 2.8361 -74.0200 50 0 -82.7485 3.4412
50 -1.3802 -84.2814 50 0 -82.7485 1.0000
50 -1.1848 -84.8006 50 0 -82.7485 1.0000
50 -0.9009 -85.5211 50 0 -82.7485 1.0000
50 0 0 50 -1 2 2.3669
50 -1 2 50 0 0 2.3669
50 2.49 -0.001 50 -2.49 0.0009 7.1792
50 2.49 -0.001 50 -2.49 0.0011 7.2195
50 2.49 -0.001 50 -2.49 0.0012 7.2195
50 -0.001 2.49 50 0.0009 -2.49 4.8045
50 -0.001 2.49 50 0.0011 -2.49 4.7461
50 2.5 0 50 0 -2.5 4.3065
50 2.5 0 73 25 -18 27.1492
50 2.5 0 61 -5 29 22.8977
50 2.5 0 56 -27 -3 31.9030
50 2.5 0 58 24 15 19.4535
50 2.5 0 50 3.1736 0.5854 1.0000
50 2.5 0 50 3.2972 0 1.0000
50 2.5 0 50 1.8634 0.5757 1.0000
50 2.5 0 50 3.2592 0.3350 1.0000
60.2574 -34.0099 36.2677 60.4626 -34.1751 39.4387 1.2644
63.0109 -31.0961 -5.8663 62.8187 -29.7946 -4.0864 1.2630
61.2901 3.7196 -5.3901 61.4292 2.2480 -4.9620 1.8731
35.0831 -44.1164 3.7933 35.0232 -40.0716 1.5901 1.8645
22.7233 20.0904 -46.6940 23.0331 14.9730 -42.5619 2.0373
36.4612 47.8580 18.3852 36.2715 50.5065 21.2231 1.4146
90.8027 -2.0831 1.4410 91.1528 -1.6435 0.0447 1.4441
90.9257 -0.5406 -0.9208 88.6381 -0.8985 -0.7239 1.5381
6.7747 -0.2908 -2.4247 5.8714 -0.0985 -2.2286 0.6377
2.0776 0.0795 -1.1350 0.9033 -0.0636 -0.5514 0.9082
"""


def test_delta_e_agrees_with_the_published_pairs():
    rows = np.array([line.split() for line in SHARMA.strip().splitlines()], float)
    got = errors.delta_e(rows[:, :3], rows[:, 3:6])
    np.testing.assert_allclose(got, rows[:, 6], atol=1e-4)  # the table's last digit
    np.testing.assert_allclose(errors.delta_e(rows[:, 3:6], rows[:, :3]), rows[:, 6], atol=1e-4)


def test_lab_of_linear_light_agrees_with_colour_science():
    colour = pytest.importorskip("colour")
    linear = np.random.default_rng(11).random((200, 3)) ** 2
    xyz = colour.RGB_to_XYZ(linear, "sRGB", apply_cctf_decoding=False)
    white = colour.CCS_ILLUMINANTS["CIE 1931 2 Degree Standard Observer"]["D65"]
    expected = colour.XYZ_to_Lab(xyz, white)
    exposure = 1 / np.log(2.0)  # so that expose() is the identity
    # The white points differ in the fourth digit: 0.95047, 1, 1.08883 against the chromaticity (0.3127, 0.3290).
    np.testing.assert_allclose(errors.displayed_lab(linear, exposure), expected, atol=0.05)


def test_delta_e_of_a_picture_is_quick():
    rng = np.random.default_rng(12)
    a = rng.random((256, 256, 3)).astype(np.float32)
    b = a * (1 + 0.1 * rng.random(a.shape, np.float32))
    delta = lambda: errors.delta_e(errors.displayed_lab(a, 1.0), errors.displayed_lab(b, 1.0))  # noqa: E731
    delta()
    start = time.thread_time()
    delta()
    assert time.thread_time() - start < 0.3  # asked: 0.1 s on an idle machine; CPU time also counts a busy cache


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda a, b: (a, Render(b.mean[:-1], b.batches[:, :-1], b.mask[:-1], {})), "different sizes"),
        (lambda a, b: (a, replace(b, batches=b.batches[:-1])), "numbers of batches"),
        (lambda a, b: (replace(a, mask=np.zeros_like(a.mask)), b), "no pixel"),
        (lambda a, b: (a, replace(b, mean=np.full_like(b.mean, np.nan))), "the image holds NaN or Inf"),
        (lambda a, b: (replace(a, mean=0 * a.mean, batches=0 * a.batches), b), "black"),
    ],
)
def test_what_cannot_be_compared_is_refused_with_a_reason(spoil, message):
    a, b = noisy_pair(0.1, np.random.default_rng(13))
    with pytest.raises(ValueError, match=message):
        errors.image_errors(*spoil(a, b), TONE)


@pytest.mark.parametrize("tone", [(0.0, 2.2), (1.0, 0.0), (-1.0, 2.2), (np.nan, 2.2), (1.0, np.inf)])
def test_a_tone_map_that_shows_nothing_is_refused(tone):
    a, b = noisy_pair(0.1, np.random.default_rng(13))
    with pytest.raises(ValueError, match="numbers above 0"):
        errors.image_errors(a, b, errors.Tone(*tone))


@pytest.fixture
def renders(tmp_path):
    """Renders of a material: a good model, a failed one, one with NaN; two scenes."""
    rng = np.random.default_rng(14)
    for name in ("one", "two"):
        reference, image = noisy_pair(0.05, rng)
        again, _ = noisy_pair(0.0, rng)
        broken = render(np.full_like(reference.mean, np.nan), reference.mask, 0 * reference.batches)
        failed = render(0 * reference.mean, reference.mask, 0 * reference.batches, status="failed", reason="no fit")
        named = {"reference": reference, "reference_again": again, "good": image, "failing": failed, "broken": broken}
        for model, picture in named.items():
            save_render(tmp_path / model / f"{name}.exr", picture)
    return tmp_path


def test_a_material_s_table_has_a_row_for_everything_and_failures_do_not_stop_it(renders, tmp_path):
    tones = {"one": TONE, "two": Tone(2.0, 2.0)}
    table, _ = errors.material_errors("stuff", ["failing", "good", "broken"], tones, renders)
    assert list(table.columns) == ["material", "model", "scene", "status", "reason", *errors.IMAGE_MEASURES]
    assert list(table.model) == [m for m in ("failing", "good", "broken", "reference_again") for _ in range(2)]
    rows = table.set_index(["model", "scene"])
    for model in ("failing", "broken"):
        assert set(rows.loc[model, "status"]) == {"failed"}
        assert rows.loc[model, list(errors.IMAGE_MEASURES)].isna().all(axis=None)
        assert rows.loc[model, "reason"].map(bool).all()
    for model in ("good", "reference_again"):
        assert set(rows.loc[model, "status"]) == {"ok"}
        assert set(rows.loc[model, "reason"]) == {""}
        assert rows.loc[model, list(errors.IMAGE_MEASURES)].notna().all(axis=None)
    # offset 0.05 for the fit; plain noise of two means of 8 batches, sigma 0.3, for the floor
    assert rows.loc[("good", "one"), "rmse"] == pytest.approx(0.05, rel=0.1)
    assert rows.loc[("reference_again", "one"), "rmse"] == pytest.approx(0.3 / 2, rel=0.1)
    write_tsv(tmp_path / "errors.tsv", table)
    again = read_tsv(tmp_path / "errors.tsv")
    pd.testing.assert_frame_equal(again, table, rtol=1e-5, check_dtype=False)


def test_a_scene_in_which_a_material_is_black_costs_no_other_scene(renders):
    """It is a row without measures and with its reason."""
    black = load_render(renders / "reference" / "two.exr")
    save_render(renders / "reference" / "two.exr", replace(black, mean=0 * black.mean, batches=0 * black.batches))
    tones = {"one": TONE, "two": TONE}
    table, pairs = errors.material_errors("stuff", ["good"], tones, renders)
    rows = table.set_index(["model", "scene"])
    assert (rows.loc["good", "status"].to_dict()) == {"one": "ok", "two": "failed"}
    assert "black" in rows.loc[("good", "two"), "reason"]
    assert np.isnan(rows.loc[("good", "two"), "psnr_db"])
    assert set(pairs.scene) <= {"one"}


def test_a_tsv_keeps_infinity_and_nan(tmp_path):
    table = pd.DataFrame({"model": ["a", "b", "nan"], "psnr_db": [np.inf, np.nan, 1.23456789]})
    write_tsv(tmp_path / "t.tsv", table)
    assert (tmp_path / "t.tsv").read_text() == "model\tpsnr_db\na\tinf\nb\tnan\nnan\t1.23457\n"
    back = read_tsv(tmp_path / "t.tsv")
    assert back.psnr_db[0] == np.inf
    assert np.isnan(back.psnr_db[1])
    assert back.model[2] == "nan"


def test_brdf_measures_are_zero_for_the_table_itself_and_grow():
    from brdfatlas.angles import GRID_SHAPE, above_horizon, theta_h_centres

    lobe = 0.1 + np.exp(-((theta_h_centres() / 0.2) ** 2))
    table = np.broadcast_to(lobe[:, None, None, None], (*GRID_SHAPE, 3)).astype(np.float32).copy()
    table[~above_horizon()] = np.nan
    same, near, far = (errors.brdf_errors(table * k, table) for k in (1.0, 1.02, 1.2))
    assert set(same) == set(errors.BRDF_MEASURES)
    for name in errors.BRDF_MEASURES:
        assert same[name] == 0 < near[name] < far[name], name
    # a scale of 1 + e is a relative squared error of e^2 whatever the weights
    assert near["objective_compressive"] == pytest.approx(0.02**2, rel=1e-3)


def picture_set(rng, n=8, size=72):
    """A reference and two fits with a common error and noise that is half common, as from common random numbers."""
    truth, mask = scene(size)
    common, *own = rng.normal(0, 0.15, (3, n, *truth.shape))
    reference = render(truth, mask, common)
    changes = (1.1 * truth + 0.02, 1.14 * truth + 0.01)
    return reference, [render(f, mask, 1.5 * common + 0.1 * noise) for f, noise in zip(changes, own, strict=True)]


@pytest.fixture(scope="module")
def repeats():
    """Measures of two fits of a picture in 60 repeats: values (60, 2, measures), their standard errors, and those of
    the differences (60, measures)."""
    rng, values, single, joint = np.random.default_rng(20), [], [], []
    keys = [(measure.key, measure.error) for measure in RANKED.values()]
    for _ in range(60):
        reference, images = picture_set(rng)
        picture = errors.Picture(reference, TONE)
        (a, spread), (b, other) = (picture.errors(image) for image in images)
        values.append([[row[key] for key, _ in keys] for row in (a, b)])
        single.append([[row[error] for _, error in keys] for row in (a, b)])
        joint.append([spread.joint(other)[error] for _, error in keys])
    return np.array(values), np.array(single), np.array(joint)


def test_standard_errors_are_those_of_repeated_pictures(repeats):
    """Of dE00, FLIP, SSIM and PSNR: the scatter over repeats has a relative error of 1 / sqrt(120), 9 %, and an
    estimate by halves is that of the mean over n/2 batches, halved: 25 % off where a measure bends under noise."""
    values, single, _ = repeats
    ratio = np.sqrt((single**2).mean(0)) / values.std(0, ddof=1)
    assert (ratio > 0.65).all(), ratio
    assert (ratio < 1.5).all(), ratio


def test_a_difference_has_its_own_error_which_two_independent_ones_do_not_add_up_to(repeats):
    values, single, joint = repeats
    scatter = (values[:, 0] - values[:, 1]).std(0, ddof=1)
    ratio = np.sqrt((joint**2).mean(0)) / scatter
    assert (ratio > 0.65).all(), ratio
    assert (ratio < 1.5).all(), ratio
    independent = np.hypot(*np.sqrt((single**2).mean(0)))
    assert (independent > 1.3 * scatter).all(), independent / scatter  # the shared noise cancels in the difference


def test_what_is_looked_at_around_the_mask_does_not_change_a_measure():
    """The box around the mask leaves out only what no filter reaches."""
    truth, mask = scene(60)
    wide, cover = np.ones((200, 180, 3)), np.zeros((200, 180), bool)
    wide[70:130, 50:110], cover[70:130, 50:110] = truth, mask
    noise = np.random.default_rng(21).normal(0, 0.1, (4, *wide.shape))
    a, b = render(wide, cover, 0 * noise), render(1.1 * wide, cover, noise)
    found = errors.image_errors(a, b, TONE)
    shown = tone_map(a.mean, *TONE)
    compared = np.where(cover[..., None], tone_map(b.mean, *TONE), shown)
    # single precision, under the square root of FLIP's features
    assert found["flip_mean"] == pytest.approx(flip(see(shown), see(compared))[cover].mean(), rel=1e-4)
    parts = errors.structure(shown), errors.structure(compared)
    assert found["ssim"] == pytest.approx(errors.ssim_map(*parts)[cover].mean(), rel=1e-5)


def test_ssim_is_that_of_scikit_image():
    rng = np.random.default_rng(22)
    a = gaussian_filter(rng.random((50, 70, 3)), (3, 3, 0), mode="wrap")
    b = np.clip(a + rng.normal(0, 0.05, a.shape), 0, 1)
    _, expected = structural_similarity(
        a, b, channel_axis=2, data_range=1.0, gaussian_weights=True, sigma=1.5, use_sample_covariance=False, full=True
    )
    found = errors.ssim_map(errors.structure(a), errors.structure(b))
    # variances are differences of means of squares, in single precision: 1e-7 against c2 of 9e-4
    np.testing.assert_allclose(found, expected.mean(-1), atol=1e-3)
    assert found.mean() == pytest.approx(expected.mean(), abs=1e-5)


def test_pairs_are_told_of_all_models_that_have_a_picture(renders):
    tones = {"one": TONE, "two": Tone(2.0, 2.0)}
    _, pairs = errors.material_errors("stuff", ["good", "failing", "broken", "good"], tones, renders)
    assert pairs.empty
    for scene_name in tones:
        (renders / "copy").mkdir(exist_ok=True)
        (renders / "copy" / f"{scene_name}.exr").write_bytes((renders / "good" / f"{scene_name}.exr").read_bytes())
    _, pairs = errors.material_errors("stuff", ["good", "failing", "copy"], tones, renders)
    assert list(pairs.columns) == ["material", "scene", "model", "other", *errors.PAIR_ERRORS]
    assert list(zip(pairs["scene"], pairs["model"], pairs["other"])) == [(s, "good", "copy") for s in tones]
    assert (pairs[list(errors.PAIR_ERRORS)] == 0).all(axis=None), "equal pictures differ by exactly nothing"
