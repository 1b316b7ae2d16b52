"""Rules make_standin, describe_material, record_run, fit_dupuy2015, check_failures, each alone."""

import json

import numpy as np
import pytest

from brdfatlas import load_fit, read_merl
from brdfatlas.objectives import compressive_weights, log_deviation, relative_objective
from brdfatlas.pipeline.records import check_failures_job
from brdfatlas.pipeline.standins import make_standin


def test_make_standin(run_rule):
    path = run_rule("make_standin", "results/standins/chrome.binary")
    np.testing.assert_allclose(read_merl(path).table, make_standin("chrome").table, rtol=1e-5)


def test_describe_material(run_rule):
    described = json.loads(run_rule("describe_material", "results/materials/pink-felt.json").read_text())
    assert described["standin"] is True
    assert described["class"] == "diffuse"
    assert 0 < min(described["albedo"]) < max(described["albedo"]) < 1
    assert described["albedo"][0] > described["albedo"][1]  # it is pink


def test_record_run(run_rule):
    run = json.loads(run_rule("record_run", "results/run.json").read_text())
    assert [item["name"] for item in run["inputs"]] == ["pink-felt", "chrome"]


def test_fit_models(run_rule, finished_run):
    fitted = load_fit(run_rule("fit_dupuy2015", "results/fits/pink-felt/ggx.npz"))
    report = json.loads((finished_run.root / "results/fits/pink-felt/ggx.json").read_text())
    measured = read_merl(finished_run.root / "results/standins/pink-felt.binary", standin=True)
    assert (fitted.model, fitted.material, fitted.standin) == ("ggx", "pink-felt", True)
    assert report["status"] == "ok"
    assert report["bytes"] == fitted.bytes
    assert report["physics"]["bad_cells"] == 0
    assert report["physics"]["reciprocity_error"] < 1e-5
    table = fitted.table()
    assert relative_objective(table, measured.table, compressive_weights(measured.table)) < 1
    assert log_deviation(table, measured.table) < 0.5


def test_check_failures(run_rule, finished_run, tmp_path):
    assert "all 4 fits succeeded" in run_rule("check_failures", "results/verdict.txt").read_text()

    good = finished_run.root / "results" / "fits" / "chrome" / "ggx.json"
    bad = tmp_path / "ggx.json"
    bad.write_text(json.dumps(json.loads(good.read_text()) | {"status": "failed", "reason": "it rained"}))
    with pytest.raises(SystemExit, match="ggx on chrome: it rained"):
        check_failures_job([str(good), str(bad)], str(tmp_path / "verdict.txt"))
    assert not (tmp_path / "verdict.txt").exists()


def test_a_missing_fit_is_not_silently_skipped(finished_run):
    with pytest.raises(ValueError, match="no such fit"):
        load_fit(finished_run.root / "results" / "fits" / "chrome" / "absent.npz")
