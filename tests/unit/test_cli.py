"""The command line: a whole chain on one file, and one clear line for every fault."""

import json

import numpy as np
import pytest

import brdfatlas
from brdfatlas import read_merl
from brdfatlas.cli import main
from brdfatlas.cli.commands import parse_options
from brdfatlas.export.fit_json import export_json
from brdfatlas.files import ours
from brdfatlas.fits import Fit
from brdfatlas.formats.merl import write_merl


@pytest.fixture(scope="module")
def material(tmp_path_factory):
    path = tmp_path_factory.mktemp("cli") / "pink-felt.binary"
    assert main(["standin", "pink-felt", "-o", str(path)]) == 0
    return path


def run_json(capsys, *arguments):
    capsys.readouterr()
    assert main([*map(str, arguments), "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def test_models_lists_every_model(capsys):
    listed = run_json(capsys, "models")
    assert list(listed) == list(brdfatlas.MODELS)
    for entry in listed.values():
        assert entry["bytes"] > 0
        assert entry["paper"]


def test_info(capsys, material):
    info = run_json(capsys, "info", material)
    assert info["valid_cells"] <= info["cells_above_horizon"]
    assert 0 < min(info["albedo"]) <= max(info["albedo"]) < 1


def test_fit_table_compare(capsys, material, tmp_path):
    report = run_json(capsys, "fit", "ggx", material, "-o", tmp_path / "ggx.npz")
    assert report["converged"]
    assert main(["table", str(tmp_path / "ggx.npz"), "-o", str(tmp_path / "ggx.binary")]) == 0
    fitted = brdfatlas.load_fit(tmp_path / "ggx.npz")
    np.testing.assert_allclose(read_merl(tmp_path / "ggx.binary").table, fitted.table(), rtol=1e-5)
    same = run_json(capsys, "compare", tmp_path / "ggx.npz", tmp_path / "ggx.binary")
    other = run_json(capsys, "compare", material, tmp_path / "ggx.npz")
    for name in same:
        assert abs(same[name]) < 1e-6 < abs(other[name]), name


def test_a_fit_is_a_fit_under_any_name_and_tells_of_its_standin(capsys, material, tmp_path):
    fitted = tmp_path / "ggx of felt"
    assert main(["fit", "ggx", str(material), "-o", str(fitted)]) == 0
    measures = run_json(capsys, "compare", material, fitted)
    assert main(["table", str(fitted), "-o", str(tmp_path / "ggx.binary")]) == 0
    assert run_json(capsys, "compare", material, tmp_path / "ggx.binary") == pytest.approx(measures, rel=1e-5)
    assert read_merl(material).standin
    assert brdfatlas.load_fit(fitted).standin
    assert run_json(capsys, "info", tmp_path / "ggx.binary")["standin"]


def test_a_json_that_counts_as_ours_is_told_to_be_a_fit(capsys, tmp_path):
    """Both by one mark, however far an editor has spread the lines."""
    made = brdfatlas.MODELS["ward"]
    parameters = {p.name: np.full(p.shape, 0.5, p.dtype) for p in made.parameters}
    export_json(Fit("ward", "felt", parameters, made.check_options({})), tmp_path / "fit.json")
    spread = tmp_path / "spread.json"
    spread.write_text((tmp_path / "fit.json").read_text().replace("\n", "\n" * 100))
    for path in (tmp_path / "fit.json", spread):
        assert ours(path, "JSON")
        assert run_json(capsys, "info", path)["model"] == "ward"


@pytest.mark.parametrize("command", [["table"], ["export", "--to", "merl"]])
@pytest.mark.parametrize(
    ("model", "kind"), [("ggx", "stand-in"), ("ggx", "reconstructed"), ("edwards", "reconstructed")]
)
def test_a_table_of_a_fit_is_no_measurement(capsys, tmp_path, command, model, kind):
    made = brdfatlas.MODELS[model]
    parameters = {p.name: np.full(p.shape, 0.5, p.dtype) for p in made.parameters}
    Fit(model, "felt", parameters, made.check_options({}), kind == "stand-in").save(tmp_path / "fit.npz")
    line = [command[0], str(tmp_path / "fit.npz"), *command[1:], "-o", str(tmp_path / "felt.binary")]
    assert main(line) == 0
    assert run_json(capsys, "info", tmp_path / "felt.binary")["kind"] == kind
    assert main(["info", str(tmp_path / "felt.binary")]) == 0
    assert f"(a {kind} material)" in capsys.readouterr().out
    assert main(line) == 0, "a file of ours"


def test_files_are_compared_where_both_were_measured(capsys, material, tmp_path):
    measured = read_merl(material)
    holes = measured.table.copy()
    holes[:30, 40:] = np.nan
    write_merl(tmp_path / "holes.binary", holes)
    for pair in ((material, tmp_path / "holes.binary"), (tmp_path / "holes.binary", material)):
        assert all(value == 0 for value in run_json(capsys, "compare", *pair).values())


def test_a_fit_as_json_serves_wherever_a_fit_does(capsys, material, tmp_path):
    """It is the form that travels; mitsuba puts it beside its export as npz."""
    assert main(["fit", "ggx", str(material), "-o", str(tmp_path / "a.npz")]) == 0
    run_json(capsys, "export", tmp_path / "a.npz", "-o", tmp_path / "a.json")
    outputs = {"table": ["b.binary"], "convert": ["b.csv"], "export": ["b.xml", "--to", "mitsuba"]}
    for command, (output, *more) in outputs.items():
        run_json(capsys, command, tmp_path / "a.json", "-o", tmp_path / output, *more)
    assert brdfatlas.load_fit(tmp_path / "b.npz") == brdfatlas.load_fit(tmp_path / "a.npz")
    for pair in (("a.json", "a.npz"), ("b.binary", "a.json")):
        errors = run_json(capsys, "compare", *(tmp_path / name for name in pair))
        assert all(value == 0 for value in errors.values())
    with pytest.raises(ValueError, match="import_json"):
        brdfatlas.load_fit(tmp_path / "a.json")


@pytest.mark.parametrize("ending", ["binary", "csv"])
def test_a_converted_fit_is_converted_again(capsys, material, tmp_path, ending):
    """A table of measured values stays: it may be the only copy of a measurement."""
    assert main(["fit", "lambert", str(material), "-o", str(tmp_path / "a.npz")]) == 0
    convert = ["convert", str(tmp_path / "a.npz"), "-o", str(tmp_path / f"b.{ending}")]
    assert main(convert) == main(convert) == 0
    write_merl(tmp_path / "measured.binary", read_merl(material).table)
    convert = ["convert", str(tmp_path / "measured.binary"), "-o", str(tmp_path / f"c.{ending}")]
    assert main(convert) == 0
    assert main(convert) == 1
    assert "--force" in capsys.readouterr().err


def test_exports(capsys, material, tmp_path):
    """A fit and its sampler as JSON, and a texture of factors, give back what the fit holds."""
    from brdfatlas.export.fit_json import import_json
    from brdfatlas.export.uber_texture import load_uber_texture
    from brdfatlas.sampling import load_sampler

    for model in ("ward", "g_from_d"):
        assert main(["fit", model, str(material), "-o", str(tmp_path / f"{model}.npz")]) == 0
    ward, factors = (brdfatlas.load_fit(tmp_path / f"{model}.npz") for model in ("ward", "g_from_d"))
    run_json(capsys, "export", tmp_path / "ward.npz", "-o", tmp_path / "ward.json")
    for name, values in import_json(tmp_path / "ward.json").parameters.items():
        np.testing.assert_array_equal(values, ward.parameters[name])
    run_json(capsys, "export", "--sampler", tmp_path / "ward.npz", "-o", tmp_path / "sampler.json")
    u, wo = np.random.default_rng(0).random((100, 3)), np.array([0.6, 0.0, 0.8])
    drawn = load_sampler(tmp_path / "sampler.json").sample(u, wo)
    np.testing.assert_allclose(drawn, ward.sampler().sample(u, wo), rtol=1e-6)
    told = run_json(capsys, "uber-texture", tmp_path / "g_from_d.npz", "-o", tmp_path / "factors.exr")
    assert (told["model"], told["materials"]) == ("g_from_d", ["pink-felt"])
    back = load_uber_texture(tmp_path / "factors.exr").fit("pink-felt")
    np.testing.assert_array_equal(back.parameters["g"], factors.parameters["g"])


def test_python_functions_are_the_commands(material):
    measured = brdfatlas.read_merl(material)
    a, b = (brdfatlas.fit("ggx", measured, seed=0) for _ in range(2))
    for name in a.parameters:
        np.testing.assert_array_equal(a.parameters[name], b.parameters[name])


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["info", "absent.binary"], "absent.binary: no such file"),
        (["standin", "pink-flet", "-o", "x.binary"], "pink-felt"),
        (["fit", "ggy", "{m}", "-o", "x.npz"], "unknown model 'ggy'; known: "),
        (["fit", "ggx", "{m}", "-o", "x.npz", "--option", "colour=1"], "colour"),
        (["fit", "ggx", "{m}", "-o", "x.npz", "--option", "colour"], "KEY=VALUE"),
        (["fit", "ggx", "{m}", "-o", "x.npz", "--option", "seed=1"], "unknown option 'seed'"),
        (["fit", "lawrence", "{m}", "-o", "x.npz", "--option", "terms=2.0"], "terms = 2.0 is not one of auto, 1, 2"),
        (["fit", "naive", "{m}", "-o", "x.npz", "--option", "accelerate=False"], "'False' is not true or false"),
        (
            ["fit", "naive", "{m}", "-o", "x.npz", "--option", "power=strong"],
            "power = 'strong' is not a number of 0",
        ),
        (
            ["fit", "ward", "{m}", "-o", "x.npz", "--option", "starts=0"],
            "starts = 0 is not a whole number of 1",
        ),
        (
            ["fit", "ward", "{m}", "-o", "x.npz", "--option", "max_angle=95"],
            "95 is not a number of 1 to 89",
        ),
        (["fit", "tucker", "{m}", "-o", "x.npz", "--option", "resolution=9x9"], "resolution = '9x9' is not THETA_H"),
        (["table", "{m}", "-o", "x.binary"], "not a brdfatlas fit"),
        (["table", "absent.npz", "-o", "x.binary"], "absent.npz: no such fit"),
        (["export", "absent.npz", "-o", "x.json"], "absent.npz: no such fit"),
        (["uber-texture", "absent.npz", "-o", "x.exr"], "absent.npz: no such fit"),
        (["render", "{m}", "-o", "x.exr", "--scenes", "absent.yaml"], "absent.yaml: no such file"),
    ],
)
def test_faults_are_one_line_and_write_nothing(capsys, material, tmp_path, monkeypatch, arguments, words):
    monkeypatch.chdir(tmp_path)
    assert main([a.replace("{m}", str(material)) for a in arguments]) == 1
    error = capsys.readouterr().err
    assert words in error
    assert error.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_options_are_json_where_they_can_be():
    assert parse_options(["a=1", "b=true", "c=egsr2015"]) == {"a": 1, "b": True, "c": "egsr2015"}


