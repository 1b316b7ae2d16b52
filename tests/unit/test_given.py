"""Given parameters: rows that are not fitted, from three forms of files, and what is wrong with a file in one line."""

import json

import numpy as np
import pytest

from brdfatlas.fits import fit
from brdfatlas.formats.merl import SCALE
from brdfatlas.measured import Measured, fold
from brdfatlas.models import MODELS, Entry
from brdfatlas.models.given import ParameterFileError, materials_of, outside_range, read_parameters, why_no_row
from brdfatlas.models.published import THREE_LOBE, published_parameters
from brdfatlas.models.sgd import shadowing
from brdfatlas.objectives import log_deviation
from brdfatlas.pipeline.standins import make_standin

PUBLIC = """# fits of a model that nobody published
my-paint = Aggregate(Lambertian(albedo = [.1, .2, 3.0e-1]), NganCookTorrance(albedo = [0.1, .05, 0.02], eta = 0.2,\
 roughness = 1e-1))

plain = Aggregate(Lambertian(albedo = [0.1, 0.2, 0.3]), NganCookTorrance(albedo = [1, 1, 1], eta = 0.5, roughness = 3))
"""
NGAN = {"kd": [0.1, 0.2, 0.3], "ks": [0.1, 0.05, 0.02], "f0": [0.2], "m": [0.1]}


@pytest.fixture
def public(tmp_path):
    path = tmp_path / "mine.fit"
    path.write_text(PUBLIC)
    return path


def test_the_public_format_is_read_with_names_and_units(public):
    assert materials_of(public) == ["my-paint", "plain"]
    got = read_parameters(public, MODELS["ngan"], "my-paint")
    channels = np.array([1.0, 1.15, 1.66])
    assert np.allclose(SCALE / SCALE[0], channels)
    for name, value in NGAN.items():  # albedos belong to the stored numbers of a MERL file
        np.testing.assert_allclose(got[name], value * (channels if name in ("kd", "ks") else 1))


def test_the_three_forms_give_the_same_parameters(tmp_path):
    (tmp_path / "a.json").write_text(json.dumps({"x": NGAN | {"f0": 0.2}}))
    header = "material,kd_r,kd_g,kd_b,ks_1,ks_2,ks_3,f0,m,comment"
    (tmp_path / "a.csv").write_text(f"{header}\nx, 0.1,0.2,0.3,0.1,0.05,0.02,0.2,0.1,mine\n")
    for file in ("a.json", "a.csv"):
        got = read_parameters(tmp_path / file, MODELS["ngan"], "x")
        assert set(got) == set(NGAN)
        for name, value in NGAN.items():
            np.testing.assert_allclose(got[name], value)


@pytest.mark.parametrize("model", THREE_LOBE)
def test_the_project_s_own_tables_are_such_files(model):
    path = f"config/published/bilgili2011/{model}.csv"
    for material in ("chrome", "black-obsidian"):
        got, expected = read_parameters(path, MODELS[model], material), published_parameters(model, material)
        assert set(got) == set(expected)
        for name, value in expected.items():
            np.testing.assert_array_equal(got[name], value)


