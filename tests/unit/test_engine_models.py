from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from test_sampling import chi_square, outgoing

import brdfatlas
from brdfatlas.angles import above_horizon, directions, grid_axes
from brdfatlas.measured import Measured
from brdfatlas.measures.physics import directional_albedo, reciprocity_error
from brdfatlas.models import MODELS
from brdfatlas.models.engine.base import Grid, Problem, Space
from brdfatlas.models.engine.principled import MIN_ALPHA

NAMES = ("lambert", "ggx_diffuse", "ggx2_diffuse", "gltf", "principled", "openpbr")
ORACLE = Path(__file__).parents[1] / "data" / "openpbr.csv"


def drawn(name, seed=0, low=0.0, high=1.0):
    """Random parameters between two places of their ranges; openpbr without a coat."""
    rng = np.random.default_rng(seed)
    model = MODELS[name]
    parameters = {p.name: p.low + rng.uniform(low, high, p.shape) * (p.high - p.low) for p in model.parameters}
    for held, value in model.fixed({"coat": False}).items():
        parameters[held] = np.array([value])
    return parameters


def hemisphere(rng, count):
    v = rng.normal(size=(count, 3))
    v[:, 2] = np.abs(v[:, 2]) + 1e-3
    return v / np.linalg.norm(v, axis=1, keepdims=True)


def pairs(seed, count):
    """Half of them near the mirror direction, where lobes are."""
    rng = np.random.default_rng(seed)
    wi, wo = hemisphere(rng, count), hemisphere(rng, count)
    wo[::2] = wi[::2] * [-1, -1, 1] + 0.05 * rng.normal(size=wi[::2].shape)
    wo[:, 2] = np.abs(wo[:, 2]) + 1e-3
    return wi, wo / np.linalg.norm(wo, axis=1, keepdims=True)


def synthetic(name, parameters):
    table = MODELS[name].evaluate_grid(parameters)
    table[~above_horizon()] = np.nan
    return Measured(f"made by {name}", table)


@pytest.mark.parametrize("name", NAMES)
def test_reciprocal_finite_and_never_negative(name):
    for seed in range(20):
        parameters = drawn(name, seed)

        def evaluate(wi, wo, parameters=parameters):
            return MODELS[name].evaluate(parameters, wi, wo)

        assert reciprocity_error(evaluate) < 1e-9
        values = evaluate(*pairs(seed, 2000))
        assert np.isfinite(values).all()
        assert values.min() >= 0


@pytest.mark.parametrize("name", NAMES)
def test_the_grid_holds_the_values_at_its_centres(name):
    parameters = drawn(name, 3, 0.2, 0.8)
    table = MODELS[name].evaluate_grid(parameters)
    theta_h, theta_d, phi_d = grid_axes()
    for row in (0, 20, 70):
        wi, wo = directions(theta_h[row], theta_d[0], phi_d[0])
        keep = above_horizon()[row]
        values = MODELS[name].evaluate(parameters, wi[keep], wo[keep])
        np.testing.assert_allclose(table[row][keep], values, rtol=2e-6)


@pytest.mark.parametrize(
    ("name", "degrees"),
    [
        ("lambert", [0, 30, 60, 80]),
        # fresnel_mix takes the diffuse light's share from the half vector, so at grazing incidence the specification
        # itself makes light: 1.3 times a white, smooth dielectric's at 80 degrees
        ("gltf", [0, 30]),
        # the light below the first of 32 cosines is interpolated
        ("openpbr", [0, 30, 60]),
    ],
)
def test_white_surfaces_do_not_shine(name, degrees):
    for seed in range(12):
        parameters = drawn(name, seed)
        for colour in {"kd", "base_color", "specular_color"} & parameters.keys():
            parameters[colour] = np.ones(3)
        albedo = directional_albedo(lambda wi, wo, p=parameters: MODELS[name].evaluate(p, wi, wo), np.deg2rad(degrees))
        assert albedo.max() <= 1.001


