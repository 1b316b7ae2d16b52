import json
import multiprocessing
import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from threading import Barrier

import numpy as np
import pytest
from test_engine_models import drawn, synthetic

import brdfatlas
from brdfatlas.cli import main
from brdfatlas.export.gltf import read_gltf_material
from brdfatlas.files import FileFault
from brdfatlas.fits import load_fit
from brdfatlas.models import MODELS
from brdfatlas.recommend import Recommendation, Row

SMALL = {"processes": 1, "size": 24, "samples": 16}


@pytest.fixture(scope="module")
def material():
    return synthetic("gltf", drawn("gltf", 11, 0.3, 0.7))


@pytest.fixture(scope="module")
def found(material) -> Recommendation:
    told = []
    made = brdfatlas.recommend(material, models=["lambert", "ggx_diffuse", "gltf"], progress=told.append, **SMALL)
    assert len(told) == 4
    return made


def test_the_model_that_made_the_material_wins(found):
    assert found.winner.model == "gltf"
    assert [row.de00 for row in found.rows] == sorted(row.de00 for row in found.rows)
    assert found.winner.de00 < 0.2 < found.rows[-1].de00
    assert found.rows[-1].model == "lambert"
    table = found.table()
    for word in ("dE00", "FLIP", "PSNR", "bytes", "seconds", "without plugin", "> gltf"):
        assert word in table


def test_what_looks_wrong_in_the_file_is_told_before_any_fit(material):
    """Of pictures all white or all black every model has a dE00 of 0."""
    doubted = replace(material, provenance=replace(material.provenance, warnings=("values look unscaled",)))
    told = []
    brdfatlas.recommend(doubted, models=["lambert"], progress=told.append, **SMALL)
    assert "values look unscaled" in told[0]


def test_threads_recommend_for_their_own_material(material):
    """All have read their material before the first of them fits."""
    others = [replace(material, name=f"grey_{n}", table=np.full_like(material.table, n / 10)) for n in (1, 2, 3)]
    ready = Barrier(len(others))

    def albedo(measured):
        found = brdfatlas.recommend(measured, models=["lambert", "ggx"], progress=lambda line: ready.wait(), **SMALL)
        return found.fits["lambert"].material, found.fits["lambert"].parameters["kd"] / np.pi

    with ThreadPoolExecutor(len(others)) as pool:
        told = list(pool.map(albedo, others))
    for measured, (name, value) in zip(others, told):
        assert name == measured.name
        np.testing.assert_allclose(value, measured.table[0, 0, 0], rtol=1e-5)


def test_a_thread_that_fails_takes_no_other_thread_its_workers(material):
    """One is stopped after its first fit, when the other's workers are at work."""
    ready = Barrier(2)

    def winner(fails):
        def progress(line):
            if line.startswith("fit 1/") and ready.wait() is not None and fails:
                raise RuntimeError("mine")

        settings = SMALL | {"processes": 2, "progress": progress}
        return brdfatlas.recommend(material, models=["lambert", "ggx", "sgd", "gltf"], **settings).winner.model

    with ThreadPoolExecutor(2) as pool:
        fails, works = (pool.submit(winner, fails) for fails in (True, False))
        assert works.result() == "gltf"
        with pytest.raises(RuntimeError, match="mine"):
            fails.result()


def test_a_worker_that_may_have_none_fits_by_itself(material, found):
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        call = partial(brdfatlas.recommend, models=["lambert", "gltf"], **SMALL | {"processes": 2})
        made = pool.apply(call, (material,))
    assert {name: found.fits[name] for name in made.fits} == made.fits


def test_workers_import_nothing_from_the_working_folder(material, found, tmp_path, monkeypatch):
    (tmp_path / "struct.py").write_text("raise ImportError('of the user')")
    monkeypatch.chdir(tmp_path)
    before = dict(os.environ)
    made = brdfatlas.recommend(material, models=["lambert", "gltf"], **(SMALL | {"processes": 2}))
    assert {name: found.fits[name] for name in made.fits} == made.fits
    assert os.environ == before


def test_a_budget_leaves_what_fits_in_it(material):
    bound = brdfatlas.recommend(material, models=["lambert", "gltf"], budget=12, **SMALL)
    assert bound.winner.model == "lambert"
    assert brdfatlas.recommend(material, models=["lambert"], budget=11, **SMALL).winner is None


def test_a_target_fits_only_models_that_it_is_exactly(material):
    exact = brdfatlas.recommend(material, models=["ggx_diffuse", "lambert", "gltf"], target="gltf", **SMALL)
    assert {row.model for row in exact.rows} == {"lambert", "gltf"}
    assert all("gltf" in row.targets for row in exact.rows)


def test_workers_find_the_same_fits(material, found):
    again = brdfatlas.recommend(material, models=["lambert", "gltf"], **(SMALL | {"processes": 2}))
    for name in ("lambert", "gltf"):
        assert again.fits[name] == found.fits[name]


