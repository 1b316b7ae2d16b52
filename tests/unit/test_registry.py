"""Entries: rows of a run by name, each a class with options; what they are reaches every job as plain values."""

import json
from pathlib import Path

import numpy as np
import pytest
import yaml

import brdfatlas
from brdfatlas.fits import Fit, load_fit
from brdfatlas.measured import Measured
from brdfatlas.models import MODELS, Entry, Registry, read_entries, use_entries
from brdfatlas.models.entries import TABLE, builtin_entries
from brdfatlas.settings import ConfigError

ROOT = Path(__file__).resolve().parents[2]
EXAMPLE = ROOT / "examples" / "lambertian.py"


def write_models(folder: Path, rows: dict) -> Path:
    path = folder / "models.yaml"
    path.write_text(yaml.safe_dump(rows, sort_keys=False))
    return path


def test_every_entry_of_the_package_can_be_used():
    """The table that names are looked up in is the shipped configuration; every option in it is its model's."""
    assert read_entries(TABLE) == builtin_entries() == read_entries(ROOT / "config" / "models.yaml")
    assert list(MODELS) == list(builtin_entries())


def test_a_short_citation_names_who_wrote():
    assert MODELS["gltf"].paper.short == "Khronos 2022"
    assert MODELS["ggx"].paper.short == "Dupuy et al. 2015"


def test_stable_names_stand_for_a_class_with_options():
    told = {name: (MODELS.entry(name).model, dict(MODELS.entry(name).options)) for name in MODELS}
    assert told["low_rank_2"] == ("low_rank", {"rank": 2})
    assert told["low_rank_4"] == ("low_rank", {"rank": 4})
    assert told["abc_compressive"] == ("abc", {"objective": "compressive"})
    assert MODELS["abc_compressive"].options["objective"].default == "compressive"
    assert MODELS["abc"].options["objective"].default == "e2"
    assert [MODELS[f"low_rank_{rank}"].title for rank in (2, 4)] == ["Rank-2 table times G", "Rank-4 table times G"]
    assert "low_rank" not in list(MODELS), "a class that no entry of the table is called by"
    assert MODELS["low_rank"].name == "low_rank"


def test_rows_have_titles_of_their_own(tmp_path):
    """Pages, tables and the PDF show the title alone."""
    (tmp_path / "p.csv").write_text("material\n")
    rows = {"lambert": None, "again": {"model": "lambert"}, "same": {"model": "lambert", "objective": "compressive"}}
    rows |= {name: {"model": "lambert", "parameters": str(tmp_path / "p.csv")} for name in ("here", "there")}
    titles = [entry.title for entry in read_entries(write_models(tmp_path, rows)).values()]
    assert len(set(titles)) == len(titles)
    assert titles[:2] == ["Lambert", "Lambert (again)"]


def test_one_model_stands_twice_with_its_own_title_and_size(tmp_path):
    rows = {"ggx": None, "ggx-2015": {"model": "ggx", "fresnel": "egsr2015"}, "wide": {"model": "low_rank", "rank": 7}}
    entries = read_entries(write_models(tmp_path, rows))
    assert [entry.model for entry in entries.values()] == ["ggx", "ggx", "low_rank"]
    assert entries["ggx"].title == "GGX microfacet"
    assert entries["ggx-2015"].title == "GGX microfacet (fresnel egsr2015)"
    assert entries["wide"].bytes == 4 * 3 * (180 * 7 + 91)
    assert entries["wide"].free_parameters == 3 * (180 * 7 + 91)
    assert entries["ggx-2015"].module == "brdfatlas.models.dupuy2015.ggx"


def test_an_entry_is_the_same_after_a_journey_as_plain_values():
    entry = Entry("mine", "lambertian", {"measure": "slice"}, source=str(EXAMPLE))
    assert Entry(**json.loads(json.dumps(entry.plain))) == entry
    assert entry.instance.options["measure"].default == "slice"
    assert entry.module == str(EXAMPLE)


def test_entries_of_a_run_stand_over_those_of_the_package(monkeypatch):
    registry = Registry()
    monkeypatch.setattr("brdfatlas.models.MODELS", registry)
    use_entries([Entry("ggx", "ggx", {"iterations": 9}).plain, Entry("x", "lambertian", source=str(EXAMPLE)).plain])
    assert registry["ggx"].options["iterations"].default == 9
    assert registry["x"].name == "lambertian"
    assert list(registry)[-1] == "x"
    with pytest.raises(KeyError, match="unknown model 'nothing'; known: tabulated, "):
        registry["nothing"]