def test_the_lobe_of_ggx_keeps_a_white_furnace_dark_enough():
    """A white mirror of facets loses what it scatters twice, never gains: F0 = 1 without a diffuse term."""
    for alpha in (0.01, 0.1, 0.5, 1.0):
        parameters = {"kd": np.zeros(3), "F0": np.ones(3), "alpha": np.array([alpha])}
        albedo = directional_albedo(
            lambda wi, wo, p=parameters: MODELS["ggx_diffuse"].evaluate(p, wi, wo), np.deg2rad([0, 40, 75])
        )
        assert albedo.max() <= 1 + 2e-3
        assert albedo[0, 0] > (0.98 if alpha <= 0.1 else 0.3)


@pytest.mark.parametrize("objective", ["compressive", "e2", "cosine"])
@pytest.mark.parametrize("name", NAMES)
def test_derivatives_are_those_of_the_objective(name, objective):
    """Against central differences, whose own error is near 1e-9 / 1e-6 of the value."""
    model = MODELS[name]
    space = Space(model, model.fixed({"coat": True}))
    problem = Problem(space, Grid(synthetic(name, drawn(name, 5, 0.2, 0.8)).table, objective).merged(6, 3).samples)
    lower, upper = space.bounds()
    x = lower + np.random.default_rng(1).uniform(0.3, 0.7, space.size) * (upper - lower)
    value, gradient, matrix = problem.normal_equations(x)
    assert value == pytest.approx(problem.value(x))
    np.testing.assert_allclose(matrix, matrix.T)
    for j in range(space.size):
        step = np.zeros(space.size)
        step[j] = 1e-5 * (upper - lower)[j]
        difference = (problem.value(x + step) - problem.value(x - step)) / (2 * step[j])
        assert 2 * gradient[j] == pytest.approx(difference, rel=1e-4, abs=1e-6 * value)


@pytest.mark.parametrize("name", NAMES)
def test_a_fit_finds_what_made_the_material(name):
    """The objective of a material inside the model's reach is near zero; where the parameters are told apart by the
    values, they come back."""
    parameters = drawn(name, 11, 0.3, 0.7)
    fitted = brdfatlas.fit(name, synthetic(name, parameters))
    assert fitted.report["objective"] < 1e-4
    if name in ("lambert", "ggx_diffuse", "gltf"):
        for key, value in parameters.items():
            np.testing.assert_allclose(fitted.parameters[key], value, atol=0.01)


@pytest.mark.parametrize("name", NAMES)
def test_fits_are_deterministic_and_inside_their_ranges(name):
    material = synthetic("ggx2_diffuse", drawn("ggx2_diffuse", 2, 0.2, 0.6))
    first, second = (brdfatlas.fit(name, material, seed=4, starts=8) for _ in range(2))
    assert first == second
    for p in MODELS[name].parameters:
        assert (first.parameters[p.name] >= np.float32(p.low)).all()
        assert (first.parameters[p.name] <= np.float32(p.high)).all()


@pytest.mark.parametrize("objective", ["compressive", "e2", "cosine"])
def test_two_lobes_are_never_worse_than_one(objective):
    for seed in range(2):
        material = synthetic("principled", drawn("principled", seed, 0.1, 0.6))
        one, two = (brdfatlas.fit(n, material, objective=objective, starts=16) for n in ("ggx_diffuse", "ggx2_diffuse"))
        assert two.report["objective"] <= one.report["objective"] * (1 + 1e-6)


@pytest.mark.parametrize("name", ["gltf", "principled", "openpbr"])
def test_a_dark_channel_does_not_take_the_colour_away(name):
    """A saturated blue, as measured paints have: with the published weight of each channel apart, glTF gives up the
    base colour to spare red and green the highlight that all channels share (met on a real acrylic paint)."""
    paint = synthetic("lambert", {"kd": np.array([0.0015, 0.0016, 0.12])})
    fitted = brdfatlas.fit(name, paint)
    wi, wo = [0.5, 0.0, np.sqrt(0.75)], [0.0, 0.5, np.sqrt(0.75)]
    blue = fitted.evaluate(np.array([wi]), np.array([wo]))[0, 2] * np.pi
    assert blue == pytest.approx(0.12, rel=0.3)