def test_image_errors_of_foreign_images(capsys, tmp_path):
    """A constant offset of 1 % of the peak is 40 dB whatever the renderer."""
    OpenEXR = pytest.importorskip("OpenEXR")
    rng = np.random.default_rng(0)
    image = rng.random((32, 32)).astype(np.float32)
    image.flat[0] = 1.0
    for name, offset in (("a", 0.0), ("b", 0.01)):
        channels = {c: image + np.float32(offset) for c in "RGB"}
        OpenEXR.File({"type": OpenEXR.scanlineimage}, channels).write(str(tmp_path / f"{name}.exr"))
    errors = run_json(capsys, "image-errors", tmp_path / "a.exr", tmp_path / "b.exr")
    assert errors["psnr_db"] == pytest.approx(40, abs=0.01)
    assert errors["rmse"] == pytest.approx(0.01, rel=1e-3)
    assert run_json(capsys, "image-errors", tmp_path / "a.exr", tmp_path / "a.exr")["rmse"] == 0


def test_image_errors_use_the_references_tone_map_and_name_a_bound(capsys, tmp_path):
    """The numbers of the report for the same two files; a model closer than the noise has a bound, not a value."""
    from brdfatlas.measures.errors import Tone, image_errors
    from brdfatlas.rendering.images import Render, load_render, save_render

    rng = np.random.default_rng(0)
    parts = (1 + 0.1 * rng.random((4, 16, 16, 3))).astype(np.float32)
    noise = rng.normal(size=parts.shape).astype(np.float32)
    for name, batches in (("a", parts), ("near", parts + 1e-3 * noise), ("far", parts * np.float32(0.8))):
        meta = {"status": "ok", "exposure": "3.0", "gamma": "1.8"}
        save_render(tmp_path / f"{name}.exr", Render(batches.mean(0), batches, np.ones((16, 16), bool), meta))
    a, far = (load_render(tmp_path / f"{name}.exr") for name in ("a", "far"))
    told = run_json(capsys, "image-errors", tmp_path / "a.exr", tmp_path / "far.exr")
    assert told["de00_mean"] == pytest.approx(image_errors(a, far, Tone(3.0, 1.8))["de00_mean"])
    assert not told["psnr_is_lower_bound"]
    other = run_json(capsys, "image-errors", tmp_path / "a.exr", tmp_path / "far.exr", "--exposure", "1")
    assert other["de00_mean"] != told["de00_mean"]
    near = run_json(capsys, "image-errors", tmp_path / "a.exr", tmp_path / "near.exr")
    assert near["psnr_is_lower_bound"]
    assert near["psnr_se_db"] is None


def test_render_writes_the_picture_of_the_file(capsys, material, tmp_path):
    """The command's EXR is the function's picture; felt reflects some light."""
    from brdfatlas.rendering.images import load_render
    from brdfatlas.rendering.jobs import render_file

    output = tmp_path / "felt.exr"
    told = run_json(capsys, "render", material, "--spp", "9", "--size", "8", "-o", output)
    assert str(told["spp"]) == load_render(output).meta["samples"] == "16"
    assert main(["render", str(material), "--spp", "16", "--size", "16", "-o", str(output)]) == 0
    render = load_render(output)
    expected = render_file(material, "studio_sphere", samples=16, size=16)
    assert render.mean[render.mask].max() > 0
    np.testing.assert_allclose(render.mean, expected.mean, rtol=1e-5, atol=1e-7)