def test_everything_of_the_winner_is_written(found, tmp_path):
    files = found.save(tmp_path)
    assert {path.suffix for path in files} == {".npz", ".xml", ".mtlx", ".gltf", ".json", ".png"}
    assert all(path.is_file() for path in files)
    (npz,) = (path for path in files if path.suffix == ".npz")
    assert load_fit(npz) == found.fits["gltf"]
    factors = read_gltf_material(npz.with_suffix(".gltf"))
    assert np.float32(factors["roughnessFactor"]) == found.fits["gltf"].parameters["roughness"][0]
    assert f"{found.winner.de00:.3f}" in npz.with_suffix(".gltf").read_text()
    told = json.loads((tmp_path / "recommendation.json").read_text())
    assert told["winner"] == "gltf"
    assert [row["model"] for row in told["models"]] == [row.model for row in found.rows]


@pytest.mark.parametrize("name", ["{out}/v", "../../v", "a/b\\c", "v\0\n\x1b", "ü" * 255])
def test_no_name_of_a_material_leads_out_of_the_folder(found, tmp_path, monkeypatch, name):
    monkeypatch.setattr(Recommendation, "picture", lambda self, path: path.write_text("picture"))
    out = tmp_path / "out"
    files = replace(found, material=name.format(out=tmp_path)).save(out / "sub")
    assert {path.parent for path in files} == {out / "sub"}
    assert [path.name for path in out.iterdir()] == ["sub"]
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_a_folder_at_an_output_stops_all_of_them(found, tmp_path):
    (tmp_path / "side-by-side.png").mkdir()
    with pytest.raises(FileFault, match=r"holds files that are not of an earlier recommendation"):
        found.save(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["side-by-side.png"]
    (tmp_path / "recommendation.json").write_text('{"format": "brdfatlas recommendation 1"}')
    with pytest.raises(FileFault, match=r"side-by-side.png: is not of an earlier recommendation"):
        found.save(tmp_path)
    assert (tmp_path / "recommendation.json").read_text() == '{"format": "brdfatlas recommendation 1"}'


def test_files_of_the_same_names_are_not_replaced(found, tmp_path):
    (tmp_path / "recommendation.json").write_text('{"of": "mine"}')
    with pytest.raises(FileFault, match=r"recommendation.json: is not of an earlier recommendation"):
        found.save(tmp_path)
    assert (tmp_path / "recommendation.json").read_text() == '{"of": "mine"}'


def test_a_model_named_twice_is_tried_once(material):
    twice = brdfatlas.recommend(material, models=["lambert", "lambert"], **SMALL)
    assert [row.model for row in twice.rows] == ["lambert"]


def test_a_model_that_fails_is_a_row_that_says_why(material, monkeypatch):
    def fail(*args, **options):
        raise brdfatlas.models.base.FitError("no start is finite")

    monkeypatch.setattr(type(MODELS["ggx_diffuse"]), "fit", fail)
    made = brdfatlas.recommend(material, models=["ggx_diffuse", "lambert"], **SMALL)
    assert made.winner.model == "lambert"
    assert made.rows[-1].model == "ggx_diffuse"
    assert "no start is finite" in made.rows[-1].reason
    assert "no start is finite" in made.table()


def test_nothing_is_written_without_a_winner(found, tmp_path):
    none = Recommendation("made", (Row("lambert", float("nan"), 12),), None, {}, {}, found.tone)
    with pytest.raises(ValueError, match="nothing to write"):
        none.save(tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_faults_are_known_before_any_fit(material, tmp_path, capsys):
    with pytest.raises(ValueError, match="unknown target 'unreal'; known targets: mitsuba, materialx, gltf"):
        brdfatlas.recommend(tmp_path / "none.binary", target="unreal")
    brdfatlas.write_merl(tmp_path / "file", material.table)
    (tmp_path / "thesis").mkdir()
    (tmp_path / "thesis" / "side-by-side.png").write_text("mine")
    for arguments in (["none.binary"], ["none.binary", "-o", "file"], ["file", "-o", "thesis"]):
        assert main(["recommend", *(a if a.startswith("-") else str(tmp_path / a) for a in arguments)]) == 1
        captured = capsys.readouterr()
        assert len(captured.err.strip().splitlines()) == 1
        assert "fit 1" not in captured.err
    assert "not of an earlier recommendation" in captured.err
    assert (tmp_path / "thesis" / "side-by-side.png").read_text() == "mine"


def test_a_poor_match_is_called_one(tmp_path, capsys):
    """A mirror-like surface, and only a diffuse model to choose from."""
    arguments = ["standin", "chrome", "-o", str(tmp_path / "chrome.binary")]
    assert main(arguments) == 0
    assert main(["recommend", str(tmp_path / "chrome.binary"), "--models", "lambert"]) == 0
    captured = capsys.readouterr()
    assert "none of these models comes close to chrome" in captured.out
    assert main(["recommend", str(tmp_path / "chrome.binary"), "--models", "lambert,unreal"]) == 1
    assert "unknown model 'unreal'" in capsys.readouterr().err