def test_more_starts_are_never_worse():
    material = synthetic("principled", drawn("principled", 7, 0.1, 0.9))
    few, many = (brdfatlas.fit("gltf", material, starts=n).report["objective"] for n in (1, 96))
    assert many <= few * (1 + 1e-3)


def test_a_fit_at_a_bound_says_so():
    parameters = {"base_color": np.zeros(3), "metallic": np.ones(1), "roughness": np.array([0.4])}
    fitted = brdfatlas.fit("gltf", synthetic("gltf", parameters))
    assert "degenerate: a black base with metallic 1" in fitted.report["message"]
    assert any(bound.startswith("base_color") for bound in fitted.report["details"]["bounds"])
    inside = {"base_color": np.full(3, 0.5), "metallic": np.full(1, 0.5), "roughness": np.array([0.4])}
    assert "bound" not in brdfatlas.fit("gltf", synthetic("gltf", inside)).report["message"]


@pytest.mark.parametrize("name", NAMES)
def test_odd_materials_have_finite_fits(name):
    dark = np.zeros((90, 90, 180, 3), np.float32)
    bright = np.full_like(dark, 0.1)
    bright[10, 10, 10] = 1e4
    for table in (dark, bright):
        table[~above_horizon()] = np.nan
        fitted = brdfatlas.fit(name, Measured("odd", table), starts=8)
        assert all(np.isfinite(value).all() for value in fitted.parameters.values())
    with pytest.raises(brdfatlas.models.base.FitError):
        brdfatlas.fit(name, Measured("empty", np.full_like(dark, np.nan)))


@pytest.mark.parametrize("degrees", [0, 40, 70])
@pytest.mark.parametrize("name", NAMES)
def test_samples_follow_the_pdf(name, degrees):
    parameters = drawn(name, 1, 0.3, 0.7)
    if name == "principled":  # its clearcoat is sharper than the bins of the test
        parameters["clearcoat"] = np.zeros(1)
    p_value, _, _ = chi_square(MODELS[name].sampler(parameters), outgoing(degrees))
    assert p_value > 1e-4


@pytest.mark.parametrize("name", ["ggx_diffuse", "ggx2_diffuse", "gltf", "principled", "openpbr"])
def test_functions_are_those_of_the_model(name):
    """D, normalised; G1 of 1 at the normal, 0 at 90 degrees; F between 0 and 1."""
    functions = {f.symbol: f for f in MODELS[name].functions(drawn(name, 1, 0.3, 0.7))}
    assert "F" in functions
    for symbol, function in functions.items():
        if symbol.startswith("G1"):
            assert function.values[0] == pytest.approx(1)
            assert function.values[-1] == pytest.approx(0, abs=1e-9)
            assert (np.diff(function.values) <= 1e-12).all()
        elif symbol.startswith("D"):
            width = 2 * np.sqrt(function.angle) * np.sqrt(np.pi / 2) / 90
            total = (2 * np.pi * np.sin(function.angle) * np.cos(function.angle) * function.values * width).sum()
            assert total == pytest.approx(1, abs=2e-3)
        else:
            assert ((function.values >= 0) & (function.values <= 1 + 1e-12)).all()


def test_principled_is_mitsubas_plugin():
    """At 10,000 parameter sets with a pair each: textures hold all parameters but the one that the plugin does not take
    from a texture. The plugin computes in float32: where its lobes are steep, its cosine of the half vector may be off
    by some roundings, and it is allowed what that changes."""
    from brdfatlas.rendering import use_variant

    mi = use_variant("llvm_ad_rgb")
    model, count = MODELS["principled"], 100
    uv = (np.arange(count) + 0.5) / count
    for seed in range(100):
        sets = [drawn("principled", count * seed + n) for n in range(count)]
        for one in sets:
            one["specular"] = sets[0]["specular"]
        plugin = {"type": "principled", "specular": float(sets[0]["specular"][0])}
        for p in model.parameters:
            if p.name == "specular":
                continue
            values = np.float32([one[p.name] for one in sets])[None]
            bitmap = mi.Bitmap(values, mi.Bitmap.PixelFormat.RGB if p.count == 3 else mi.Bitmap.PixelFormat.Y)
            plugin[p.name] = {"type": "bitmap", "bitmap": bitmap, "raw": True, "filter_type": "nearest"}
        wi, wo = (v.astype(np.float32) for v in pairs(seed, count))
        si = mi.SurfaceInteraction3f()
        si.wi, si.uv = mi.Vector3f(*wi.T), mi.Point2f(uv, 0.5)
        theirs = np.array(mi.load_dict(plugin).eval(mi.BSDFContext(), si, mi.Vector3f(*wo.T))).T
        for n, one in enumerate(sets):
            pair = wi[n : n + 1], wo[n : n + 1]
            ours = model.evaluate(one, *pair) * pair[1][:, 2:].astype(float)
            error = np.abs(ours - theirs[n]) / np.maximum(np.abs(theirs[n]), 1e-2)
            assert (error < 1e-4 + steepness(one, *pair)).all()


