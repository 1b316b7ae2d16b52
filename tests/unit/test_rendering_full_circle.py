"""Models that are not reciprocal are rendered as they are: f(light, viewer) on both sides of the plane of incidence."""

import numpy as np
import pytest
from rendering_materials import material, variant

from brdfatlas import read_merl
from brdfatlas.angles import above_horizon, directions, grid_axes, half_difference
from brdfatlas.fits import Fit, fit
from brdfatlas.measured import Measured, extend, fold, look_up
from brdfatlas.models import MODELS

#: Options that make a fit quick.
SMALL = {"tucker": {"terms": 3, "resolution": "90x12x14"}, "lawrence": {"terms": 2, "resolution": "64x12x12"}}
ONE_WAY = [name for name in MODELS if not MODELS[name].reciprocal]


@pytest.fixture(scope="module")
def fits():
    """Of a material that is smooth, so that linear interpolation between cells has a small error."""
    return {name: fit(name, material(0.4), **SMALL.get(name, {})) for name in ("ggx", "edwards", "lawrence", "tucker")}


def pairs(count, seed=0):
    """Unit vectors within 70 degrees of the normal, theta_d below 60: away from the horizon's extension."""
    rng = np.random.default_rng(seed)
    cosine, phi = rng.uniform(np.cos(np.deg2rad(70)), 1, (2, count)), rng.uniform(0, 2 * np.pi, (2, count))
    sine = np.sqrt(1 - cosine**2)
    wi, wo = np.stack([sine * np.cos(phi), sine * np.sin(phi), cosine], -1)
    return wi, wo


def test_these_models_are_the_published_ones():
    assert {"edwards", "lawrence", "tucker"} <= set(ONE_WAY)


def test_angles_of_the_full_circle():
    """Exchanging the directions adds pi; mirroring them takes phi_d to 2 pi - phi_d; modulo pi it is the MERL angle."""
    wi, wo = pairs(1000)
    theta_h, theta_d, phi_d = half_difference(wi, wo, full_circle=True)
    assert ((phi_d >= 0) & (phi_d < 2 * np.pi)).all()
    np.testing.assert_allclose(half_difference(wi, wo)[2], np.mod(phi_d, np.pi), atol=1e-12)
    turned = half_difference(wo, wi, full_circle=True)
    np.testing.assert_allclose(np.mod(turned[2] - phi_d, 2 * np.pi), np.pi, atol=1e-7)
    mirrored = half_difference(wi * [1, -1, 1], wo * [1, -1, 1], full_circle=True)
    np.testing.assert_allclose(np.mod(mirrored[2] + phi_d + 1, 2 * np.pi), 1, atol=1e-7)
    for one, other in ((turned, theta_h), (mirrored, theta_h)):
        np.testing.assert_allclose(one[0], other, atol=1e-12)
    back = half_difference(*directions(theta_h, theta_d, phi_d), full_circle=True)
    np.testing.assert_allclose(np.cos(back[2] - phi_d), 1, atol=1e-12)


@pytest.mark.parametrize("name", ["ggx", "edwards", "lawrence", "tucker"])
def test_a_table_is_its_model_on_both_sides_of_the_plane(name, fits):
    """At nodes within float32, between them within the error of linear interpolation; so for either order of the two
    directions, and the table is its own mirror image."""
    fitted = fits[name]
    table, model = fitted.table(), MODELS[name]
    full = table.shape[2] == 360
    assert full != model.reciprocal
    np.testing.assert_array_equal(table, table[:, :, ::-1])
    theta_h, theta_d, phi_d = grid_axes(full)
    wi, wo = directions(theta_h[::9], theta_d[:, ::9], phi_d[..., ::23])
    above = (wi[..., 2] > 0.05) & (wo[..., 2] > 0.05)
    np.testing.assert_allclose(table[::9, ::9, ::23][above], fitted.evaluate(wi, wo)[above], rtol=2e-3, atol=1e-5)
    filled = extend(table, above_horizon())
    wi, wo = pairs(2000)
    for one, other in ((wi, wo), (wo, wi)):
        expected = fitted.evaluate(one, other)
        error = np.abs(look_up(filled, one, other) - expected) / np.maximum(expected, 1e-3)
        assert np.quantile(error, 0.95) < 0.01


