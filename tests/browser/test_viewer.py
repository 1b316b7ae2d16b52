"""The viewer against an offline integral of the same scene: same fits, same environment, same camera."""

import itertools
import json

import numpy as np
import pytest
from axe_playwright_python.sync_playwright import Axe

from brdfatlas.angles import above_horizon, theta_d_centres, theta_h_centres
from brdfatlas.figures.tables import decode_table, encode_table, small_table, table_file, write_table
from brdfatlas.files import write_npz, write_text
from brdfatlas.fits import Fit, load_fit
from brdfatlas.measured import extend
from brdfatlas.models import MODELS
from brdfatlas.reports.data import SceneFacts
from brdfatlas.reports.pages import as_script, write_assets
from brdfatlas.reports.viewer import shrink_environment, write_viewer

SIZE, FIELD, DISTANCE = 16, np.deg2rad(21), 6.0
RENDERED = 48


def factors(width: float, rho_s) -> dict[str, np.ndarray]:
    """A glossy lobe with Schlick's Fresnel and a shadowing that falls to 0 at the horizon."""
    d = np.exp(-((np.tan(theta_h_centres()) / width) ** 2)) + 1e-4
    f = 0.3 + 0.7 * (1 - np.cos(theta_d_centres())) ** 5
    g = np.cos(np.linspace(0, np.pi / 2, 90)) ** 0.6
    rgb = np.ones((3, 1))
    return {
        "rho_d": np.array([0.06, 0.03, 0.01], np.float32),
        "rho_s": np.asarray(rho_s, np.float32),
        "d": (rgb * d / d.max()).astype(np.float32),
        "f": (rgb * f / f.max()).astype(np.float32),
        "g": (rgb * g).astype(np.float32),
    }


def naive(width: float) -> dict[str, np.ndarray]:
    made = factors(width, [0.8, 0.9, 1.0])
    del made["g"]
    h = 0.7 + 0.3 * np.cos(2 * np.linspace(0, np.pi, 180, endpoint=False))
    return made | {"h": (np.ones((3, 1)) * h).astype(np.float32)}


def write_recommended(reports, materials: list[str], models: list[str], chosen: list[int]) -> None:
    """What the viewer reads of the index: the places of the models recommended for the materials, -1 for none."""
    run = {"materials": [{"name": name} for name in materials], "models": [{"name": name} for name in models]}
    run |= {"budgets": [{"key": "64"}, {"key": "any"}], "recommended": [[[-1, k] for k in chosen]]}
    write_text(reports / "data/atlas.js", as_script("ATLAS", run))


@pytest.fixture(scope="module")
def viewer(tmp_path_factory):
    root = tmp_path_factory.mktemp("viewer")
    rng = np.random.default_rng(3)
    environment = rng.uniform(0.05, 0.6, (33, 64, 3)).astype(np.float32)
    environment[6:9, 20:24] = [30, 25, 18]
    environment[14:16, 50:54] = [4, 8, 16]
    write_npz(root / "scene.npz", {"environment": environment})
    fits = []
    for material, model, parameters in (
        ("metal", "independent_g", factors(0.25, [1.2, 0.9, 0.5])),
        ("metal", "naive", naive(0.4)),
        ("paint", "independent_g", factors(0.6, [0.3, 0.3, 0.35])),
    ):
        path = root / f"{material}-{model}.npz"
        Fit(model, material, parameters, standin=True).save(path)
        path.with_suffix(".json").write_text(json.dumps({"status": "ok"}))
        fits.append((material, model, path))
    failed = root / "paint-naive.npz"
    failed.write_bytes(b"")
    failed.with_suffix(".json").write_text(json.dumps({"status": "failed", "reason": "FitError: <b>black</b>"}))
    described, reports = {}, root / "reports"
    for name in ("metal", "paint"):
        described[name] = root / f"{name}.json"
        described[name].write_text(json.dumps({"name": name, "title": name, "standin": True}))
    # The reference and a parametric model have tables; the Lambertian one is exact in any table.
    parameters = {"alpha": np.array([0.4], np.float32), "fresnel": np.full((90, 3), [0.9, 0.6, 0.3], np.float32)}
    gloss = Fit("ggx", "metal", parameters, standin=True)
    flat = Fit("lambert", "metal", {"kd": np.array([0.6, 0.3, 0.1], np.float32)}, standin=True)
    for model, fit in (("reference", gloss), ("ggx", gloss), ("lambert", flat)):
        write_table(
            table_file(reports / "materials/metal", model), f"metal/{model}", extend(fit.table(), above_horizon())
        )
        if model != "reference":
            fits.append(("metal", model, root / f"metal-{model}.npz"))
            fit.save(fits[-1][-1])
            fits[-1][-1].with_suffix(".json").write_text(json.dumps({"status": "ok"}))
    write_assets(reports / "assets")
    counts = write_viewer(
        reports / "viewer.html",
        data=reports / "data",
        fits=[*fits, ("paint", "naive", failed)],
        materials=described,
        scenes=[(SceneFacts("room"), root / "scene.npz")],
    )
    assert counts == {"factors": 3, "tables": 2, "failed": 1}
    write_recommended(reports, ["metal", "paint"], ["independent_g", "naive", "ggx"], [2, -1])
    return reports / "viewer.html", shrink_environment(environment), fits