def steepness(parameters, wi, wo):
    """What the roundings of float32 change, relatively: D of both lobes where cos theta_h moves, and the shadowing of
    directions at the horizon, whose length is 1 to a rounding only."""
    h = wi.astype(float) + wo
    sin2 = (h[:, 0] ** 2 + h[:, 1] ** 2) / (h**2).sum(1)
    sharp = 0.1 - 0.099 * parameters["clearcoat_gloss"][0]
    alpha = max(MIN_ALPHA, parameters["roughness"][0] ** 2)
    moved = 8 * np.finfo(np.float32).eps  # of the square, after its own few roundings
    grazing = 1 / wi[:, 2].astype(float) ** 2 + 1 / wo[:, 2].astype(float) ** 2
    return (moved * (1 / (sharp**2 + sin2) + 2 / (alpha**2 + sin2) + grazing))[:, None]


def oracle(material):
    rows = pd.read_csv(ORACLE)
    rows = rows[rows["material"] == material]
    first = rows.iloc[0]
    parameters = {
        p.name: np.array([first[f"{p.name}_{c}"] for c in "rgb"] if p.count == 3 else [first[p.name]], float)
        for p in MODELS["openpbr"].parameters
    }
    wi, wo, value = (
        rows[[f"{k}_{c}" for c in axes]].to_numpy() for k, axes in zip(("wi", "wo", "f_cos"), ("xyz", "xyz", "rgb"))
    )
    return parameters, wi, wo, value


@pytest.mark.parametrize(
    ("material", "most"),
    [
        ("matte", 0.05),
        ("rough_diffuse", 0.05),
        ("plastic_smooth", 0.05),
        ("plastic_rough", 0.05),
        ("metal_gold", 0.05),
        ("metal_rough_tint", 0.05),
        ("metal_smooth", 0.05),
        ("coated", 0.1),
    ],
)
def test_openpbr_agrees_with_the_reference_implementation(material, most):
    """Median relative difference <= 1 %, 95 % of the pairs within ``most``; fuzz is not part of our model."""
    parameters, wi, wo, value = oracle(material)
    ours = MODELS["openpbr"].evaluate(parameters, wi, wo) * wi[:, 2:]
    error = np.abs(ours - value) / value
    assert np.median(error) <= 0.01
    assert np.percentile(error, 95) <= most


def test_a_coat_is_fitted_where_asked_for_and_reported_as_not_reciprocal():
    parameters = drawn("openpbr", 4, 0.3, 0.6) | {
        "coat_weight": np.ones(1),
        "coat_roughness": np.array([0.15]),
        "coat_ior": np.array([1.6]),
    }
    material = synthetic("openpbr", parameters)
    bare, coated = (brdfatlas.fit("openpbr", material, coat=coat, starts=24) for coat in (False, True))
    assert bare.parameters["coat_weight"][0] == 0
    assert coated.report["objective"] < bare.report["objective"]
    assert "not reciprocal" in coated.report["message"]
    assert "not reciprocal" not in bare.report["message"]


@pytest.mark.parametrize("name", NAMES)
def test_an_unknown_objective_is_one_line(name):
    with pytest.raises(ValueError, match=f"model {name}: objective = 'l1' is not one of compressive, e2, cosine"):
        MODELS[name].check_options({"objective": "l1"})
