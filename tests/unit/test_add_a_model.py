"""docs/add-a-model.md holds: a model from outside the package, by path and by entry point, is fitted and evaluated."""

import pickle
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from brdfatlas.angles import GRID_SHAPE, above_horizon
from brdfatlas.cli.commands import stored_fit
from brdfatlas.export.fit_json import export_json, import_json
from brdfatlas.files import read_json
from brdfatlas.fits import fit, load_fit
from brdfatlas.formats.merl import write_merl
from brdfatlas.measured import Measured
from brdfatlas.measures.physics import physics_checks
from brdfatlas.models import MODELS, Entry, Registry, load_model_file, read_entries
from brdfatlas.models.base import FitError, Model, Option
from brdfatlas.pipeline.jobs import fit_job
from brdfatlas.recommend import recommend
from brdfatlas.rendering.bsdf import load_table
from brdfatlas.settings import ConfigError

ROOT = Path(__file__).resolve().parents[2]
EXAMPLE = ROOT / "examples" / "lambertian.py"
GREY = np.array([0.25, 0.1, 0.003], np.float32)


def constant_material() -> Measured:
    table = np.broadcast_to(GREY, (*GRID_SHAPE, 3)).copy()
    table[~above_horizon()] = np.nan
    return Measured("constant", table)


def check_fit(name: str | Entry, folder: Path) -> None:
    """Fit, save, load and evaluate the model of this name on a constant BRDF."""
    fitted = fit(name, constant_material())
    table = fitted.table()[above_horizon()]
    # one number for all cells, float64 inside: exact to the last bit of the float32 table
    assert np.all(table == GREY)
    np.testing.assert_allclose(fitted.parameters["albedo"], np.pi * GREY.astype(float), rtol=1e-12)
    fitted.save(folder / "fit.npz")
    loaded = load_fit(folder / "fit.npz")
    rng = np.random.default_rng(1)
    wi, wo = (v / np.linalg.norm(v, axis=-1, keepdims=True) for v in rng.normal(size=(2, 50, 3)))
    seen = (wi[:, 2] > 0) & (wo[:, 2] > 0)
    rgb = loaded.evaluate(wi, wo)
    np.testing.assert_allclose(rgb[seen], np.broadcast_to(GREY, (seen.sum(), 3)), rtol=1e-7)
    assert np.all(rgb[~seen] == 0)
    checks = physics_checks(fitted)
    assert checks["reciprocity_error"] == 0
    assert checks["bad_cells"] == 0
    np.testing.assert_allclose(checks["max_albedo"], np.pi * GREY, rtol=1e-5)


def test_workers_fit_a_model_from_a_file(tmp_path):
    """A fresh process knows no module of that file."""
    with MODELS.restored():
        MODELS.register_file("lambertian", EXAMPLE)
        found = recommend(constant_material(), models=["lambertian", "lambert"], processes=2, size=24, samples=16)
    assert {"lambertian", "lambert"} == set(found.fits)


def test_an_entry_and_a_fit_of_a_file_are_found_in_another_process():
    entry = Entry("lambertian", "lambertian", source=str(EXAMPLE))
    fitted = fit(entry, constant_material())
    code = """import pickle, sys
entry, fitted = pickle.load(sys.stdin.buffer)
print(entry.instance.name, fitted.evaluate([0, 0, 1.0], [0, 0, 1.0]))"""
    done = subprocess.run([sys.executable, "-c", code], input=pickle.dumps((entry, fitted)), capture_output=True)
    assert done.stdout.decode().startswith("lambertian [0.25 "), done.stderr.decode()


def test_files_named_in_the_checkouts_own_rows_are_found_from_any_folder(tmp_path, monkeypatch):
    row = {"source": "examples/lambertian.py", "parameters": "config/published/bilgili2011/ward.csv"}
    for folder, ours in ((ROOT, True), (ROOT, False), (tmp_path, True)):
        monkeypatch.chdir(folder)
        entry = Entry.of("lambertian", row, ours=ours)
        assert Path(entry.source).samefile(EXAMPLE)
        assert Path(entry.parameters).is_file()
        assert Path(entry.source).is_absolute() == (folder == tmp_path)
    monkeypatch.chdir(tmp_path)
    assert Entry.of("lambertian", row).source == row["source"], "a study's own rows name files of the study"


