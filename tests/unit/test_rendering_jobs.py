"""The jobs: one EXR a model, kept while still right; a failed fit is told from a black picture."""

import os
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from rendering_materials import material, variant

import brdfatlas
from brdfatlas.cli import main
from brdfatlas.files import write_json
from brdfatlas.fits import fit
from brdfatlas.formats.merl import write_merl
from brdfatlas.measured import Measured, MeasuredError
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
    replace(fit("ggx", material(0.3)), material="m").save(tmp_path / "ggx.npz")
    write_json(tmp_path / "ggx.json", {"status": "ok"})
    write_json(tmp_path / "failed.json", {"status": "failed", "reason": "no finite fit"})
    (tmp_path / "failed.npz").touch()
    return tmp_path


def run(here, *models, scene="a", **changes):
    """Run the job; returns the models whose pixels were made anew."""
    models = models or ("reference",)
    outputs = {model: str(here / f"{model}-{scene}.exr") for model in models}
    before = {path: Path(path).stat().st_ino if Path(path).exists() else None for path in outputs.values()}
    fits = {m: (str(here / f"{m}.npz"), str(here / f"{m}.json")) for m in models if not m.startswith("reference")}
    binary, prepared = str(here / "m.binary"), str(here / f"{scene}.npz")
    jobs.render_job("m", binary, prepared, fits, outputs, SETTINGS | changes, made=f"{binary}.made")
    return [model for model, path in outputs.items() if Path(path).stat().st_ino != before[path]]


def test_a_render_is_kept_while_it_is_right(here):
    assert run(here) == ["reference"]
    old = os.stat(here / "reference-a.exr").st_mtime_ns
    assert run(here, "reference", "ggx") == ["ggx"]  # a new model renders only itself,
    assert os.stat(here / "reference-a.exr").st_mtime_ns > old  # but Snakemake sees every output as made
    assert run(here, "reference", "ggx") == []
    assert run(here, "reference", "ggx", scene="b") == ["reference", "ggx"]
    assert run(here, "reference", "ggx", samples=24) == ["reference", "ggx"]
    (here / "reference-a.exr").write_bytes((here / "reference-a.exr").read_bytes()[:-200])
    assert run(here, "reference", "ggx", samples=24) == ["reference"]  # damaged: made again
    replace(fit("gaussian", material(0.3)), entry="ggx", material="m").save(here / "ggx.npz")
    assert run(here, "reference", "ggx", samples=24) == ["ggx"]
    write_merl(here / "m.binary", 1.1 * material(0.3).table)
    assert run(here, "reference", "ggx", samples=24) == ["reference", "ggx"]


def test_a_picture_does_not_depend_on_what_is_rendered_beside_it(here):
    """Rendered later and alone, a picture is the one that comes of the shared pass, to rounding."""
    names = ("reference", "reference_again", "ggx")
    run(here, *names)
    together = [load_render(here / f"{name}-a.exr").batches for name in names]
    for name, expected in zip(names, together):
        (here / f"{name}-a.exr").unlink()
        run(here, name)
        np.testing.assert_allclose(load_render(here / f"{name}-a.exr").batches, expected, rtol=1e-4, atol=1e-5)


def test_materials_and_scenes_have_random_numbers_of_their_own():
    """So have the repetition and the small render that shares out lanes."""
    seeds = [
        jobs.picture_seed(seed, *names)
        for seed in (1, 2)
        for names in (("m", "a"), ("n", "a"), ("m", "b"), ("m", "a", "reference_again"), ("m", "a", "pilot"))
    ]
    assert len(set(seeds)) == len(seeds)
    assert all(0 <= seed < 2**32 for seed in seeds)


def test_the_noise_of_two_materials_is_not_correlated(here):
    scene, m = load_scene(here / "a.npz"), material(0.3)
    first, second = (
        jobs.render_models(scene, item, {"reference": None}, samples=64)["reference"]
        for item in (m, Measured("another", m.table))
    )
    a, b = ((r.batches - r.mean)[:, scene.mask, 1].ravel() for r in (first, second))
    assert abs(np.corrcoef(a, b)[0, 1]) < 5 / np.sqrt(a.size)


def test_a_new_exposure_changes_the_label_not_the_pixels(here):
    run(here)
    pixels = load_render(here / "reference-a.exr")
    scene = load_scene(here / "a.npz")
    scene.definition["exposure"] = 7.0
    scene.save(here / "a.npz")
    run(here)
    again = load_render(here / "reference-a.exr")
    assert again.meta["exposure"] == "7.0"
    assert again.meta["fingerprint"] == pixels.meta["fingerprint"]
    np.testing.assert_array_equal(again.mean, pixels.mean)
    np.testing.assert_array_equal(again.batches, pixels.batches)


