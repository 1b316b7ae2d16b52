"""Published fits and the stand-ins made of them."""

import numpy as np
import pandas as pd
import pytest

from brdfatlas import read_merl
from brdfatlas.angles import above_horizon, directions, phi_d_centres, theta_d_centres, theta_h_centres
from brdfatlas.formats.merl import write_merl
from brdfatlas.models.published import (
    THREE_LOBE,
    UnknownMaterialError,
    published_means,
    published_names,
    published_parameters,
    published_psnr,
    published_table,
)
from brdfatlas.models.three_lobe.cook_torrance import CookTorrance
from brdfatlas.pipeline.standins import PUBLISHED_MODELS, make_standin, standin_names, write_standin


class PrintedCookTorrance(CookTorrance):
    """With the Fresnel exponent that Eq. 10 prints."""

    name = "printed"
    fresnel_exponent = 2


@pytest.fixture(scope="module")
def published_logs():
    """log1p(rho cos theta_i) of all published fits on a coarse grid with both cosines above 0.1:
    {model: (100 materials, cells, 3)}, and with the Fresnel exponent as printed."""
    axes = theta_h_centres()[::9], theta_d_centres()[::7], phi_d_centres()[::20]
    wi, wo = directions(axes[0][:, None, None], axes[1][None, :, None], axes[2][None, None, :])
    keep = np.minimum(wi[..., 2], wo[..., 2]) > 0.1
    wi, wo = wi[keep], wo[keep]

    def logs(model, source):
        values = [model.evaluate(published_parameters(source, name), wi, wo) for name in published_names()]
        return np.log1p(np.array(values) * wi[:, 2:])

    found = {model.name: logs(model, model.name) for model in PUBLISHED_MODELS}
    return found | {"printed": logs(PrintedCookTorrance(), "cook_torrance")}


def test_there_are_five_tables_of_a_hundred_materials():
    assert len(published_names()) == 100
    for model in THREE_LOBE:
        table = published_table(model)
        assert list(table) == published_names()
        assert np.isfinite([list(row.values()) for row in table.values()]).all()
        # the fits' own PSNR column agrees with the table of PSNRs
        assert all(published_psnr(name)[model] == table[name]["psnr_db"] for name in published_names())


def test_psnr_of_the_fifty_surviving_captions():
    """Specification, section 8: means over the 50 are Lawrence 30.25, Tucker 37.71, Ashikhmin–Shirley 31.86 dB."""
    full = [psnr for psnr in map(published_psnr, published_names()) if "tucker" in psnr]
    assert len(full) == 50
    means = pd.DataFrame(published_means()).query("materials == 50").set_index("model")["value"]
    for model in (*THREE_LOBE, "lawrence", "tucker"):
        mean = np.mean([psnr[model] for psnr in full])
        assert abs(mean - means[model]) <= 0.005 + 1e-9, model  # the table is rounded to 0.01


def test_published_fits_of_a_material_agree_with_each_other(published_logs):
    """They are five fits of one measurement: each lies near the median of the other four, for every material, and
    the models that differ by a shape function only lie nearer. This is what fixes the conventions."""
    names = [model.name for model in PUBLISHED_MODELS]
    for name in names:
        others = np.median([published_logs[other] for other in names if other != name], axis=0)
        deviation = np.abs(published_logs[name] - others).mean((1, 2))
        assert deviation.mean() < 0.09, name  # 0.04 .. 0.08 measured; a wrong factor of pi gives more than 0.15
        assert deviation.max() < 0.4, name  # no material of the hundred is another one
    close = np.abs(published_logs["ashikhmin_shirley"] - published_logs["cook_torrance"]).mean()
    assert close < 0.02


def test_a_factor_of_pi_would_be_seen(published_logs):
    """The agreement above is sharp: any model times pi or 1/pi agrees less well with the other four."""
    names = [model.name for model in PUBLISHED_MODELS]
    for name in names:
        others = np.median([published_logs[other] for other in names if other != name], axis=0)
        right = np.abs(published_logs[name] - others).mean()
        for factor in (np.pi, 1 / np.pi):
            wrong = np.log1p(np.expm1(published_logs[name]) * factor)
            assert np.abs(wrong - others).mean() > 1.3 * right, (name, factor)