def test_a_fit_taken_home_finds_the_file_that_was_named(tmp_path, monkeypatch):
    """Where its own path leads nowhere; a model of the package needs no file, whatever is named for another fit."""
    monkeypatch.chdir(ROOT)
    fits = [
        fit(entry, constant_material())
        for entry in (Entry("l", "lambertian", source="examples/lambertian.py"), "lambert")
    ]
    paths = []
    for fitted in fits:
        fitted.save(tmp_path / f"{fitted.entry}.npz")
        export_json(fitted, tmp_path / f"{fitted.entry}.json")
        paths += [(tmp_path / f"{fitted.entry}{ending}", fitted) for ending in (".npz", ".json")]
    monkeypatch.chdir(tmp_path)
    for path, fitted in paths:
        assert np.array_equal(stored_fit(str(path), str(EXAMPLE)).table(), fitted.table(), equal_nan=True)
    with pytest.raises(ValueError, match="register_file"):
        load_fit("l.npz")
    with MODELS.restored():
        MODELS.register_file("lambertian", EXAMPLE)
        for path, fitted in paths:
            assert np.array_equal(
                load_table(path)[0] if path.suffix == ".npz" else import_json(path).table(),
                fitted.table(),
                equal_nan=True,
            )


def test_a_model_joins_by_its_path(tmp_path):
    assert "lambertian" not in MODELS
    registry = Registry()
    registry.register_file("lambertian", EXAMPLE)
    assert "lambertian" in list(registry)
    check_fit(registry.entry("lambertian"), tmp_path)


def test_a_model_joins_by_an_entry_point(tmp_path, monkeypatch):
    name = "lambertian_from_a_package"
    source = EXAMPLE.read_text().replace('name = "lambertian"', f'name = "{name}"')
    (tmp_path / "outside_models.py").write_text(source)
    info = tmp_path / "outside_models-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: outside-models\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(f"[brdfatlas.models]\n{name} = outside_models:Lambertian\n")
    monkeypatch.syspath_prepend(tmp_path)
    assert name in list(Registry())
    check_fit(name, tmp_path)


def test_the_example_fits_by_least_squares():
    """Any other albedo has a larger weighted error: the weighted mean is the minimum."""
    rng = np.random.default_rng(2)
    measured = constant_material()
    measured = Measured("noisy", measured.table * rng.uniform(0.5, 1.5, measured.table.shape).astype(np.float32))
    model = load_model_file(EXAMPLE)
    from brdfatlas.objectives import importance_weight

    weight = importance_weight(measured.valid, measure="pairs")
    best = model.fit(measured).parameters["albedo"]
    rho = np.nan_to_num(measured.table)

    def error(albedo):
        return np.einsum("hdp,hdpc->", weight, (rho - albedo / np.pi) ** 2)

    assert all(error(best) < error(best * factor) for factor in (0.99, 1.01))


def test_wrong_files_are_named(tmp_path):
    with pytest.raises(ImportError, match=r"nowhere\.py: no such model file"):
        load_model_file(tmp_path / "nowhere.py")
    (tmp_path / "empty.py").write_text("x = 1\n")
    with pytest.raises(ImportError, match=r"empty\.py: expected one Model class"):
        load_model_file(tmp_path / "empty.py")
    shutil.copy(EXAMPLE, tmp_path / "other.py")
    with pytest.raises(ImportError, match="named 'another'"):
        load_model_file(tmp_path / "other.py", "another")


@pytest.mark.parametrize(
    ("old", "new", "fault"),
    [
        ("import numpy as np", "import numpi", r"line 5: ModuleNotFoundError: No module named 'numpi'"),
        ("import numpy as np", "import numpy as np\n{}['albedo']", r"line 6: KeyError: 'albedo'"),
        ("def fit(", "def fit((", r"line 3\d: SyntaxError: "),
        ('    name = "lambertian"\n', "", "class Lambertian states no name"),
        ('    equations = "the cosine law"\n', "", "class Lambertian states no equations"),
        ("import numpy as np", "raise ValueError('one\\ntwo')", "line 5: ValueError: one two"),
    ],
)
def test_a_slip_in_a_file_is_one_line_with_its_place(tmp_path, monkeypatch, old, new, fault):
    """Also where the file is part of a run: a KeyError of its own is not a model that nobody knows."""
    monkeypatch.chdir(ROOT)
    path, models = tmp_path / "slip.py", tmp_path / "models.yaml"
    text = EXAMPLE.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(ImportError, match=rf"^{re.escape(str(path))}: {fault}") as caught:
        load_model_file(path, "lambertian")
    assert "\n" not in str(caught.value)
    models.write_text(f"lambertian: {{source: {path}}}\n")
    with pytest.raises(ConfigError) as told:
        read_entries(models)
    assert str(told.value) == f"{models}: lambertian: {caught.value}"


def test_wrong_options_and_empty_materials_are_named():
    model = load_model_file(EXAMPLE)
    with pytest.raises(ValueError, match=r"lambertian: measure = 'area' is not one of pairs, slice"):
        model.check_options({"measure": "area"})
    with pytest.raises(FitError, match="lambertian on empty: no valid cell"):
        model.fit(Measured("empty", np.full((*GRID_SHAPE, 3), np.nan, np.float32)))


