"""Scenes in the workflow: a new one, or a new model, renders only itself; a missing file stops the run at once."""

import numpy as np
import yaml

from brdfatlas.rendering.images import load_render

RENDERS = "results/renders/pink-felt/reference"
ERRORS = "results/errors/pink-felt/images.tsv"
SCENE = {
    "geometry": [{"shape": "sphere"}],
    "environment": {"kind": "hall", "width": 32},
    "camera": {"origin": [0, 0, 6]},
}


def add_scene(project, name, **changes):
    path = project.root / "config" / "scenes.yaml"
    path.write_text(yaml.safe_dump(yaml.safe_load(path.read_text()) | {name: SCENE | changes}, sort_keys=False))
    project.configure(scenes=["studio_sphere", name])


def test_a_new_scene_renders_only_itself(project):
    first, second = f"{RENDERS}/studio_sphere.exr", f"{RENDERS}/mine.exr"
    log = project.root / "results/logs/render_material/pink-felt/studio_sphere.log"
    project.snakemake("--", first)
    assert "reference/studio_sphere.exr: rendered" in log.read_text()
    before = load_render(project.root / first)
    inode = (project.root / first).stat().st_ino
    add_scene(project, "mine")
    assert project.planned("--", first, second)["render_material"] == 1
    project.snakemake("--", first, second)
    assert (project.root / first).stat().st_ino == inode
    np.testing.assert_array_equal(load_render(project.root / first).mean, before.mean)
    assert load_render(project.root / second).mask.any()
    assert project.planned("--", first, second) == {}
    project.snakemake("--", ERRORS)
    # A new model renders only itself, whatever of it is asked for by name.
    project.configure(models=["ggx", "gaussian", "tabulated"])
    project.snakemake("--", ERRORS)
    assert "tabulated" in (project.root / ERRORS).read_text()
    said = log.read_text()
    assert "tabulated/studio_sphere.exr: rendered" in said
    assert "reference/studio_sphere.exr: kept" in said
    assert "ggx/studio_sphere.exr: kept" in said
    assert (project.root / first).stat().st_ino == inode


def test_a_missing_probe_stops_before_any_work(project):
    add_scene(project, "mine", environment={"kind": "file", "file": "data/assets/gone.hdr"})
    done = project.snakemake("--", f"{RENDERS}/mine.exr", check=False)
    assert done.returncode != 0
    fault = "config/scenes.yaml: mine.environment.file: data/assets/gone.hdr: no such file"
    assert [line for line in done.stdout.splitlines() if fault in line]
    assert not list((project.root / "results").rglob("*.npz"))