def offline(parameters, model: str, environment: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Direct light on the sphere by quadrature over every cell of the environment and four places of a pixel, and the
    pixels wholly on it."""
    height, width = environment.shape[:2]
    rows, columns = (np.arange(height) + 0.5) / height * np.pi, (np.arange(width) + 0.5) / width * 2 * np.pi
    theta, phi = np.meshgrid(rows, columns, indexing="ij")
    light = np.stack([np.sin(phi) * np.sin(theta), np.cos(theta), -np.cos(phi) * np.sin(theta)], -1).reshape(-1, 3)
    solid = (np.sin(theta) * (np.pi / height) * (2 * np.pi / width)).ravel()
    radiance = environment.reshape(-1, 3) * solid[:, None]
    image = np.zeros((SIZE, SIZE, 3))
    edges = (np.arange(SIZE + 1) / SIZE * 2 - 1) * np.tan(FIELD / 2)
    corner_x, corner_y = np.meshgrid(edges, edges)
    square = corner_x**2 + corner_y**2
    hit = square / (1 + square) < 1 / DISTANCE**2
    covered = hit[:-1, :-1] & hit[1:, :-1] & hit[:-1, 1:] & hit[1:, 1:]
    step = edges[1] - edges[0]
    for j, i, y, x in itertools.product(range(SIZE), range(SIZE), (0.25, 0.75), (0.25, 0.75)):
        if not covered[j, i]:
            continue
        direction = np.array([edges[i] + x * step, edges[j] + y * step, -1.0])
        direction /= np.linalg.norm(direction)
        b = DISTANCE * direction[2]
        normal = np.array([0, 0, DISTANCE]) + (-b - np.sqrt(b * b - DISTANCE**2 + 1)) * direction
        tangent = np.cross([0, 1, 0], normal)
        tangent /= np.linalg.norm(tangent)
        frame = np.stack([tangent, np.cross(normal, tangent), normal], 1)
        above = light @ normal > 0
        wi, wo = light[above] @ frame, -direction @ frame
        values = MODELS[model].evaluate(parameters, wi, np.broadcast_to(wo, wi.shape))
        image[j, i] += (values * radiance[above] * wi[:, 2:]).sum(0) / 4
    return image, covered


def choose(page, a: str, b: str, **others) -> None:
    """Show models left and right, once what they need is loaded."""
    page.evaluate("parts => ATLAS_VIEWER.change(parts)", {"m": "metal", "n": "", "a": a, "b": b} | others)
    page.wait_for_function("ATLAS_VIEWER.loaded")


def test_viewer_agrees_with_an_offline_render(tab, viewer):
    """Mean over pixels of the squared error at least 40 dB below the peak, for both kinds of factors and for tables."""
    path, environment, fits = viewer
    page = tab.open(path)
    page.evaluate(f"ATLAS_VIEWER.resize({SIZE}, {SIZE})")
    for _material, model, file in (fits[0], fits[1], fits[3], fits[4]):
        choose(page, model, model)
        seen = np.array(page.evaluate("ATLAS_VIEWER.linear(8192)")).reshape(SIZE, SIZE, 3)
        expected, covered = offline(load_fit(file).parameters, model, environment)
        covered = covered & (expected.max(-1) > 0)
        error = np.mean((seen[covered] - expected[covered]) ** 2)
        psnr = 10 * np.log10(expected[covered].max() ** 2 / error)
        print(f"{model}: {psnr:.1f} dB")
        assert psnr >= 40, model
    assert tab.faults == []


@pytest.fixture(scope="module")
def rendered(tmp_path_factory):
    """Sphere and statue under one smooth light by the project's renderer, and the viewer with the same fits."""
    import yaml

    from brdfatlas.measured import Measured
    from brdfatlas.rendering import use_variant
    from brdfatlas.rendering.jobs import render_scene
    from brdfatlas.rendering.scenes import prepare_scene, read_scenes

    root = tmp_path_factory.mktemp("rendered")
    theta, phi = (np.arange(64)[:, None] + 0.5) / 64 * np.pi, (np.arange(128) + 0.5) / 128 * 2 * np.pi
    towards = np.stack([np.sin(phi) * np.sin(theta), np.cos(theta) + 0 * phi, -np.cos(phi) * np.sin(theta)], -1)
    light = np.full((64, 128, 3), 0.1)
    for direction, colour in (([0.6, 0.7, 0.4], [9, 7, 5]), ([-0.8, 0.2, 0.6], [1, 2, 4])):
        cosine = towards @ (np.array(direction) / np.linalg.norm(direction))
        light += np.exp(12 * (cosine - 1))[..., None] * colour
    import OpenEXR

    channels = {name: np.ascontiguousarray(light[..., c], np.float32) for c, name in enumerate("RGB")}
    OpenEXR.File({"type": OpenEXR.scanlineimage}, channels).write(str(root / "light.exr"))
    shapes = {
        "sphere": {"shape": "sphere"},
        "statue": {"shape": "statue", "size": 2, "position": [0, -1, 0]},
    }
    definitions = {
        name: {
            "geometry": [shape],
            "environment": {"kind": "file", "file": str(root / "light.exr")},
            "camera": {"origin": [0, 0, 6], "target": [0, 0, 0], "fov": 21},
        }
        for name, shape in shapes.items()
    }
    (root / "scenes.yaml").write_text(yaml.safe_dump(definitions))
    use_variant()
    fits, pictures, reports = [], {}, root / "reports"
    glossy, low_rank = factors(0.5, [0.5, 0.4, 0.3]), factors(0.6, [1, 1, 1])
    # Two products: the second takes light from the flanks of the first.
    d, f = low_rank["d"], low_rank["f"]
    two = {"u": np.stack([0.4 * d, 0.2 * d**2], 1), "v": np.stack([f, 1 - f], 1)}
    two |= {"rho_d": glossy["rho_d"], "g": low_rank["g"]}
    for model, parameters in (("independent_g", glossy), ("low_rank_2", two)):
        fits.append(("metal", model, root / f"{model}.npz"))
        fit = Fit(model, "metal", {k: np.asarray(v, np.float32) for k, v in parameters.items()}, standin=True)
        fit.save(fits[-1][-1])
        fits[-1][-1].with_suffix(".json").write_text(json.dumps({"status": "ok"}))
        for name, definition in read_scenes(root / "scenes.yaml").items():
            scene = prepare_scene(name, definition, RENDERED)
            scene.save(root / f"{name}.npz")
            pictures[model, name] = render_scene(scene, Measured("metal", fit.table()), samples=1024)
    # The first fit is also shown as if it had been measured.
    measured = load_fit(root / "independent_g.npz").table()
    write_table(
        table_file(reports / "materials/metal", "reference"), "metal/reference", extend(measured, above_horizon())
    )
    (root / "metal.json").write_text(json.dumps({"name": "metal", "title": "metal", "standin": True}))
    write_assets(reports / "assets")
    scenes = [(SceneFacts("room"), root / "sphere.npz")]
    materials = {"metal": root / "metal.json"}
    page = reports / "viewer.html"
    write_recommended(reports, ["metal"], ["independent_g"], [0])
    assert write_viewer(page, data=reports / "data", fits=fits, materials=materials, scenes=scenes)["factors"] == 2
    return page, pictures


@pytest.mark.parametrize("shape", ["sphere", "statue"])
def test_viewer_agrees_with_the_renderer(tab, rendered, shape):
    """At least 35 dB over the pixels that the material covers, for a single product, for two, and for a table."""
    path, pictures = rendered
    page = tab.open(path)
    page.evaluate(f"ATLAS_VIEWER.resize({RENDERED}, {RENDERED})")
    page.locator("#shape").select_option(shape)
    for model in ("independent_g", "low_rank_2", "reference"):
        choose(page, model, model)
        seen = np.array(page.evaluate("ATLAS_VIEWER.linear(1024)")).reshape(RENDERED, RENDERED, 3)[::-1]
        render = pictures["independent_g" if model == "reference" else model, shape]
        expected, mask = render.mean, render.mask
        psnr = 10 * np.log10(expected[mask].max() ** 2 / np.mean((seen[mask] - expected[mask]) ** 2))
        print(f"{shape}, {model}: {psnr:.1f} dB over {mask.sum()} pixels")
        assert mask.sum() > 200
        assert psnr >= 35, model
    assert tab.faults == []


def test_viewer_split_and_controls(tab, viewer):
    """Each half is what the whole picture of its fit is; the view turns by keys; samples add up."""
    path, _environment, _fits = viewer
    page = tab.open(path)
    page.evaluate(f"ATLAS_VIEWER.resize({SIZE}, {SIZE})")

    def linear(a: str, b: str) -> np.ndarray:
        choose(page, a, b)
        return np.array(page.evaluate("ATLAS_VIEWER.linear(64)")).reshape(SIZE, SIZE, 3)

    left, right, both = linear("ggx", "ggx"), linear("naive", "naive"), linear("ggx", "naive")
    half = SIZE // 2
    assert np.array_equal(both[:, :half], left[:, :half])
    assert np.array_equal(both[:, half:], right[:, half:])
    assert not np.array_equal(left, right)
    page.locator("#canvas").focus()
    page.keyboard.press("Shift+ArrowRight")
    turned = np.array(page.evaluate("ATLAS_VIEWER.linear(64)")).reshape(SIZE, SIZE, 3)
    assert np.abs(turned - both).max() > 0.05, "the light has moved"
    page.locator("#material-b").select_option("paint")
    page.locator("#model-b").select_option("naive")
    assert "Naive" in page.locator("#right").inner_text()
    assert "cannot be shown: FitError: <b>black</b>" in page.locator("#message").inner_text()
    assert tab.faults == []
    faults = [v["id"] for v in Axe().run(page).response["violations"] if v["impact"] in ("serious", "critical")]
    assert faults == [], "an accessibility scan of the working viewer"


def test_viewer_leaves_the_keys_of_the_browser(tab, viewer):
    """Ctrl+R reloads what is shown; it reset view, light and exposure first."""
    page = tab.open(viewer[0], "#x=1&t=2&e=1")
    page.locator("#canvas").focus()
    for keys in ("Control+r", "Control+.", "Alt+ArrowUp"):
        page.keyboard.press(keys)
    page.wait_for_function("window.ATLAS_VIEWER")
    state = page.evaluate("ATLAS_VIEWER.state")
    assert {key: state[key] for key in "xteyw"} == {"x": 1, "t": 2, "e": 1, "y": 0, "w": 0.5}


def test_viewer_says_that_its_context_is_gone(tab, viewer):
    page = tab.open(viewer[0])
    page.evaluate(
        "document.getElementById('canvas').getContext('webgl2').getExtension('WEBGL_lose_context').loseContext()"
    )
    page.wait_for_function("document.getElementById('message').textContent.includes('graphics context')")
    page.evaluate("ATLAS_VIEWER.change({ e: 1 })")
    assert "graphics context" in page.locator("#message").inner_text()


def test_viewer_keeps_its_state(tab, viewer):
    """Reload, Back and a link show the same; the reference is beside the models at first; the divider is dragged."""
    path, _environment, _fits = viewer
    page = tab.open(path, "#m=paint&b=independent_g")
    page.evaluate(f"ATLAS_VIEWER.resize({SIZE}, {SIZE})")
    assert page.locator("#material-a").input_value() == page.locator("#material-b").input_value() == "paint"
    assert page.locator("#model-a").input_value() == "reference"
    assert "this run made no table" in page.locator("#message").inner_text()
    # The missing table is the test's own doing.
    tab.faults = [fault for fault in tab.faults if "reference.js" not in fault and "ERR_FILE_NOT_FOUND" not in fault]
    page.locator("#material-a").select_option("metal")
    assert page.locator("#material-b").input_value() == "metal", "one material on both sides until another is chosen"
    page.locator("#material-b").select_option("paint")
    page.locator("#shape").select_option("statue")
    page.locator("#exposure").fill("1.5")
    box = page.locator("#canvas").bounding_box()
    page.mouse.move(box["x"] + box["width"] / 2, box["y"] + 20)
    page.mouse.down()
    page.mouse.move(box["x"] + box["width"] / 4, box["y"] + 30)
    page.mouse.up()
    page.locator("#canvas").focus()
    page.keyboard.press("ArrowUp")
    page.wait_for_function("location.hash.includes('y=')")
    kept = page.evaluate("ATLAS_VIEWER.state")
    assert kept["w"] == pytest.approx(0.25, abs=0.01)
    assert (kept["n"], kept["f"], kept["e"]) == ("paint", "statue", 1.5)
    address = page.url

    def same() -> None:
        found = page.evaluate("ATLAS_VIEWER.state")
        assert found == {k: pytest.approx(v, abs=1e-4) if isinstance(v, float) else v for k, v in kept.items()}
        assert page.locator("#shape").input_value() == "statue"
        assert page.locator("#model-b").input_value() == "independent_g"
        assert page.locator("#stops").inner_text() == "+1.5 stops"

    page.reload()
    same()
    page.goto("about:blank")
    page.go_back()
    same()
    page.goto("about:blank")
    page.goto(address)
    same()
    assert tab.faults == []


def test_it_opens_on_the_recommended_model(tab, viewer):
    """The model of any size that the run recommends; the first where it recommends none or another is asked for."""
    path, _, _ = viewer
    for fragment, expected in (
        ("", "ggx"),
        ("#m=paint", "independent_g"),
        ("#m=metal", "ggx"),
        ("#m=metal&b=naive", "naive"),
    ):
        page = tab.open(path, fragment)
        page.reload()
        assert page.locator("#model-b").input_value() == expected, fragment


@pytest.mark.parametrize("full_circle", [False, True])
def test_tables_survive_their_encoding(full_circle):
    """Within 0.6 % over twelve decades; a table that is its own mirror image keeps its means."""
    rng = np.random.default_rng(1)
    table = 10 ** rng.uniform(-4, 4, (90, 90, 90, 3))
    table = np.concatenate([table, table[:, :, ::-1]] * (2 if full_circle else 1), 2)
    small = small_table(table)
    cells = (90, 30, 30 if full_circle else 15)
    assert small.shape == (*cells, 3)
    assert np.allclose(small.mean((1, 2)), table.mean((1, 2)), rtol=1e-5)
    assert np.allclose(decode_table(encode_table(small), cells), small, rtol=6e-3, atol=1e-5)


def test_environment_keeps_its_light():
    """Shrinking keeps the integral over the sphere (a property of area means), and a constant stays constant."""
    rng = np.random.default_rng(0)
    image = rng.uniform(0, 1, (129, 256, 3))
    small = shrink_environment(image)
    edges = np.cos(np.arange(129) / 128 * np.pi)
    solid = (edges[:-1] - edges[1:])[:, None, None] * 2 * np.pi / 256
    theta = np.arange(129) / 128 * np.pi
    fine = np.sin(theta)[:, None, None] * (np.pi / 128) * (2 * np.pi / 256)
    assert np.allclose((small * solid).sum((0, 1)), (image * fine).sum((0, 1)), rtol=2e-3), "quadrature error only"
    assert np.allclose(shrink_environment(np.full((33, 64, 3), 2.5)), 2.5)
