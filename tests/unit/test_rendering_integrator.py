"""The integrator: equal to Mitsuba's own within noise, independent batches, paired random numbers."""

import math
import subprocess
import sys
from copy import deepcopy
from pathlib import Path

import numpy as np
import pytest
import yaml
from rendering_materials import material, variant, z_limit

from brdfatlas.measured import Measured
from brdfatlas.rendering.jobs import render_scene, stock_batches
from brdfatlas.rendering.scenes import SceneError, mitsuba_scene, prepare_scene, read_scenes

SCENES = read_scenes(Path(__file__).parents[2] / "config" / "scenes.yaml")


@pytest.fixture(scope="module", params=list(SCENES))
def scene(request):
    variant()
    return prepare_scene(request.param, SCENES[request.param], 20, samples=2048)


def reflectance():
    from brdfatlas.rendering.bsdf import reflectance_of

    return reflectance_of(material(0.15))


def test_equal_to_stock_mitsuba(scene):
    """z-test of every pixel and channel against the stock ``direct`` integrator with the same plugin, as in Mitsuba's
    own render tests, with Šidák's threshold for all of them together; edges and background included."""
    import mitsuba as mi

    n = 24
    ours = render_scene(scene, material(0.15), samples=64 * n, batches=n, seed=3).batches.astype(float)
    stock = stock_batches(scene, reflectance(), 64 * n, n, 11).astype(float)
    black = mi.load_dict({"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.0}})
    loaded = mi.load_dict(mitsuba_scene(scene, black))
    back = np.stack([np.array(mi.render(loaded, spp=64, seed=500 + i)) for i in range(n)]).astype(float)
    variance = (ours.var(0, ddof=1) + stock.var(0, ddof=1)) / n + back.var(0, ddof=1) * (64 / 2048)
    z = (ours.mean(0) - stock.mean(0)) / np.sqrt(np.maximum(variance, 1e-12))
    # Student's t of about 2 n - 2 degrees of freedom, whose tails are a little heavier than a normal's.
    limit = 1.3 * z_limit(z.size)
    inside = scene.mask
    assert inside.sum() > 50
    assert abs(z[inside]).max() < limit
    assert abs(z).max() < limit
    assert abs(z[inside].mean()) < 4 / np.sqrt(inside.sum())  # channels share their samples: pixels count
    # The share of light: total energy within a fraction of a per cent, the sharpest test of a missing factor.
    assert ours[:, inside].mean() == pytest.approx(stock[:, inside].mean(), rel=0.01)


def test_less_noise_than_stock(scene):
    ours = render_scene(scene, material(0.15), samples=512, batches=8, seed=3).batches
    stock = stock_batches(scene, reflectance(), 512, 8, 5)
    assert ours.var(0)[scene.mask].mean() < stock.var(0)[scene.mask].mean()


@pytest.fixture(scope="module")
def sphere():
    variant()
    return prepare_scene("studio_sphere", SCENES["studio_sphere"], 32, samples=16)


def test_the_same_seed_gives_the_same_picture(sphere):
    first, second = (render_scene(sphere, material(0.15), samples=32, seed=5) for _ in range(2))
    np.testing.assert_array_equal(first.batches, second.batches)
    other = render_scene(sphere, material(0.15), samples=32, seed=6)
    assert (first.batches != other.batches)[:, sphere.mask].any(-1).mean() > 0.9


def test_a_table_equal_to_the_reference_gives_equal_pictures(sphere):
    reference = render_scene(sphere, material(0.15), samples=32)
    again = render_scene(sphere, material(0.15), material(0.15).table.copy(), samples=32)
    np.testing.assert_array_equal(reference.batches, again.batches)


def test_noise_cancels_in_differences(sphere):
    """Reference and fit share random numbers: a fit 1 % brighter differs by 1 % in every pixel of every batch."""
    m = material(0.15)
    reference = render_scene(sphere, m, samples=32)
    brighter = render_scene(sphere, m, 1.01 * m.table, samples=32)
    inside = sphere.mask
    np.testing.assert_allclose(brighter.batches[:, inside], 1.01 * reference.batches[:, inside], rtol=1e-4)


def test_a_fit_of_another_shape_is_sampled_as_its_reference(sphere):
    """Both have one density, so each sample takes the same directions: twice the reference in one half of its
    theta_h cells and the reference in the other differs by nothing, or by the sample itself, and never by more."""
    from brdfatlas.rendering.bsdf import reflectance_of

    m = material(0.15)
    other = m.table.copy()
    other[12:] *= 2  # the flanks of the lobe: a density of its own would be another one
    reference, fit = reflectance_of(m), reflectance_of(m, other)
    for name in ("cosine_weight", "entries", "cells", "runs"):
        np.testing.assert_array_equal(getattr(fit.density, name), getattr(reference.density, name))
    first = render_scene(sphere, m, samples=32).batches[:, sphere.mask]
    second = render_scene(sphere, m, other, samples=32).batches[:, sphere.mask]
    difference = second - first
    assert (difference >= -1e-5 * first).all()
    assert (difference <= first * (1 + 1e-5)).all()
    assert difference.mean() > 0.05 * first.mean(), "and there is a difference"


def test_sobol_points_are_those_of_scipy(sphere):
    from scipy.stats import qmc

    from brdfatlas.rendering.scenes import DIMENSIONS, N_POINTS, sobol_points

    expected = (qmc.Sobol(DIMENSIONS, scramble=False, bits=32).random(2 * N_POINTS) * 2.0**32).astype(np.uint64)
    for count in (1, 5, N_POINTS, N_POINTS + 1):
        np.testing.assert_array_equal(sobol_points(count), expected[:count])
        np.testing.assert_array_equal(sobol_points(count, expected[:N_POINTS]), expected[:count])
    np.testing.assert_array_equal(sphere.points, expected[:N_POINTS])


def test_more_lanes_where_the_noise_is():
    """Shared out by noise, half as many samples again take more noise from a small highlight than they cost."""
    from brdfatlas.rendering.bsdf import reflectance_of
    from brdfatlas.rendering.integrator import MORE_LANES, MOST_LANES, render_batches, set_up, share_lanes

    variant()
    setup = set_up(prepare_scene("studio_sphere", SCENES["studio_sphere"], 48, samples=16))
    reference = reflectance_of(material(0.03))
    lanes = share_lanes(setup, reference, 256, 2)
    np.testing.assert_array_equal(lanes, share_lanes(setup, reference, 256, 2), "the same for every fit")
    assert lanes.min() == 1
    assert 2 < lanes.max() <= MOST_LANES
    assert lanes.sum() == int(MORE_LANES * len(setup.pixels)), "one number for all materials: one kernel"
    inside = setup.scene.mask
    plain, shared = (render_batches(setup, reference, 256, 8, 1, n)[0][:, inside] for n in (None, lanes))
    assert shared.var(0, ddof=1).mean() * MORE_LANES < 0.7 * plain.var(0, ddof=1).mean()
    # Independent of the pictures, so without bias: the means agree within their noise.
    error = np.sqrt((plain.mean((1, 2)).var(ddof=1) + shared.mean((1, 2)).var(ddof=1)) / 8)
    assert abs(plain.mean() - shared.mean()) < 5 * error
    dark = reflectance_of(Measured("dark", 0 * material(0.03).table))
    assert set(share_lanes(setup, dark, 256, 1)) == {1, 2}


def test_batches_are_independent(sphere):
    """The variance of the mean of all batches is that of one batch divided by their number: correlated batches would
    make it larger. Estimated over pixels and 12 seeds."""
    inside = sphere.mask
    runs = np.stack([render_scene(sphere, material(0.3), samples=32, seed=s).batches[:, inside] for s in range(12)])
    single = runs.var(axis=1, ddof=1).mean(axis=(0, 1))
    mean = runs.mean(axis=1).var(axis=0, ddof=1).mean(axis=0)
    np.testing.assert_allclose(mean * 8 / single, 1, atol=0.25)
    flat = runs.mean(-1) - runs.mean(-1).mean(0).mean(0)
    first, second = flat[:, 0].ravel(), flat[:, 1].ravel()
    assert abs(np.corrcoef(first, second)[0, 1]) < 5 / np.sqrt(first.size)


def test_more_samples_less_noise(sphere):
    """At least as fast as independent samples: 16 times the samples, variance below 1/16 (low discrepancy: less)."""
    few, many = (render_scene(sphere, material(0.3), samples=n).batches[:, sphere.mask] for n in (32, 512))
    assert many.var(0, ddof=1).mean() < few.var(0, ddof=1).mean() / 16


def test_environment_look_up_and_density():
    """Radiance equals Mitsuba's ``envmap``; the density integrates to 1 and its samples follow it (chi-square)."""
    mi = variant()
    import drjit as dr
    from mitsuba.chi2 import ChiSquareTest, SphericalDomain

    from brdfatlas.rendering.integrator import Environment

    rng = np.random.default_rng(0)
    image = rng.lognormal(0, 2, (16, 32, 3)).astype(np.float32)
    ours, stock = Environment(image), mi.load_dict({"type": "envmap", "bitmap": mi.Bitmap(image)})
    d = rng.normal(size=(3, 20_000))
    d = (d / np.linalg.norm(d, axis=0)).astype(np.float32)
    si = dr.zeros(mi.SurfaceInteraction3f, 20_000)
    si.wi = -mi.Vector3f(d)
    radiance, _ = ours.eval_pdf(mi.Vector3f(d), True)
    np.testing.assert_allclose(np.array(radiance), np.array(stock.eval(si)), rtol=1e-4, atol=1e-4)

    def sample(numbers):
        bits = [mi.UInt32(number * 2.0**32) for number in numbers]
        direction, value, pdf = ours.sample(bits[0], bits[1], True)
        expected, density = ours.eval_pdf(direction, True)
        same = dr.abs(density - pdf) < 1e-3 * pdf
        assert dr.mean(dr.select(same, 1.0, 0.0))[0] > 0.999  # but for directions on the very edge of a cell
        assert dr.mean(dr.select(same & (dr.abs(value.x - expected.x) > 1e-2 * expected.x), 1.0, 0.0))[0] < 1e-3
        return direction

    test = ChiSquareTest(
        domain=SphericalDomain(),
        sample_func=sample,
        pdf_func=lambda direction: ours.eval_pdf(direction, True)[1],
        sample_dim=2,
        sample_count=400_000,
        res=31,
        ires=128,
    )
    assert test.run(quiet=True), f"p = {test.p_value}"


def test_the_kernel_is_found_again_by_later_processes(tmp_path):
    """A second process with another material in the same scene: nothing is compiled again."""
    program = f"""
import sys
sys.path.insert(0, {str(Path(__file__).parent)!r})
from rendering_materials import material
from brdfatlas.rendering import use_variant
use_variant()
import drjit as dr
from brdfatlas.rendering.jobs import render_scene
from brdfatlas.rendering.scenes import prepare_scene, read_scenes
name, alpha = sys.argv[1], float(sys.argv[2])
scene = prepare_scene(name, read_scenes({str(tmp_path / "scenes.yaml")!r})[name], 16, 4)
with dr.scoped_set_flag(dr.JitFlag.KernelHistory):
    render_scene(scene, material(alpha), samples=16)
    kernels = [k for k in dr.kernel_history() if k["type"] == dr.KernelType.JIT and k["size"] > 1]
print(sum(not (k["cache_hit"] or k["cache_disk"]) for k in kernels), len(kernels))
"""
    variant()
    ball, floor = {"shape": "sphere"}, {"shape": "floor", "surface": [0.5, 0.5, 0.5], "position": [0, -1, 0], "size": 9}
    camera = {"origin": [0, 1, 6]}
    scenes = {
        "studio": {"geometry": [ball], "environment": {"kind": "studio", "width": 64}, "camera": camera},
        "hall": {"geometry": [ball | {"size": 0.8}], "environment": {"kind": "hall", "width": 32}, "camera": camera},
        "floor": {"geometry": [ball, floor], "environment": {"kind": "overcast", "width": 32}, "camera": camera},
    }
    (tmp_path / "scenes.yaml").write_text(yaml.safe_dump(scenes))
    calls = [(name, alpha) for name in scenes for alpha in ("0.3", "0.1")]
    compiled = []
    for name, alpha in calls:
        done = subprocess.run([sys.executable, "-c", program, name, alpha], capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        missing, count = map(int, done.stdout.split()[-2:])
        assert count > 0
        compiled.append(missing)
    assert compiled[1::2] == [0, 0, 0]


def test_scalar_variant_renders_the_same_picture():
    """The scalar variant goes through stock Mitsuba: slow, and within noise the same."""
    variant("scalar_rgb")
    scene = prepare_scene("studio_sphere", SCENES["studio_sphere"], 4, samples=4)
    scalar = render_scene(scene, material(0.3), samples=64, batches=4, seed=1).batches
    variant()
    scene = prepare_scene("studio_sphere", SCENES["studio_sphere"], 4, samples=4)
    ours = render_scene(scene, material(0.3), samples=1024, batches=4, seed=1).batches
    inside = scene.mask
    spread = np.sqrt(scalar[:, inside].var(0, ddof=1) / 4 + ours[:, inside].var(0, ddof=1) / 4)
    assert (abs(scalar.mean(0) - ours.mean(0))[inside] < 12 * spread).all()  # 6 degrees of freedom: heavy tails
    assert scalar[:, inside].mean() == pytest.approx(ours[:, inside].mean(), rel=0.15)


def test_scalar_variant_takes_every_seed_and_tells_batches_apart():
    """The second reference has a seed beyond a million, Mitsuba's are 32 bits."""
    variant("scalar_rgb")
    scene = prepare_scene("studio_sphere", SCENES["studio_sphere"], 4, samples=4)
    once, again = (
        render_scene(scene, material(0.3), samples=4, batches=2, seed=seed).batches for seed in (1, 1_000_004)
    )
    variant()
    pictures = [batch[scene.mask] for batch in (*once, *again)]
    assert all((a != b).any() for i, a in enumerate(pictures) for b in pictures[:i])


def alike(*definitions):
    """Renders of two scenes, whose pictures are the same but for noise at their edges."""
    one, other = (
        render_scene(prepare_scene("s", definition, 16, samples=16), material(0.3), samples=64, batches=2, seed=1)
        for definition in definitions
    )
    both = one.mask & other.mask
    assert both.sum() > 0.9 * one.mask.sum() > 0
    assert other.mean[both].mean() == pytest.approx(one.mean[both].mean(), rel=0.005)
    return one, other


@pytest.mark.parametrize("unit", [2.0**-20, 1e-5, 1e-3, 1e3, 1e6])
def test_the_unit_of_length_is_free(unit):
    """A scene in another unit of length has the same picture: to the last bit for a power of two, else within the
    rounding of Mitsuba's float32 positions."""
    variant()
    definition = deepcopy(SCENES["overcast_statue"])
    definition["camera"] = {
        key: [unit * x for x in v] if isinstance(v, list) else v for key, v in definition["camera"].items()
    }
    for shape in definition["geometry"]:
        shape["size"] = unit * shape["size"]
        shape["position"] = [unit * x for x in shape["position"]]
    small, large = alike(SCENES["overcast_statue"], definition)
    if math.frexp(unit)[0] == 0.5:
        assert np.array_equal(large.batches, small.batches)


@pytest.mark.parametrize("far", [1e2, 1e4])
def test_a_scene_may_lie_far_from_the_origin_of_its_coordinates(far):
    """The same picture within noise and the rounding of Mitsuba's float32 positions, with the camera."""
    variant()
    definition = deepcopy(SCENES["studio_sphere"])
    camera = definition["camera"]
    for holder, key in [(camera, "origin"), (camera, "target"), *((s, "position") for s in definition["geometry"])]:
        holder[key] = [x + far for x in holder[key]]
    alike(SCENES["studio_sphere"], definition)


def test_impossible_settings_are_refused(sphere):
    for settings, word in (({"samples": 0}, "samples"), ({"samples": 8, "batches": 0}, "batches")):
        with pytest.raises(SceneError, match=f"render.{word}"):
            render_scene(sphere, material(0.15), **settings)


def test_all_models_in_one_pass_are_those_of_passes_of_their_own(scene):
    """Tables on half and on the full circle, in groups of every size, to rounding; and the rest of a group is zeros."""
    from brdfatlas.rendering.bsdf import GROUP_SIZES, reflectance_of
    from brdfatlas.rendering.integrator import render_batches, set_up, share_lanes

    m = material(0.15)
    other = 0.5 * m.table
    other[:, :, ::2] *= 1.5
    tables = [m.table, other, np.concatenate([m.table, other], 2)]
    setup, reference = set_up(scene), reflectance_of(m)
    lanes = share_lanes(setup, reference, 32, 9)
    alone = [render_batches(setup, reference.with_tables(t), 32, 4, 1, lanes)[0] for t in tables]
    for size in GROUP_SIZES[1:3]:
        chosen = [n % len(tables) for n in range(size - 1)]
        found = render_batches(setup, reference.with_tables([tables[n] for n in chosen]), 32, 4, 1, lanes)
        assert len(found) == size - 1
        for n, picture in zip(chosen, found):
            np.testing.assert_allclose(picture, alone[n], rtol=1e-4, atol=1e-5)
    assert np.abs(alone[2] - alone[0]).max() > 1e-2, "the second half of the circle is seen"


def test_more_models_than_a_group_holds(sphere):
    from brdfatlas.rendering.bsdf import GROUP_SIZES
    from brdfatlas.rendering.jobs import render_models

    m = material(0.3)
    tables = {f"m{n}": m.table * (1 + n) for n in range(GROUP_SIZES[-1] + 2)}
    found = render_models(sphere, m, {"reference": None} | tables, samples=8)
    assert list(found) == ["reference", *tables]
    for n, name in enumerate(tables):
        inside = found[name].mean[sphere.mask]
        np.testing.assert_allclose(inside, found["reference"].mean[sphere.mask] * (1 + n), rtol=1e-4, atol=1e-5)


def test_parts_that_there_is_room_for_are_the_whole(sphere, monkeypatch):
    """Large pictures are rendered some tables and some batches at a time."""
    from brdfatlas.rendering import integrator, jobs

    m = material(0.3)
    tables = {"reference": None, "a": 2 * m.table, "b": 3 * m.table}
    whole = jobs.render_models(sphere, m, tables, samples=8, batches=4)
    monkeypatch.setattr(integrator, "MOST_COLOURS", 1)
    monkeypatch.setattr(jobs, "MOST_GROUP_BYTES", 1)
    for name, render in jobs.render_models(sphere, m, tables, samples=8, batches=4).items():
        np.testing.assert_allclose(render.batches, whole[name].batches, rtol=1e-4, atol=1e-5)