@pytest.mark.parametrize(
    ("name", "text", "told"),
    [
        ("a.csv", "name,kd\nx,1\n", "no column 'material'"),
        ("a.csv", "material,kd_r,kd_g,kd_b\nx,1,1,1\n", "ks: is missing; model ngan needs"),
        ("a.csv", "material,kd_r,kd_g,kd_b\nx,1,1,1\nx,1,1,1\n", "x is in it twice"),
        ("a.csv", "material\n", "holds no parameters"),
        ("a.json", "{", "line 1"),
        ("a.json", "[1, 2]", "is not {material"),
        ("a.json", json.dumps({"x": NGAN | {"kd": [1, 2]}}), "kd: has 2 values instead of 3"),
        ("a.json", json.dumps({"x": NGAN | {"kd": ["a", 1, 2]}}), "is no number or list"),
        ("a.json", json.dumps({"x": NGAN | {"m": "nan"}}), "m: holds NaN or Inf"),
        ("a.json", json.dumps({"y": NGAN}), "no parameters for x"),
        ("a.fit", "x = __import__('os').system('true')\n", "line 1: cannot be read"),
        ("a.fit", "x = Aggregate(Lambertian(albedo = [1, 2, 3])\n", "line 1: has 'the end of the line' where"),
        ("a.fit", "x = Aggregate(Lambertian(albedo = [1, 2, 3])))\n", "line 1: has ')' behind its end"),
        ("a.fit", "x = Lambertian(albedo = [1, 2, 3])\n", "no NganCookTorrance(albedo = ...)"),
        ("a.fit", "no equation\n", "line 1: is no `material = ...`"),
    ],
)
def test_what_is_wrong_with_a_file_is_said_in_one_line(tmp_path, name, text, told):
    (tmp_path / name).write_text(text)
    with pytest.raises(ParameterFileError) as caught:
        read_parameters(tmp_path / name, MODELS["ngan"], "x")
    assert told in str(caught.value)
    assert str(tmp_path / name) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_parameters_of_a_model_that_chooses_its_size_keep_their_shape(tmp_path):
    shapes = {"f": (16, 3, 2), "u": (128, 2), "v": (16, 2)}
    row = {name: np.full(shape, 0.5).tolist() for name, shape in shapes.items()}
    wrong = {"flat": row | {"f": [0.5] * 96}, "short": row | {"u": row["u"][:9]}, "ragged": row | {"v": [[1, 2], [1]]}}
    (tmp_path / "a.json").write_text(json.dumps({"x": row} | wrong))
    entry = Entry("mine", "lawrence", parameters=str(tmp_path / "a.json"))
    table = np.full((90, 90, 180, 3), 0.1, np.float32)
    found = fit(entry, Measured("x", table))
    assert {name: values.shape for name, values in found.parameters.items()} == shapes
    assert np.isfinite(found.evaluate([0.0, 0.0, 1.0], [0.0, 0.0, 1.0])).all()
    for name in wrong:
        with pytest.raises(ParameterFileError, match=rf"a\.json: {name}: "):
            fit(entry, Measured(name, table))


def test_a_file_that_is_not_there_and_a_model_that_the_format_does_not_know(tmp_path, public):
    with pytest.raises(ParameterFileError, match=r"none\.csv: cannot be read"):
        materials_of(tmp_path / "none.csv")
    with pytest.raises(ParameterFileError, match="ggx has no names in this format"):
        read_parameters(public, MODELS["ggx"], "plain")


def test_a_material_that_the_file_lacks_has_no_row_and_stand_ins_have_none_of_published_ones(public):
    assert why_no_row("mine", public, "plain", standin=False) == ""
    assert why_no_row("mine", public, "plain", standin=True) == "", "a user's own values are welcome on a stand-in"
    assert "no parameters for it" in why_no_row("mine", public, "chrome", standin=False)
    unfetched = "data/published_fits/no_such.fit"
    assert "`snakemake published_fits` fetches it" in why_no_row("x_published", unfetched, "chrome", standin=False)
    assert "stand-in" in why_no_row("ngan_published", public, "plain", standin=True)


def test_a_given_row_is_evaluated_and_not_fitted(public):
    table = np.full((90, 90, 180, 3), 0.1, np.float32)
    row = Entry("mine", "ngan", parameters=str(public))
    found = fit(row, Measured("my-paint", table))
    assert found.report["iterations"] == 0
    assert str(public) in found.report["message"]
    assert np.isnan(found.report["objective"])
    assert found.entry == "mine"
    assert row.title.endswith("given parameters (mine)")
    wi = wo = np.array([0.0, 0.0, 1.0])
    expected = MODELS["ngan"].evaluate(read_parameters(public, MODELS["ngan"], "my-paint"), wi, wo)
    np.testing.assert_allclose(found.evaluate(wi, wo), expected, rtol=1e-6)
    with pytest.raises(ParameterFileError, match="no parameters for chrome"):
        fit(row, Measured("chrome", table))


