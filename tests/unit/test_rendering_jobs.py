"""The jobs: one EXR a scene, kept while still right; a failed fit is told from a black picture."""

import os
import re
from pathlib import Path

import numpy as np
import pytest
import yaml
from rendering_materials import material, variant

from brdfatlas.files import write_json
from brdfatlas.fits import fit
from brdfatlas.formats.merl import write_merl
from brdfatlas.measured import MeasuredError
from brdfatlas.rendering import jobs
from brdfatlas.rendering.images import load_render, read_meta
from brdfatlas.rendering.scenes import SceneError, load_scene, read_scenes

SETTINGS = {"samples": 16, "batches": 4, "seed": 1, "variant": "llvm_ad_rgb"}
SPHERE = {"geometry": [{"shape": "sphere"}], "camera": {"origin": [0, 0, 4]}}
SCENES = {
    "a": SPHERE | {"environment": {"kind": "studio", "width": 32}},
    "b": SPHERE | {"environment": {"kind": "hall", "width": 32}},
}


@pytest.fixture
def here(tmp_path):
    """A folder with two prepared scenes, a material, a fit and a failed fit's report."""
    variant()
    (tmp_path / "scenes.yaml").write_text(yaml.safe_dump(SCENES))
    for name, definition in read_scenes(tmp_path / "scenes.yaml").items():
        jobs.prepare_scene_job(name, definition, 16, "llvm_ad_rgb", "scenes.yaml", str(tmp_path / f"{name}.npz"))
    write_merl(tmp_path / "m.binary", material(0.3).table)
    fit("ggx", material(0.3)).save(tmp_path / "ggx.npz")
    write_json(tmp_path / "ggx.json", {"status": "ok"})
    write_json(tmp_path / "failed.json", {"status": "failed", "reason": "no finite fit"})
    (tmp_path / "failed.npz").touch()
    return tmp_path


def run(here, model="reference", names="ab", **changes):
    """Run the job; returns the outputs whose pixels were made anew."""
    found = model not in ("reference", "reference_again")
    outputs = {name: str(here / f"{model}-{name}.exr") for name in names}
    before = {path: Path(path).stat().st_ino if Path(path).exists() else None for path in outputs.values()}
    jobs.render_job(
        "m",
        model,
        str(here / "m.binary"),
        str(here / f"{model}.npz") if found else None,
        str(here / f"{model}.json") if found else None,
        {name: str(here / f"{name}.npz") for name in names},
        outputs,
        SETTINGS | changes,
    )
    return [name for name, path in outputs.items() if Path(path).stat().st_ino != before[path]]


def test_a_render_is_kept_while_it_is_right(here):
    assert run(here, names="a") == ["a"]
    old = os.stat(here / "reference-a.exr").st_mtime_ns
    assert run(here, names="ab") == ["b"]  # a new scene renders only itself,
    assert os.stat(here / "reference-a.exr").st_mtime_ns > old  # but Snakemake sees every output as made
    assert run(here, names="ab") == []
    assert run(here, names="ab", samples=24) == ["a", "b"]
    assert run(here, names="ab", samples=24, scene_samples={"a": 32, "b": None}) == ["a"]
    (here / "reference-a.exr").write_bytes((here / "reference-a.exr").read_bytes()[:-200])
    assert run(here, names="ab", samples=24, scene_samples={"a": 32, "b": None}) == ["a"]  # damaged: made again
    write_merl(here / "m.binary", 1.1 * material(0.3).table)
    assert run(here, names="ab", samples=24) == ["a", "b"]


def test_a_new_exposure_changes_the_label_not_the_pixels(here):
    run(here, names="a")
    pixels = load_render(here / "reference-a.exr")
    scene = load_scene(here / "a.npz")
    scene.definition["exposure"] = 7.0
    scene.save(here / "a.npz")
    run(here, names="a")
    again = load_render(here / "reference-a.exr")
    assert again.meta["exposure"] == "7.0"
    assert again.meta["fingerprint"] == pixels.meta["fingerprint"]
    np.testing.assert_array_equal(again.mean, pixels.mean)
    np.testing.assert_array_equal(again.batches, pixels.batches)


