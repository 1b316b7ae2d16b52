"""`snakemake ablation`: one model under several objectives, fitted, rendered, judged, on a page."""

import json

import numpy as np
import pandas as pd
import pytest

from brdfatlas import load_fit, read_merl
from brdfatlas.objectives import compressive_weights, relative_objective


def test_ablation(finished_run):
    """Each fit is the better one under its own objective, and the page shows the numbers of its table."""
    planned = finished_run.planned("ablation")
    assert planned["fit_model"] == planned["render_material"] == 2, "the references of the run are used again"
    finished_run.snakemake("ablation")
    root = finished_run.root
    measured = read_merl(root / "results/standins/chrome.binary")
    tables, reports = {}, {}
    for variant in ("published", "flat"):
        tables[variant] = load_fit(root / f"results/fits/chrome/naive.{variant}.npz").table()
        reports[variant] = json.loads((root / f"results/fits/chrome/naive.{variant}.json").read_text())
    assert reports["published"]["options"]["power"] == 1.4
    assert reports["flat"]["options"]["power"] == 0
    for variant, other, power in (("published", "flat", 1.4), ("flat", "published", 0.0)):
        weights = compressive_weights(measured.table, power=power)
        own, others = (relative_objective(tables[name], measured.table, weights) for name in (variant, other))
        assert own == pytest.approx(reports[variant]["objective"], rel=1e-4), "float32 factors"
        assert own < others
    rows = pd.read_csv(root / "reports/data/ablation.tsv", sep="\t")
    assert list(rows["variant"]) == ["published", "flat"]
    assert set(rows["model"]) == {"naive"}
    page = (root / "reports/ablation.html").read_text()
    assert np.isfinite(rows["psnr_db"]).all()
    for value in rows["psnr_db"]:
        assert f"{value:.1f}" in page
    assert "1 of 1 materials are stand-ins, not measurements" in page
    for name in ("reference", "naive.published", "naive.flat"):
        assert f"ablation/chrome/studio_sphere-{name}.webp" in page
        assert (root / f"reports/ablation/chrome/studio_sphere-{name}.webp").stat().st_size > 100
    assert finished_run.planned("ablation") == {}
    assert finished_run.planned() == {}, "the run itself is not touched"


def test_a_material_that_is_not_there_is_told_and_stops_nothing_else(project):
    project.configure(ablation={"materials": ["brass", "chrome"], "models": ["naive"]})
    plan = project.snakemake("--dry-run", "ablation").stdout
    assert "left out of the ablation: brass is not a material of this run" in plan
    assert project.jobs(plan)["measure_ablation"] == 1


@pytest.mark.parametrize(
    ("ablation", "words"),
    [
        ({"models": ["naiv"]}, "config: ablation.models: 'naiv' is not known; known: "),
        ({"models": ["ggx"], "variants": {"flat": {"power": 0}}}, "ablation.variants.flat: model ggx: unknown option"),
        ({"variants": {"a/b": {}}}, "config: ablation.variants: 'a/b' is not a usable name"),
    ],
)
def test_faults_are_named_before_any_work(project, ablation, words):
    project.configure(ablation=ablation)
    done = project.snakemake("--dry-run", "ablation", check=False)
    assert done.returncode == 1
    assert words in done.stdout
    assert "Traceback" not in done.stdout