def test_values_beyond_the_range_of_a_fit_are_told():
    parameters = read_parameters("config/published/bilgili2011/edwards.csv", MODELS["edwards"], "chrome")
    assert outside_range(MODELS["edwards"], parameters) == ""
    assert "n (0.001 to 20000)" in outside_range(MODELS["edwards"], parameters | {"n": np.array([1.0, 2.0, 3e4])})


def test_given_rows_of_the_project_s_tables_resemble_the_standin_that_is_made_of_them():
    measured = make_standin("nylon")
    for model in THREE_LOBE:
        row = Entry(f"{model}_published", model, parameters=f"config/published/bilgili2011/{model}.csv")
        assert log_deviation(fold(fit(row, measured).table()), measured.table) < 0.1, model


def test_public_fits_follow_our_conventions(shared):
    """K is redundant in a published SGD fit: it normalises D. That it is ours to four digits fixes alpha, p and D; and
    each published fit of a material lies near the reconstruction of its measurement."""
    path = shared / "data" / "published_fits" / "bagher_sgd.fit"
    names = materials_of(path)
    assert len(names) == 24
    lines = {line.split(" = ")[0]: line for line in path.read_text().splitlines() if not line.startswith("#")}
    for material in names:
        given = read_parameters(path, MODELS["sgd"], material)
        published = [float(x) for x in lines[material].split("K = [")[1].split("]")[0].split(",")]
        for alpha, p, k in zip(given["alpha"], given["p"], published):
            assert np.exp(shadowing(float(alpha), float(p))[1][0]) == pytest.approx(k, rel=1e-3)
    others = {"low_lowmicrofacet_E2": ("abc", 24), "ngan_cooktorrance": ("ngan", 21)}
    for name, (model, count) in others.items():
        path = shared / "data" / "published_fits" / f"{name}.fit"
        assert len(materials_of(path)) == count
        for material in materials_of(path):
            assert outside_range(MODELS[model], read_parameters(path, MODELS[model], material)) == ""


def test_a_job_without_a_row_says_so_and_is_no_failure(public, tmp_path):
    from brdfatlas.files import read_json
    from brdfatlas.pipeline.jobs import fit_job
    from brdfatlas.pipeline.records import failures
    from brdfatlas.pipeline.standins import write_standin
    from brdfatlas.reports.data import read_material

    write_standin("chrome", tmp_path / "chrome.binary")
    row = Entry("mine", "ngan", parameters=str(public))
    paths = str(tmp_path / "mine.npz"), str(tmp_path / "mine.json")
    fit_job(
        [row.plain], 0, str(tmp_path / "chrome.binary"), True, {"mine": paths}, {"mine": ""}, str(tmp_path / "made")
    )
    report = read_json(paths[1])
    assert report["status"] == "absent"
    assert report["reason"] == f"{public} has no parameters for it"
    assert failures([paths[1]]) == []
    (tmp_path / "facts.json").write_text('{"name": "chrome"}')
    material = read_material(tmp_path / "facts.json", [paths[1]])
    assert (dict(material.fits), dict(material.absent)) == ({}, {"mine": report["reason"]})


def test_parameters_that_are_given_took_no_time_to_fit():
    """The time of reading a file led the Pareto line of seconds."""
    from brdfatlas.fits import fit
    from brdfatlas.pipeline.standins import make_standin
    from brdfatlas.settings import located

    row = Entry("ward_published", "ward", parameters=located("config/published/bilgili2011/ward.csv"))
    assert fit(row, make_standin("chrome")).report["seconds"] is None
