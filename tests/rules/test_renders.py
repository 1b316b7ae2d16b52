"""Rules prepare_scene, render_material, each alone."""

import numpy as np

from brdfatlas import read_merl
from brdfatlas.rendering.images import load_render
from brdfatlas.rendering.scenes import load_scene


def test_prepare_scene(run_rule):
    """The camera of the built-in sphere: its outline is where a sphere of that size must be."""
    scene = load_scene(run_rule("prepare_scene", "results/scenes/studio_sphere.npz"))
    camera = scene.definition["camera"]
    distance = np.linalg.norm(camera["origin"])
    silhouette = np.tan(np.arcsin(1 / distance)) / np.tan(np.radians(camera["fov"] / 2)) * scene.size / 2
    area = np.pi * silhouette**2
    assert abs(scene.coverage.sum() / area - 1) < 0.04  # coverage weighs pixels' corners fully
    assert scene.background[scene.mask].max() == 0
    assert scene.background[0].min() > 0


def test_render_material(run_rule, finished_run):
    """The job's picture is the function's, sample for sample."""
    from brdfatlas.rendering import use_variant
    from brdfatlas.rendering.jobs import render_scene

    render = load_render(run_rule("render_material", "results/renders/chrome/reference/studio_sphere.exr"))
    use_variant()
    scene = load_scene(finished_run.root / "results/scenes/studio_sphere.npz")
    measured = read_merl(finished_run.root / "results/standins/chrome.binary", standin=True)
    expected = render_scene(scene, measured, samples=8, batches=4, seed=1)
    np.testing.assert_allclose(render.mean, expected.mean, rtol=1e-5, atol=1e-7)
    np.testing.assert_array_equal(render.mask, scene.mask)
    assert render.meta["status"] == "ok"
    assert (render.meta["material"], render.meta["model"], render.meta["standin"]) == ("chrome", "reference", "true")