def test_fits_share_the_random_numbers_of_their_reference(here):
    """A fit that is the reference has its very pixels; the repetition has others."""
    for model in ("reference", "reference_again", "ggx"):
        run(here, model, names="a")
    reference, again, fitted = (load_render(here / f"{m}-a.exr") for m in ("reference", "reference_again", "ggx"))
    inside = reference.mask
    noise = np.sqrt(((again.mean - reference.mean)[inside] ** 2).mean())
    assert 0 < noise < reference.mean[inside].mean()
    assert again.meta["seed"] != reference.meta["seed"] == fitted.meta["seed"]
    # Deviations of batches from their means are almost proportional: the samples are the same.
    a, b = ((r.batches - r.mean)[:, inside].ravel() for r in (reference, fitted))
    assert np.corrcoef(a, b)[0, 1] > 0.9
    c = (again.batches - again.mean)[:, inside].ravel()
    assert abs(np.corrcoef(a, c)[0, 1]) < 0.1


def test_a_failed_fit_is_said_to_have_failed(here):
    run(here, "failed", names="a")
    render = load_render(here / "failed-a.exr")
    assert render.meta["status"] == "failed"
    assert not render.mean.any()
    assert render.mask.any()
    assert run(here, "failed", names="a") == []
    fit("ggx", material(0.3)).save(here / "failed.npz")
    write_json(here / "failed.json", {"status": "ok"})
    assert run(here, "failed", names="a") == ["a"]
    assert read_meta(here / "failed-a.exr")["status"] == "ok"


def test_files_are_checked_before_any_rendering(here):
    scenes = {"mine": SCENES["a"] | {"environment": {"kind": "file", "file": "gone.hdr"}}}
    (here / "bad.yaml").write_text(yaml.safe_dump(scenes))
    with pytest.raises(SceneError, match=re.escape("bad.yaml: mine.environment.file: gone.hdr: no such file")):
        jobs.check_scenes_job(read_scenes(here / "bad.yaml"), "bad.yaml", "llvm_ad_rgb", str(here / "checked.txt"))
    assert not (here / "checked.txt").exists()
    jobs.check_scenes_job(read_scenes(here / "scenes.yaml"), "scenes.yaml", "llvm_ad_rgb", str(here / "checked.txt"))
    assert (here / "checked.txt").read_text() == "a: ok\nb: ok\n"


def test_render_file(here):
    scenes = here / "scenes.yaml"
    render = jobs.render_file(here / "m.binary", "a", samples=16, size=12, scenes=scenes)
    assert render.mean.shape == (12, 12, 3)
    assert render.meta["material"] == "m"
    fitted = jobs.render_file(here / "ggx.npz", "a", samples=16, size=12, scenes=scenes)
    assert fitted.meta["model"] == "ggx"
    traced = jobs.render_file(here / "m.binary", "a", samples=512, size=12, scenes=scenes, integrator="path")
    direct = jobs.render_file(here / "m.binary", "a", samples=512, size=12, scenes=scenes)
    # A lone sphere reflects nothing twice: paths find what direct light finds.
    inside = direct.mask
    assert traced.mean[inside].mean() == pytest.approx(direct.mean[inside].mean(), rel=0.05)
    for arguments, message in (
        ({"scene": "z"}, "no scene 'z'; it has a, b"),
        ({"samples": 0}, "render.samples"),
        ({"size": 0}, "render.size"),
        ({"integrator": "magic"}, "magic"),
        ({"variant": "magic_rgb"}, "magic_rgb"),
    ):
        with pytest.raises(ValueError, match=message):
            jobs.render_file(here / "m.binary", **({"scene": "a", "scenes": scenes, "size": 8} | arguments))
    with pytest.raises(MeasuredError, match=r"absent\.binary"):
        jobs.render_file(here / "absent.binary", "a", scenes=scenes)


def test_the_papers_scenes_are_valid():
    """Their files are the user's; without them the check names the first that is missing, and its key."""
    path = Path(__file__).parents[2] / "config" / "scenes_papers.yaml"
    scenes = read_scenes(path)
    assert len(scenes) == 4
    if not Path(scenes["grace_sphere"]["environment"]["file"]).exists():
        variant()
        with pytest.raises(SceneError, match=r"grace_sphere\.environment\.file: .*grace_probe\.hdr: no such file"):
            jobs.check_scene(scenes["grace_sphere"], f"{path}: grace_sphere")