@pytest.mark.parametrize(
    ("default", "limits", "good", "bad"),
    [
        (True, {}, [True, False], [1, "false", None]),
        (3, {"low": 1, "high": 8}, [1, 8, np.int64(3)], [0, 9, 2.0, True, "3", float("nan")]),
        (0.5, {"low": 0.0}, [0, 2.5, np.float32(1)], [-0.1, False, "0.5", float("inf"), [1.0]]),
        ("text", {}, ["other"], [1, None]),
        ("auto", {"choices": ("auto", 1, 2)}, ["auto", 1, 2], [True, 3, "1", [1]]),
    ],
)
def test_an_option_takes_values_of_its_kind_only(default, limits, good, bad):
    option = Option(default, "", **limits)
    assert [option.fault(value) for value in good] == [""] * len(good)
    assert all(option.fault(value).startswith("is not ") for value in bad)


def test_every_default_is_allowed():
    for name, model in MODELS.items():
        assert model.check_options(model.check_options({})) == model.check_options({}), name


NAN_AT_GRAZING = """
import numpy as np
from brdfatlas.models.base import Model, Paper, Parameter, Result

class Holed(Model):
    name, title, equations, formula = "holed", "Holed", "", "NaN at grazing half angles"
    paper = Paper("A B", "C", "D", 2000)
    parameters = (Parameter("k", (1,), "number"),)

    def fit(self, measured, *, seed=0, **options):
        return Result({"k": np.ones(1)}, 0.0, "none", 1, True)

    def evaluate(self, parameters, wi, wo):
        h = (wi + wo) / np.linalg.norm(wi + wo, axis=-1, keepdims=True)
        return np.where(h[..., 2:] < 0.5, np.nan, np.ones(3))
"""


def test_a_fit_without_a_value_where_the_material_has_one_has_failed(tmp_path):
    """Its parameters are finite; every picture and every error of it would not be."""
    (tmp_path / "holed.py").write_text(NAN_AT_GRAZING)
    write_merl(tmp_path / "constant.binary", constant_material().table)
    files = [str(tmp_path / name) for name in ("constant.binary", "holed.npz", "holed.json")]
    entry = Entry("holed", "holed", source=str(tmp_path / "holed.py"))
    fit_job([entry.plain], 0, files[0], False, {"holed": files[1:]}, {"holed": ""}, str(tmp_path / "made"))
    report = read_json(files[2])
    assert report["status"] == "failed"
    assert re.search(r"^FitError: NaN or Inf at [\d,]+ measured cells", report["reason"])
    assert Path(files[1]).read_bytes() == b""


def test_a_model_of_one_s_own_is_sampled_drawn_and_shown_as_it_says(tmp_path):
    """The example's sampler, function and factors reach export, figure and viewer, none of which knows its name."""
    from test_sampling import chi_square, outgoing

    from brdfatlas.export.sampler import export_sampler
    from brdfatlas.export.uber_texture import has_row
    from brdfatlas.figures.functions import plot_functions
    from brdfatlas.reports.viewer import RHO_D_AT, factor_rows
    from brdfatlas.sampling import load_sampler

    entry = Entry("mine", "lambertian", source=str(EXAMPLE))
    fit(entry, constant_material()).save(tmp_path / "mine.npz")
    fitted = load_fit(tmp_path / "mine.npz")
    export_sampler(fitted, tmp_path / "sampler.json")
    p_value, missing, _ = chi_square(load_sampler(tmp_path / "sampler.json"), outgoing(50))
    assert p_value > 1e-4
    assert abs(missing) < 1e-3
    assert plot_functions(fitted, tmp_path / "functions.svg")
    assert "M" in {function.symbol for function in fitted.functions()}
    rows = factor_rows(fitted.factors())
    np.testing.assert_allclose(rows[0, RHO_D_AT, :3], GREY, rtol=1e-6)
    assert not has_row(entry.instance), "it has no G, so no row among the factors of Bagher et al. 2016"


def test_the_document_names_what_exists():
    """Every attribute the document explains is one of Model, and every file it links to is there."""
    text = (ROOT / "docs" / "add-a-model.md").read_text()
    for cell in re.findall(r"^\| (`[^|]*`) \|", text, re.MULTILINE):
        for attribute in re.findall(r"`(\w+)`", cell):
            assert attribute in Model.__annotations__ or callable(getattr(Model, attribute, None)), attribute
    for target in re.findall(r"\]\(([^)]+)\)", text):
        assert (ROOT / "docs" / target).exists(), target
