"""The uber-texture and the JSON export give back the fits they hold."""

import re

import numpy as np
import pytest

from brdfatlas.export.fit_json import export_json, import_json
from brdfatlas.export.uber_texture import (
    D_AT,
    G_AT,
    RHO_S_AT,
    UberTexture,
    UberTextureError,
    build_uber_texture,
    load_uber_texture,
    save_uber_texture,
    uber_texture_job,
)
from brdfatlas.fits import Fit
from brdfatlas.models import MODELS


def random_fit(model: str, material: str, seed: int, standin=False) -> Fit:
    random = np.random.default_rng(seed)
    parameters = {p.name: random.uniform(0, 1, p.shape).astype(p.dtype) for p in MODELS[model].parameters}
    return Fit(model, material, parameters, {"max_angle": 85.0} if model == "ward" else {"power": 1.4}, standin)


def test_round_trip(tmp_path):
    fits = [random_fit("independent_g", f"material-{k}", k, standin=k == 3) for k in range(5)]
    path = tmp_path / "uber.exr"
    save_uber_texture(path, build_uber_texture(fits))
    texture = load_uber_texture(path)
    assert texture.texels.shape == (128, 512, 3)
    assert texture.materials == tuple(fit.material for fit in fits)
    for fit in fits:
        back = texture.fit(fit.material)
        assert back.standin == fit.standin
        for name, values in fit.parameters.items():
            np.testing.assert_array_equal(back.parameters[name], values)
    # the documented layout: D's third cell, G's last node, rho_s of the second material in green
    row, parameters = texture.texels[1, :, 1], fits[1].parameters
    assert row[D_AT + 2] == parameters["d"][1, 2]
    assert row[G_AT + 89] == parameters["g"][1, 89]
    assert row[RHO_S_AT] == parameters["rho_s"][1]
    assert not texture.texels[5:].any()
    with pytest.raises(KeyError, match="no material 'brass'"):
        texture.fit("brass")


@pytest.mark.parametrize("model", ["independent_g", "g_from_d"])
def test_a_shader_written_from_the_layout_gives_the_fit(model):
    """Up to the horizon: an independent evaluation, by what the module's text says alone."""
    fit = random_fit(model, "a", 7)
    row = build_uber_texture([fit]).texels[0].astype(float)
    random = np.random.default_rng(8)
    theta, phi = np.deg2rad(random.uniform(0, [[60], [90]], (2, 3000))), random.uniform(0, 2 * np.pi, (2, 3000))
    theta[1, :500] = np.deg2rad(random.uniform(88.5, 89.99, 500))
    wi, wo = np.moveaxis([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], 0, -1)

    def texel(first, place):
        return np.stack([np.interp(place, np.arange(90), row[first : first + 90, c]) for c in range(3)], -1)

    half = (wi + wo) / np.linalg.norm(wi + wo, axis=-1, keepdims=True)
    theta_h, theta_d = np.arccos(half[:, 2]), np.arccos((half * wi).sum(-1))
    value = texel(0, np.sqrt(theta_h / (np.pi / 2)) * 90 - 0.5) * texel(90, theta_d / (np.pi / 2) * 90 - 0.5)
    for angle in np.minimum(theta, np.deg2rad(89)):
        value *= texel(180, angle / (np.pi / 2) * 89) / np.cos(angle)[:, None]
    np.testing.assert_allclose(row[270] + row[271] * value, fit.evaluate(wi, wo), rtol=5e-3)


def test_what_makes_no_texture(tmp_path):
    one = random_fit("independent_g", "a", 0)
    for fits, reason in (
        ([], "no fit"),
        ([random_fit("naive", "a", 0)], "naive"),
        ([one, random_fit("g_from_d", "b", 1)], "fits of one model"),
        ([one, one], "twice"),
        ([random_fit("g_from_d", f"m{k}", k) for k in range(129)], "128 materials"),
    ):
        with pytest.raises(UberTextureError, match=reason):
            build_uber_texture(fits)
    names = tuple(f"m{k}" for k in range(129))
    save_uber_texture(tmp_path / "many.exr", UberTexture(np.zeros((128, 512, 3), np.float32), names, "g_from_d"))
    with pytest.raises(UberTextureError, match=r"many\.exr: names 129 materials in 128 rows"):
        load_uber_texture(tmp_path / "many.exr")
    path = tmp_path / "text.exr"
    path.write_text("no picture")
    with pytest.raises(UberTextureError, match=r"text\.exr: not an EXR"):
        load_uber_texture(path)
    with pytest.raises(UberTextureError, match="no such file"):
        load_uber_texture(tmp_path / "none.exr")


def test_a_run_s_texture_has_its_good_fits(tmp_path):
    """Failed fits have no row; a model that failed everywhere gives an empty texture, not an error."""
    paths = []
    for material, status in (("a", "ok"), ("b", "failed"), ("c", "ok")):
        path = tmp_path / f"{material}.npz"
        random_fit("independent_g", material, 1).save(path)
        path.with_suffix(".json").write_text(f'{{"status": "{status}"}}')
        paths.append(path)
    uber_texture_job("independent_g", paths, tmp_path / "some.exr")
    assert load_uber_texture(tmp_path / "some.exr").materials == ("a", "c")
    uber_texture_job("independent_g", paths[1:2], tmp_path / "none.exr")
    empty = load_uber_texture(tmp_path / "none.exr")
    assert empty.materials == ()
    assert empty.model == "independent_g"
    assert not empty.texels.any()


@pytest.mark.parametrize("model", ["independent_g", "naive", "bivariate", "low_rank_2", "ward"])
def test_json_gives_back_the_fit(model, tmp_path):
    fit = random_fit(model, "pvc", 3)
    path = tmp_path / "fit.json"
    export_json(fit, path)
    back = import_json(path)
    assert (back.model, back.material, back.standin, back.options) == (model, "pvc", False, fit.options)
    for name, values in fit.parameters.items():
        assert back.parameters[name].dtype == values.dtype
        np.testing.assert_array_equal(back.parameters[name], values)
    digits = re.findall(r"(?<![\w.])-?(\d+\.\d+)", path.read_text().split('"parameters"')[1])
    assert max(len(number.replace(".", "").strip("0")) for number in digits) <= 9, "float32 has no more digits"


def test_json_faults_are_named(tmp_path):
    path = tmp_path / "fit.json"
    with pytest.raises(ValueError, match="no such file"):
        import_json(path)
    for text, reason in (("{", "not JSON"), ("[]", "not a"), ('{"format": "brdfatlas fit 1"}', "damaged")):
        path.write_text(text)
        with pytest.raises(ValueError, match=reason):
            import_json(path)