def test_fresnel_exponent_of_cook_torrance_is_five(published_logs):
    """Eq. 10 prints 2. With the published parameters 5 halves the deviation from the other four fits (0.109 against
    0.214 in the specification's measure; the ratio is the evidence)."""
    others = np.median([published_logs[m] for m in THREE_LOBE if m != "cook_torrance"], axis=0)
    with_5 = np.abs(published_logs["cook_torrance"] - others).mean((1, 2))
    with_2 = np.abs(published_logs["printed"] - others).mean((1, 2))
    assert with_5.mean() < 0.6 * with_2.mean()
    assert (with_5 < with_2).sum() >= 75  # not the work of a few materials


def test_standin_is_the_median_of_the_five_fits_and_says_so():
    measured = make_standin("brass")
    assert measured.standin
    assert measured.name == "brass"
    tables = [model.evaluate_grid(published_parameters(model.name, "brass")) for model in PUBLISHED_MODELS]
    edwards = [model.name for model in PUBLISHED_MODELS].index("edwards")
    tables[edwards] = 0.5 * (tables[edwards] + tables[edwards][:, :, ::-1])  # the mean of both orders of the directions
    assert np.array_equal(
        measured.table[::7],
        np.where(above_horizon()[::7, ..., None], np.median([t[::7] for t in tables], 0), np.nan),
        equal_nan=True,
    )
    assert np.array_equal(measured.valid, above_horizon())
    assert np.nanmin(measured.table) >= 0


@pytest.mark.parametrize("material", ["chrome", "yellow-plastic", "pink-felt"])
def test_a_standin_is_reciprocal(material):
    """phi_d and pi - phi_d are the two orders of a pair of directions, up to a mirror image."""
    table = make_standin(material).table
    np.testing.assert_allclose(table[:, :, ::-1], table, rtol=1e-5, atol=1e-7)
    wi, wo = np.random.default_rng(0).normal(size=(2, 200, 3))
    wi, wo = (w / np.linalg.norm(w, axis=-1, keepdims=True) for w in (wi, wo))
    wi[:, 2], wo[:, 2] = np.abs(wi[:, 2]), np.abs(wo[:, 2])
    measured, mirror = make_standin(material), np.array([1, -1, 1])
    np.testing.assert_allclose(measured.evaluate(wi, wo), measured.evaluate(wo * mirror, wi * mirror), rtol=1e-4)


def test_standin_survives_its_file(tmp_path):
    written = write_standin("pvc", tmp_path / "pvc.binary")
    read = read_merl(tmp_path / "pvc.binary", standin=True)
    assert np.array_equal(read.valid, written.valid)
    # the format stores rho / scale in double precision: one rounding to float32 on the way back
    np.testing.assert_allclose(read.table, written.table, rtol=2e-7)


def test_a_standin_is_known_under_any_name_and_a_measurement_is_none(tmp_path):
    written = write_standin("pvc", tmp_path / "pvc.binary")
    (tmp_path / "pvc.binary").rename(tmp_path / "mine.binary")
    assert read_merl(tmp_path / "mine.binary").standin
    write_merl(tmp_path / "measured.binary", written.table)
    assert not read_merl(tmp_path / "measured.binary").standin


def test_every_name_has_a_standin():
    assert standin_names() == published_names()
    for name in standin_names()[::25]:
        assert np.isfinite(make_standin(name).table[above_horizon()]).all()


@pytest.mark.parametrize("wrong", ["alum_bronze", "Chrome", "silicon-nitride"])
def test_unknown_material_names_near_ones(wrong):
    near = {"alum_bronze": "alum-bronze", "Chrome": "chrome", "silicon-nitride": "silicon-nitrade"}[wrong]
    with pytest.raises(UnknownMaterialError) as caught:
        make_standin(wrong)
    assert wrong in str(caught.value)
    assert near in str(caught.value)
    assert "\n" not in str(caught.value)


def test_unknown_model_has_no_published_parameters():
    with pytest.raises(ValueError, match="ggx"):
        published_parameters("ggx", "chrome")