@pytest.mark.parametrize(
    ("rows", "words"),
    [
        ({"mine": {"model": "gxx"}}, "mine: unknown model 'gxx'; known: .*needs source: FILE.py"),
        ({"reference_again": {}}, "reserved"),
        ({"low": {"model": "low_rank", "rank": 0}}, "low: model low_rank: rank = 0 is not a whole number of 1 to 90"),
        ({"ggx": {}, "GGX": {"model": "ggx"}}, "ggx and GGX differ in case alone|GGX and ggx differ in case alone"),
        ({"mine": {"model": 3}}, "mine.model: 3 is not of type 'string'"),
        ({"given": {"model": "ward", "parameters": "gone.csv"}}, "given: parameters: gone.csv: no such file"),
    ],
)
def test_faults_of_entries_are_one_line(tmp_path, rows, words):
    with pytest.raises(ConfigError, match=words) as caught:
        read_entries(write_models(tmp_path, rows))
    assert "\n" not in str(caught.value)


@pytest.fixture(scope="module")
def measured() -> Measured:
    from brdfatlas.angles import GRID_SHAPE, above_horizon

    table = np.full((*GRID_SHAPE, 3), 0.25, np.float32)
    table[~above_horizon()] = np.nan
    return Measured("grey", table)


def test_a_fit_knows_its_row_its_class_and_its_file(tmp_path, measured, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.py").write_text(EXAMPLE.read_text())
    fitted = brdfatlas.fit(Entry("row", "lambertian", {"measure": "slice"}, source="mine.py"), measured)
    assert (fitted.entry, fitted.model, fitted.source) == ("row", "lambertian", "mine.py")
    assert fitted.options == {"measure": "slice"}
    fitted.save("fit.npz")
    loaded = load_fit("fit.npz")
    assert loaded == fitted
    np.testing.assert_array_equal(loaded.table(), fitted.table())
    (tmp_path / "mine.py").rename(tmp_path / "moved.py")
    with pytest.raises(ValueError, match=r"^fit\.npz: its model 'lambertian' .*mine\.py: no such model file.*--source"):
        load_fit("fit.npz")
    np.testing.assert_array_equal(load_fit("fit.npz", "moved.py").table(), fitted.table())


def test_a_row_with_the_name_of_another_class_changes_no_fit(measured, tmp_path, monkeypatch):
    monkeypatch.setattr(MODELS, "_own", {})
    brdfatlas.fit("ggx", measured).save(tmp_path / "ggx.npz")
    use_entries(Entry(name, other).plain for name, other in [("ggx", "gaussian"), ("gaussian", "ggx")])
    assert type(load_fit(tmp_path / "ggx.npz").instance).__name__ == "GGX"
    for name in ("ggx", "gaussian"):
        fitted = brdfatlas.fit(name, measured)
        fitted.save(tmp_path / "row.npz")
        np.testing.assert_array_equal(load_fit(tmp_path / "row.npz").table(), fitted.table())


def test_fits_of_before_entries_still_load(tmp_path):
    """Their files name no entry, and call the low-rank models by the names of their old classes."""
    parameters = {p.name: np.ones(p.shape, p.dtype) for p in MODELS["low_rank_2"].parameters}
    Fit("low_rank_2", "grey", parameters, {"power": 1.4}).save(tmp_path / "old.npz")
    with np.load(tmp_path / "old.npz") as store:
        assert not {"entry", "source"} & set(store)
    loaded = load_fit(tmp_path / "old.npz")
    assert loaded.entry == "low_rank_2"
    assert np.isfinite(loaded.evaluate([0.0, 0.6, 0.8], [0.6, 0.0, 0.8])).all()


def test_equal_fits_are_equal():
    one, other = (Fit("ward", "m", {"kd": np.array([0.1, 0.2, np.nan])}) for _ in range(2))
    assert one == other
    assert one != Fit("ward", "m", {"kd": np.array([0.1, 0.2, 0.3])})
    assert one != Fit("ward", "m", {"ks": np.zeros(3)})
    assert one != "ward"
    assert len({one, other}) == 1