def test_fits_share_the_random_numbers_of_their_reference(here):
    """A fit that is the reference has its very pixels; the repetition has others."""
    run(here, "reference", "reference_again", "ggx")
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
    run(here, "failed")
    render = load_render(here / "failed-a.exr")
    assert render.meta["status"] == "failed"
    assert not render.mean.any()
    assert render.mask.any()
    assert run(here, "failed") == []
    replace(fit("ggx", material(0.3)), entry="failed", material="m").save(here / "failed.npz")
    write_json(here / "failed.json", {"status": "ok"})
    assert run(here, "failed", "ggx") == ["failed", "ggx"]
    assert read_meta(here / "failed-a.exr")["status"] == "ok"


def test_a_scene_with_a_bad_file_is_not_prepared(here):
    scenes = {"mine": SCENES["a"] | {"environment": {"kind": "file", "file": "gone.hdr"}}}
    (here / "bad.yaml").write_text(yaml.safe_dump(scenes))
    definition = read_scenes(here / "bad.yaml")["mine"]
    with pytest.raises(SceneError, match=re.escape("bad.yaml: mine.environment.file: gone.hdr: no such file")):
        jobs.prepare_scene_job("mine", definition, 8, "llvm_ad_rgb", "bad.yaml", str(here / "mine.npz"))
    assert not (here / "mine.npz").exists()


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
        ({"variant": None}, "render.variant: None"),
    ):
        with pytest.raises(ValueError, match=message):
            jobs.render_file(here / "m.binary", **({"scene": "a", "scenes": scenes, "size": 8} | arguments))
    with pytest.raises(TypeError, match="3 is no path, Measured or Fit"):
        jobs.render_file(3, "a", scenes=scenes)
    with pytest.raises(MeasuredError, match=r"absent\.binary"):
        jobs.render_file(here / "absent.binary", "a", scenes=scenes)


def test_a_fit_beside_its_reference_has_the_picture_of_a_run(here):
    """The mask, the random numbers and the sampling are the reference's, of which half was not measured."""
    table = material(0.3).table.copy()
    table[:, 45:] = np.nan
    write_merl(here / "half.binary", table)
    measured, fitted = brdfatlas.read(here / "half.binary"), brdfatlas.load_fit(here / "ggx.npz")
    settings = {"samples": 16, "seed": 3}
    pictures = jobs.render_models(load_scene(here / "a.npz"), measured, {"ggx": fitted.table()}, **settings)
    for item, reference in ((fitted, measured), (here / "ggx.npz", here / "half.binary")):
        options = settings | {"size": 16, "scenes": here / "scenes.yaml"}
        beside = jobs.render_file(item, "a", reference=reference, **options)
        np.testing.assert_array_equal(beside.mean, pictures["ggx"].mean)
        assert beside.meta["model"] == "ggx"
        assert np.abs(beside.mean - jobs.render_file(item, "a", **options).mean).max() > 0
    output = here / "out.exr"
    command = ["render", str(here / "ggx.npz"), "--reference", str(here / "half.binary"), "-o", str(output)]
    command += ["--scenes", str(here / "scenes.yaml"), "--scene", "a", "--size", "16", "--spp", "16", "--seed", "3"]
    assert main(command) == 0
    np.testing.assert_array_equal(load_render(output).mean, pictures["ggx"].mean)


def test_the_papers_scenes_are_valid():
    """Their files are the user's; without them the check names the first that is missing, and its key."""
    path = Path(__file__).parents[2] / "config" / "scenes_papers.yaml"
    scenes = read_scenes(path)
    assert len(scenes) == 4
    if not Path(scenes["grace_sphere"]["environment"]["file"]).exists():
        variant()
        with pytest.raises(SceneError, match=r"grace_sphere\.environment\.file: .*grace_probe\.hdr: no such file"):
            jobs.prepare_scene("grace_sphere", scenes["grace_sphere"], 8, source=str(path))


THREADS = """
import sys
from concurrent.futures import ThreadPoolExecutor
from brdfatlas.rendering.jobs import render_file

with ThreadPoolExecutor(4) as pool:
    pictures = list(pool.map(lambda _: render_file(sys.argv[1], "studio_sphere", samples=8, size=16).mean, range(8)))
assert all((picture == pictures[0]).all() for picture in pictures)
"""


def test_threads_of_a_process_that_has_no_mitsuba_yet_render_alike(tmp_path):
    write_merl(tmp_path / "m.binary", material(0.3).table)
    done = subprocess.run([sys.executable, "-c", THREADS, tmp_path / "m.binary"], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")
