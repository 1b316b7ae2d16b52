"""examples/own-study: a folder of a user's own, with data, a model and a scene, that uses the workflow as a module."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from brdfatlas import load_fit, read
from brdfatlas.objectives import importance_weight
from brdfatlas.pipeline.standins import write_standin

ROOT = Path(__file__).parents[2]
SETTINGS = ("--config", f"brdfatlas={ROOT / 'Snakefile'}", "render={size: 16, samples: 8, batches: 4}")


@pytest.fixture
def study(project_in, tmp_path):
    """A copy of the example with one small material, outside any checkout."""
    shutil.copytree(ROOT / "examples" / "own-study", tmp_path, dirs_exist_ok=True)
    write_standin("pink-felt", tmp_path / "data" / "measured" / "mine.binary")
    return project_in(tmp_path)


def test_a_study_takes_its_own_data_model_and_scene_and_the_rest_from_the_package(study):
    def snakemake(*arguments):
        return study.snakemake(*SETTINGS, *arguments)

    jobs = study.jobs(snakemake("--dry-run").stdout)
    assert jobs["fit_dupuy2015"] == jobs["fit_own_lambertian"] == 1
    assert jobs["prepare_scene"] == jobs["render_material"] == jobs["write_index"] == 1
    snakemake("--", "reports/materials/mine.html")
    measured = read(study.root / "data" / "measured" / "mine.binary")
    weight = importance_weight(measured.valid, measure="pairs")
    counted = weight > 0
    results = study.root / "results"
    assert {path.name for path in (results / "renders" / "mine").rglob("*.exr")} == {"two_spheres.exr"}
    page = (study.root / "reports" / "materials" / "mine.html").read_text()
    assert "two_spheres" in page
    assert "Lambertian" in page
    # The fit of the study's own model is what its file computes.
    fit = load_fit(results / "fits" / "mine" / "lambertian.npz", source=study.root / "models" / "lambertian.py")
    assert fit.model == "lambertian"
    rho = fit.parameters["albedo"] / np.pi
    mean = np.average(measured.table[counted], axis=0, weights=weight[counted])
    np.testing.assert_allclose(rho, mean, rtol=1e-5)
    assert str(ROOT) not in page


def test_the_door_of_the_catalog_leads_to_the_same_run(project):
    assert project.planned("--snakefile", "workflow/Snakefile") == project.planned()
