"""The rules animations, draw_animation and draw_convergence: only when asked for, then linked from the page."""

import json
import shutil

from PIL import Image


def test_animations(finished_run, tmp_path):
    project = type(finished_run)(tmp_path / "project")
    shutil.copytree(finished_run.root, project.root)
    project.configure(animation={"frames": 3, "size": 24, "samples": 8})
    assert "draw_animation" not in project.planned(), "the report asks for none"
    done = project.snakemake("animations")
    assert project.jobs(done.stdout) == {"animations": 1, "draw_animation": 2}
    page = project.root / "reports/materials/chrome.html"
    assert "animation.webp" not in page.read_text(encoding="utf-8")
    with Image.open(page.with_suffix("") / "animation.webp") as image:
        assert image.n_frames == 3
        assert image.size[0] == 3 * 24, "reference, recommended and another model"
    note = json.loads((project.root / "results/animations/chrome.json").read_text())
    assert note["scene"] == "studio_sphere"
    assert sorted(note["models"]) == ["gaussian", "ggx"]
    assert project.jobs(project.snakemake().stdout)["write_material_page"] == 2
    assert "chrome/animation.webp" in page.read_text(encoding="utf-8")
    (page.with_suffix("") / "animation.webp").unlink()
    project.snakemake()
    assert "animation.webp" not in page.read_text(encoding="utf-8"), "no link leads nowhere"
    project.configure(materials=["chrome"])
    project.snakemake()
    assert not (page.parent / "pink-felt").exists(), "a material that left takes its animation along"


def test_a_model_that_is_not_in_the_run_is_refused(finished_run):
    done = finished_run.snakemake("--dry-run", "--config", "animation={model: sgd}", "--", "animations", check=False)
    assert done.returncode != 0
    assert "config: animation.model: 'sgd' is not known; known: ggx, gaussian" in done.stdout


def test_the_starts_of_independent_factors_are_shown_where_they_are_in_the_run(finished_run, tmp_path):
    project = type(finished_run)(tmp_path / "project")
    shutil.copytree(finished_run.root, project.root)
    project.configure(materials=["pink-felt"], models=["ggx", "independent_g"])
    target = "reports/materials/pink-felt/convergence.webp"
    done = project.snakemake("--", target)
    assert project.jobs(done.stdout) == {"draw_convergence": 1}
    with Image.open(project.root / target) as image:
        assert image.n_frames > 5
    assert project.planned("--", "animations")["draw_animation"] == 1
    assert project.planned("--", "reports/materials/pink-felt.html")["write_material_page"] == 1
