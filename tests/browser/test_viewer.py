"""The viewer against an offline integral of the same scene: same fits, same environment, same camera."""

import json

import numpy as np
import pytest

from brdfatlas.angles import theta_d_centres, theta_h_centres
from brdfatlas.files import write_npz
from brdfatlas.fits import Fit
from brdfatlas.models import MODELS
from brdfatlas.reports.data import SceneFacts
from brdfatlas.reports.pages import write_assets
from brdfatlas.reports.viewer import shrink_environment, write_viewer

SIZE, FIELD, DISTANCE = 40, np.deg2rad(21), 6.0


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
        fits.append((model, path))
    failed = root / "paint-naive.npz"
    failed.write_bytes(b"")
    failed.with_suffix(".json").write_text(json.dumps({"status": "failed"}))
    described = {}
    for name in ("metal", "paint"):
        described[name] = root / f"{name}.json"
        described[name].write_text(json.dumps({"name": name, "title": name, "standin": True}))
    reports = root / "reports"
    write_assets(reports / "assets")
    count = write_viewer(
        reports / "viewer.html",
        data=reports / "data",
        fits=[*fits, ("naive", failed)],
        materials=described,
        scenes=[(SceneFacts("room"), root / "scene.npz")],
    )
    assert count == 3, "three fits are shown, the failed one is not"
    return reports / "viewer.html", shrink_environment(environment), fits


def offline(parameters, model: str, environment: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Direct light on the sphere by quadrature over every cell of the environment, and the pixels wholly on it."""
    height, width = environment.shape[:2]
    parts = 2
    rows = (np.arange(height * parts) + 0.5) / (height * parts) * np.pi
    columns = (np.arange(width * parts) + 0.5) / (width * parts) * 2 * np.pi
    theta, phi = np.meshgrid(rows, columns, indexing="ij")
    light = np.stack([np.sin(phi) * np.sin(theta), np.cos(theta), -np.cos(phi) * np.sin(theta)], -1).reshape(-1, 3)
    solid = (np.sin(theta) * (np.pi / height / parts) * (2 * np.pi / width / parts)).ravel()
    radiance = environment.repeat(parts, 0).repeat(parts, 1).reshape(-1, 3) * solid[:, None]
    image = np.zeros((SIZE, SIZE, 3))
    edges = (np.arange(SIZE + 1) / SIZE * 2 - 1) * np.tan(FIELD / 2)
    corner_x, corner_y = np.meshgrid(edges, edges)
    square = corner_x**2 + corner_y**2
    hit = square / (1 + square) < 1 / DISTANCE**2
    covered = hit[:-1, :-1] & hit[1:, :-1] & hit[:-1, 1:] & hit[1:, 1:]
    centres = (edges[:-1] + edges[1:]) / 2
    for j, i in zip(*np.nonzero(covered), strict=True):
        direction = np.array([centres[i], centres[j], -1.0])
        direction /= np.linalg.norm(direction)
        b = DISTANCE * direction[2]
        normal = np.array([0, 0, DISTANCE]) + (-b - np.sqrt(b * b - DISTANCE**2 + 1)) * direction
        tangent = np.cross([0, 1, 0], normal)
        tangent /= np.linalg.norm(tangent)
        frame = np.stack([tangent, np.cross(normal, tangent), normal], 1)
        above = light @ normal > 0
        wi, wo = light[above] @ frame, -direction @ frame
        values = MODELS[model].evaluate(parameters, wi, np.broadcast_to(wo, wi.shape))
        image[j, i] = (values * radiance[above] * wi[:, 2:]).sum(0)
    return image, covered


def test_viewer_agrees_with_an_offline_render(tab, viewer):
    """Mean over pixels of the squared error at least 35 dB below the peak, for both kinds of factors, side by side."""
    path, environment, fits = viewer
    page = tab.open(path)
    page.evaluate(f"ATLAS_VIEWER.resize({SIZE}, {SIZE})")
    for row, (model, file) in enumerate(fits[:2]):
        page.evaluate(f"Object.assign(ATLAS_VIEWER.state, {{a: {row}, b: {row}}}); ATLAS_VIEWER.restart()")
        seen = np.array(page.evaluate("ATLAS_VIEWER.linear(1024)")).reshape(SIZE, SIZE, 3)
        from brdfatlas.fits import load_fit

        expected, covered = offline(load_fit(file).parameters, model, environment)
        # Grazing pixels change by much within themselves: the quadrature looks at centres only.
        error = np.mean((seen[covered] - expected[covered]) ** 2)
        psnr = 10 * np.log10(expected[covered].max() ** 2 / error)
        print(f"{model}: {psnr:.1f} dB")
        assert psnr >= 35, model
    assert tab.faults == []


def test_viewer_split_and_controls(tab, viewer):
    """Each half is what the whole picture of its fit is; the view turns by keys; samples add up."""
    path, _environment, _fits = viewer
    page = tab.open(path)
    page.evaluate(f"ATLAS_VIEWER.resize({SIZE}, {SIZE})")

    def linear(a: int, b: int) -> np.ndarray:
        page.evaluate(f"Object.assign(ATLAS_VIEWER.state, {{a: {a}, b: {b}}}); ATLAS_VIEWER.restart()")
        return np.array(page.evaluate("ATLAS_VIEWER.linear(64)")).reshape(SIZE, SIZE, 3)

    left, right, both = linear(0, 0), linear(2, 2), linear(0, 2)
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
    assert "No fit of naive to paint" in page.locator("#message").inner_text()
    assert tab.faults == []


def test_environment_keeps_its_light():
    """Shrinking keeps the integral over the sphere (a property of area means), and a constant stays constant."""
    rng = np.random.default_rng(0)
    image = rng.uniform(0, 1, (129, 256, 3))
    small = shrink_environment(image)
    edges = np.cos(np.arange(65) / 64 * np.pi)
    solid = (edges[:-1] - edges[1:])[:, None, None] * 2 * np.pi / 128
    theta = np.arange(129) / 128 * np.pi
    fine = np.sin(theta)[:, None, None] * (np.pi / 128) * (2 * np.pi / 256)
    assert np.allclose((small * solid).sum((0, 1)), (image * fine).sum((0, 1)), rtol=2e-3), "quadrature error only"
    assert np.allclose(shrink_environment(np.full((33, 64, 3), 2.5)), 2.5)
