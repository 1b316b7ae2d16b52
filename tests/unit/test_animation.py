"""Animations: the light turns, the pictures are those of the renderer, the file has its frames."""

import numpy as np
import pytest
from PIL import Image

from brdfatlas.figures.convergence import convergence_frames
from brdfatlas.fits import Fit
from brdfatlas.measured import Measured
from brdfatlas.models import MODELS
from brdfatlas.rendering import use_variant
from brdfatlas.rendering.jobs import render_models, render_turning
from brdfatlas.rendering.scenes import PreparedScene, prepare_scene, read_scenes, turn_light
from brdfatlas.reports.animation import LABEL, animated_models, turning_frames, write_animation
from brdfatlas.reports.data import Material

SIZE = 16


@pytest.fixture(scope="module")
def scene() -> PreparedScene:
    use_variant()
    definition = read_scenes("config/scenes.yaml")["studio_sphere"]
    definition["environment"] |= {"width": 64}
    return prepare_scene("studio", definition, SIZE)


@pytest.fixture(scope="module")
def tables() -> dict:
    parameters = {"kd": np.array([0.7, 0.4, 0.2], np.float32)}
    return {"reference": None, "lambert": Fit("lambert", "made", parameters).table()}


@pytest.fixture(scope="module")
def measured() -> Measured:
    parameters = {"alpha": np.array([0.3], np.float32), "fresnel": np.full((90, 3), 0.6, np.float32)}
    return Measured("made", Fit("ggx", "made", parameters).table())


def test_light_keeps_its_power_and_comes_round(scene):
    quarter = turn_light(scene, 90)
    assert np.allclose(quarter.environment.sum(1), scene.environment.sum(1), rtol=1e-5)
    assert np.array_equal(quarter.environment, np.roll(scene.environment, -scene.environment.shape[1] // 4, 1))
    back = turn_light(scene, 360)
    assert np.array_equal(back.environment, scene.environment)
    seen = scene.coverage == 0
    assert np.abs(quarter.background - scene.background)[seen].max() > 0.01, "the background turns with it"


def test_each_picture_is_a_render_of_the_turned_scene(scene, measured, tables):
    """Within the noise: the mean over the material differs by less than 2 %, at every turn."""
    turns = [0.0, 120.0]
    for degrees, found in zip(turns, render_turning(scene, measured, tables, turns, samples=64), strict=True):
        expected = render_models(turn_light(scene, degrees), measured, tables, samples=64)
        assert list(found) == ["reference", "lambert"]
        for name, image in found.items():
            assert image[scene.mask].mean() == pytest.approx(expected[name].mean[scene.mask].mean(), rel=0.02)


def test_frames_are_written_with_their_names(scene, measured, tables, tmp_path):
    frames = list(turning_frames(scene, measured, tables, 3, samples=8, batches=4, seed=1))
    assert [frame.shape for frame in frames] == [(SIZE, 2 * SIZE, 3)] * 3
    assert all(np.abs(frame.astype(int) - frames[0]).max() > 10 for frame in frames[1:]), "the light moves"
    write_animation(tmp_path / "a.webp", frames, ["reference", "Lambert"])
    with Image.open(tmp_path / "a.webp") as image:
        assert (image.n_frames, image.size) == (3, (2 * SIZE, SIZE + LABEL))
        assert image.info["loop"] == 0, "it never ends"


def made_material(tmp_path, values) -> Material:
    """A material with a dE00 for each model; a model of None failed."""
    import pandas as pd

    sizes = {"lambert": 12, "ggx_diffuse": 28, "independent_g": 3288}
    rows = [
        {
            "material": "made",
            "model": name,
            "scene": "x",
            "status": "ok" if value else "failed",
            "de00_mean": value or float("nan"),
            "psnr_db": 40 - value if value else float("nan"),
        }
        for name, value in values.items()
    ]
    fits = {
        name: {"status": "ok" if value else "failed", "bytes": sizes[name], "seconds": 1.0}
        for name, value in values.items()
    }
    return Material({"name": "made", "class": "glossy"}, fits, pd.DataFrame(rows))


@pytest.mark.parametrize(
    ("values", "chosen", "shown"),
    [
        ((3.0, 2.0, 1.0), "", ["independent_g", "ggx_diffuse"]),
        ((3.0, 2.0, 1.0), "lambert", ["independent_g", "lambert"]),
        ((3.0, 2.0, 1.0), "independent_g", ["independent_g", "ggx_diffuse"]),
        ((3.0, 1.0, 2.0), "", ["ggx_diffuse", "independent_g"]),
        ((3.0, None, 1.0), "ggx_diffuse", ["independent_g", "lambert"]),
        ((None, None, 1.0), "", ["independent_g"]),
    ],
)
def test_the_recommended_model_and_another(tmp_path, values, chosen, shown):
    """The second is the chosen one, the recommended small one, or the next; never a failed one, never one twice."""
    names = ["lambert", "ggx_diffuse", "independent_g"]
    material = made_material(tmp_path, dict(zip(names, values, strict=True)))
    assert animated_models(material, names, chosen) == shown


def test_starts_of_the_independent_factors_never_rise_and_end_as_the_fit(measured):
    """Every picture is of a state of the descent; the best end is the fit's."""
    model = MODELS["independent_g"]
    runs = model.convergence(measured, channel=2)
    assert len(runs) == 8
    for run in runs:
        objectives = [state.objective for state in run.trace.states]
        assert objectives == run.trace.history
        assert (np.diff(objectives) <= 0).all()
    best = min(run.state.objective / run.problem.power for run in runs)
    channels = model.fit(measured).details["channels"]
    assert best == pytest.approx(channels[2]["objective"], rel=1e-12)
    frames = list(convergence_frames(runs, still=2))
    assert len(frames) == max(len(run.trace.states) for run in runs) + 1
    assert not np.array_equal(frames[0], frames[-1])
    assert np.array_equal(frames[-2], frames[-1])