@pytest.mark.parametrize("name", list(MODELS))
def test_a_model_that_says_it_is_reciprocal_is(name, fits):
    """On a fit of each model of the registry: f(i, o) = f(o, i) if and only if it says so."""
    found = fits.get(name) or fit(name, material(0.4), **SMALL.get(name, {}))
    wi, wo = pairs(500)
    forward, backward = found.evaluate(wi, wo), found.evaluate(wo, wi)
    error = np.max(np.abs(forward - backward) / np.maximum(forward + backward, 1e-6))
    if MODELS[name].reciprocal:
        assert error < 1e-5
    else:
        assert error > 1e-3


@pytest.mark.parametrize("name", ["edwards", "lawrence", "tucker"])
def test_the_renderer_shows_light_first(name, fits):
    """In Mitsuba wi is the viewer and wo the light: the plugin's value is the model's at (light, viewer) = (wo, wi)."""
    mi = variant()
    import drjit as dr

    from brdfatlas.rendering.bsdf import bsdf_of, reflectance_of

    whole = np.where(above_horizon()[..., None], material(0.4).extended, np.nan)  # no holes to extend over
    bsdf = bsdf_of(reflectance_of(Measured("smooth", whole), fits[name].table()))
    view, light = pairs(2000, seed=4)
    si = dr.zeros(mi.SurfaceInteraction3f, len(view))
    si.wi = mi.Vector3f(view.T.astype(np.float32))
    got = np.array(bsdf.eval(mi.BSDFContext(), si, mi.Vector3f(light.T.astype(np.float32)))).T / light[:, 2:]
    expected, reversed_ = fits[name].evaluate(light, view), fits[name].evaluate(view, light)
    error = np.abs(got - expected) / np.maximum(expected, 1e-3)
    assert np.quantile(error, 0.95) < 0.01
    unlike = np.abs(reversed_ - expected) / np.maximum(expected, 1e-3)
    assert np.quantile(unlike, 0.5) > 3 * np.quantile(error, 0.5)


def test_the_merl_table_of_such_a_model_is_the_mean_of_both_orders(fits):
    fitted = fits["tucker"]
    folded = fold(fitted.table())
    theta_h, theta_d, phi_d = grid_axes()
    wi, wo = directions(theta_h[5:60:7], theta_d[:, 5:60:7], phi_d[..., ::13])
    above = (wi[..., 2] > 0.05) & (wo[..., 2] > 0.05)
    mean = 0.5 * (fitted.evaluate(wi, wo) + fitted.evaluate(wo, wi))
    np.testing.assert_allclose(folded[5:60:7, 5:60:7, ::13][above], mean[above], rtol=2e-3, atol=1e-5)
    table = fits["ggx"].table()
    assert fold(table) is table


def test_the_command_line_says_so(fits, tmp_path, capsys):
    from brdfatlas.cli import main

    for name, word in (("tucker", "mean of both orders"), ("ggx", "")):
        fits[name].save(tmp_path / "fit.npz")
        assert main(["table", str(tmp_path / "fit.npz"), "-o", str(tmp_path / "t.binary"), "--force"]) == 0
        said = capsys.readouterr().out
        assert ("mean of both orders" in said) == bool(word)
    expected = fold(fits["ggx"].table())
    np.testing.assert_allclose(read_merl(tmp_path / "t.binary").table, expected, rtol=1e-5)


def test_a_table_on_the_full_circle_is_extended_as_one_on_half(fits):
    """With the mask of a measurement; where both halves of the circle are equal, so are their extensions."""
    m = material(0.4)
    half = fits["ggx"].table()
    full = extend(np.concatenate([half, half], 2), m.valid)
    expected = extend(half, m.valid)
    np.testing.assert_array_equal(full[:, :, :180], expected)
    np.testing.assert_array_equal(full[:, :, 180:], expected)


@pytest.mark.parametrize("name", ["ggx", "edwards", "lawrence", "tucker"])
def test_nan_in_nan_out(name, fits):
    nan, up, down = [np.nan, 0.0, 1.0], [0.0, 0.0, 1.0], [0.0, 0.6, -0.8]
    wi, wo = np.array([nan, up, up, up, nan]), np.array([up, nan, up, down, down])
    table = extend(fits[name].table(), above_horizon())
    for values in (fits[name].evaluate(wi, wo), look_up(table, wi, wo)):
        assert np.isnan(values[[0, 1, 4]]).all()
        assert np.isfinite(values[2]).all()
        assert (values[3] == 0).all()
    assert isinstance(fits[name], Fit)
