"""Scenes: what is wrong is said in one line before anything is rendered; what is made is closed, smooth and bright."""

import copy
import re
from pathlib import Path

import numpy as np
import pytest
import yaml
from rendering_materials import variant

from brdfatlas.rendering import environments, scenes
from brdfatlas.rendering.meshes import MeshError, read_mesh, vertex_normals
from brdfatlas.rendering.scenes import SceneError, check_settings, prepare_scene, read_scenes
from brdfatlas.rendering.statue import statue_mesh

BUILT_IN = Path(__file__).parents[2] / "config" / "scenes.yaml"
SPHERE = {
    "geometry": [{"shape": "sphere"}],
    "environment": {"kind": "studio", "width": 32},
    "camera": {"origin": [0, 0, 6], "target": [0, 0, 0]},
}


def write(tmp_path, *changes):
    """A scenes file with one scene, changed at dotted keys."""
    scene = copy.deepcopy(SPHERE)
    for key, value in changes:
        place = scene
        *path, last = key.split(".")
        for part in path:
            place = place[int(part) if part.isdigit() else part]
        place[last] = value
    path = tmp_path / "scenes.yaml"
    path.write_text(yaml.safe_dump({"mine": scene}))
    return path


def test_the_built_in_scenes_are_complete():
    built_in = read_scenes(BUILT_IN)
    assert list(built_in) == ["studio_sphere", "overcast_statue", "sunsky_statue", "hall_sphere"]
    for scene in built_in.values():
        assert scene["title"]
        assert scene["exposure"] > 0
        assert scene["geometry"][0]["surface"] == "material"


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("colour", "red", r"scenes.yaml: mine: .*'colour'.*known keys"),
        ("camera.zoom", 2, r"mine.camera: .*'zoom'.*known keys"),
        ("camera.fov", 200, r"mine.camera.fov: 200"),
        ("camera.target", [0, 0, 6], r"mine.camera: the camera must not look"),
        ("camera.target", [0, 9], r"mine.camera.target"),
        ("exposure", 0, r"mine.exposure: 0"),
        ("samples", 0, r"mine.samples: 0"),
        ("environment.kind", "disco", r"mine.environment.kind: 'disco'"),
        ("environment.kind", "file", r"mine.environment.file: .*name a light probe"),
        ("environment.scale", 1e30, r"mine.environment.scale: 1e\+30"),
        ("environment.scale", 1e-40, r"mine.environment.scale: 1e-40"),
        ("environment.file", "a.hdr", r"mine.environment.file: .*remove it or set kind: file"),
        ("geometry.0.shape", "teapot", r"mine.geometry.0.shape: 'teapot'"),
        ("geometry.0.shape", "mesh", r"mine.geometry.0.file: a mesh needs"),
        ("geometry.0.file", "a.ply", r"mine.geometry.0.file: a sphere has no such key"),
        ("geometry.0.surface", [0.5, 0.5, 0.5], r"mine.geometry: nothing shows the material"),
        ("geometry.0.surface", [0.5, 0.5, 2], r"mine.geometry.0.surface"),
        ("geometry", [], r"mine.geometry"),
    ],
)
def test_what_is_wrong_in_the_file_is_named(tmp_path, key, value, message):
    with pytest.raises(ValueError, match=message) as caught:
        read_scenes(write(tmp_path, (key, value)))
    assert "\n" not in str(caught.value)


def test_a_missing_or_broken_scenes_file_is_named(tmp_path):
    (tmp_path / "broken.yaml").write_text("a: [1, 2")
    (tmp_path / "empty.yaml").write_text("")
    for name in ("absent.yaml", "broken.yaml", "empty.yaml"):
        with pytest.raises(ValueError, match=name):
            read_scenes(tmp_path / name)


@pytest.mark.parametrize(("settings", "key"), [((0, 8, 8), "size"), ((8, 0, 8), "samples"), ((8, 8, 0), "batches")])
def test_impossible_settings(settings, key):
    with pytest.raises(SceneError, match=f"render.{key}"):
        check_settings(*settings)


def _hdr(path, image):
    image = np.ascontiguousarray(image, np.float32)
    if path.suffix == ".exr":
        import OpenEXR

        channels = {name: np.ascontiguousarray(image[..., c]) for c, name in enumerate("RGB")}
        OpenEXR.File({"type": OpenEXR.scanlineimage}, channels).write(str(path))
    else:
        variant().Bitmap(image).write(str(path))


def test_bad_probes_are_named_before_rendering(tmp_path):
    rng = np.random.default_rng(0)
    good = rng.lognormal(0, 1, (16, 32, 3)).astype(np.float32)
    _hdr(tmp_path / "good.hdr", good)
    _hdr(tmp_path / "square.exr", good[:, :16])
    _hdr(tmp_path / "black.exr", 0 * good)
    _hdr(tmp_path / "negative.exr", -good)
    _hdr(tmp_path / "nan.exr", np.where(good > 3, np.nan, good))
    (tmp_path / "ldr.png").write_bytes(b"\x89PNG")
    (tmp_path / "text.hdr").write_text("no picture")
    for kind in ("hdr", "exr", "pfm"):
        _hdr(tmp_path / f"whole.{kind}", good)
        (tmp_path / f"cut.{kind}").write_bytes((tmp_path / f"whole.{kind}").read_bytes()[:700])
    cases = {
        "missing.hdr": "no such file",
        "ldr.png": "not a high-dynamic-range format",
        "text.hdr": "cannot be read",
        "cut.hdr": "cannot be read",
        "cut.exr": "cannot be read",
        "cut.pfm": "cannot be read",
        "square.exr": "not a latlong image",
        "black.exr": "black",
        "negative.exr": "negative",
        "nan.exr": "NaN",
    }
    for name, message in cases.items():
        file = str(tmp_path / name)
        path = write(tmp_path, ("environment", {"kind": "file", "file": file}))
        with pytest.raises(SceneError, match=re.escape(message)) as caught:
            prepare_scene("mine", read_scenes(path)["mine"], 8, source=str(path))
        text = str(caught.value)
        assert "\n" not in text
        assert file in text
        assert "mine.environment.file" in text
    for kind in ("good.hdr", "whole.exr", "whole.pfm"):
        image = environments.read_probe(str(tmp_path / kind), "latlong", 512, "key")
        # A pixel of .hdr has 8 bits of significand for its largest channel.
        assert (abs(image - good) <= good.max(-1, keepdims=True) / 128).all()


def _ply(path, vertices, faces):
    lines = ["ply", "format ascii 1.0", f"element vertex {len(vertices)}"]
    lines += [f"property float {axis}" for axis in "xyz"]
    lines += [f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header"]
    lines += [" ".join(map(str, v)) for v in vertices] + ["3 " + " ".join(map(str, f)) for f in faces]
    path.write_text("\n".join(lines) + "\n")


CUBE = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
CUBE_FACES = [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1]]
CUBE_FACES += [[2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]]


def test_meshes_are_checked_and_repaired(tmp_path):
    variant()
    _ply(tmp_path / "cube.ply", CUBE, CUBE_FACES)
    vertices, faces, normals, _ = read_mesh(str(tmp_path / "cube.ply"), "key")
    assert (len(vertices), len(faces)) == (8, 12)
    expected = (CUBE - 0.5) / np.sqrt(0.75)  # by symmetry, whatever the diagonals: angles weigh each side alike
    np.testing.assert_allclose(vertex_normals(CUBE, np.array(CUBE_FACES)), expected, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-6)
    assert ((normals * (vertices - 0.5)).sum(1) > 0).all()

    many = [f for f in CUBE_FACES for _ in range(3)]
    _ply(tmp_path / "sliver.ply", CUBE, [*many, [0, 0, 1]])
    _, faces, normals, notes = read_mesh(str(tmp_path / "sliver.ply"), "key")
    assert len(faces) == 36
    assert "1 degenerate" in notes[0]
    assert np.isfinite(normals).all()

    obj = "".join(f"v {x} {y} {z}\n" for x, y, z in CUBE) + "".join(
        f"f {a + 1} {b + 1} {c + 1}\n" for a, b, c in CUBE_FACES
    )
    (tmp_path / "cube.obj").write_text(obj)
    vertices, faces, normals, _ = read_mesh(str(tmp_path / "cube.obj"), "key")
    assert len(faces) == 12
    assert ((normals * (vertices - 0.5)).sum(1) > 0).all()

    _ply(tmp_path / "flat.ply", CUBE, [[0, 0, 1], [2, 2, 3], [0, 1, 3]])
    _ply(tmp_path / "none.ply", CUBE, [])
    _ply(tmp_path / "nan.ply", np.where(CUBE == 1, np.nan, CUBE), CUBE_FACES)
    (tmp_path / "cut.ply").write_text((tmp_path / "cube.ply").read_text()[:150])
    (tmp_path / "mesh.stl").write_text("solid")
    cases = {"flat.ply": "degenerate", "none.ply": "key", "nan.ply": "NaN|cannot be read", "cut.ply": "cannot be read"}
    for name, message in (cases | {"mesh.stl": "not a .ply or .obj", "gone.ply": "no such file"}).items():
        with pytest.raises(MeshError, match=message) as caught:
            read_mesh(str(tmp_path / name), "key")
        assert "\n" not in str(caught.value)
        assert name in str(caught.value)


def test_a_missing_mesh_is_named_with_its_key(tmp_path):
    variant()
    path = write(tmp_path, ("geometry", [{"shape": "mesh", "file": "buddha.ply"}]))
    with pytest.raises(SceneError, match=r"scenes.yaml: mine.geometry.0.file: buddha.ply: no such file"):
        prepare_scene("mine", read_scenes(path)["mine"], 8, source=str(path))


def test_a_scene_that_shows_no_material_is_refused(tmp_path):
    variant()
    path = write(tmp_path, ("camera.target", [0, 0, 12]))
    with pytest.raises(SceneError, match="no pixel of 16 x 16 shows the material alone"):
        scenes.prepare_scene("mine", read_scenes(path)["mine"], 16, 1, str(path))


def test_a_prepared_scene_survives_its_file(tmp_path):
    variant()
    shapes = [{"shape": "statue"}, {"shape": "sphere"}, {"shape": "floor", "surface": [0.5, 0.5, 0.5]}]
    path = write(tmp_path, ("geometry", shapes))
    scene = scenes.prepare_scene("mine", read_scenes(path)["mine"], 16, 4, str(path))
    scene.save(tmp_path / "scene.npz")
    again = scenes.load_scene(tmp_path / "scene.npz")
    assert again.digest() == scene.digest()
    assert again.definition == scene.definition
    np.testing.assert_array_equal(again.mask, scene.mask)
    np.testing.assert_array_equal(again.meshes[0].normals, scene.meshes[0].normals)


def test_the_statue_is_closed_smooth_and_shadows_itself():
    vertices, faces, normals = statue_mesh(60)
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    _, counts = np.unique(edges, axis=0, return_counts=True)
    assert (counts == 2).all()  # every edge has two triangles: closed
    assert vertices[:, 1].min() == 0
    assert vertices[:, 1].max() == 1
    corner = vertices[faces].astype(float)
    volume = np.einsum("ij,ij->i", corner[:, 0], np.cross(corner[:, 1], corner[:, 2])).sum() / 6
    assert volume > 0.01  # triangles face outwards
    facing = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    area = np.linalg.norm(facing, axis=1)
    agree = np.einsum("ij,ij->i", facing / area[:, None], normals[faces].mean(1))
    assert np.average(agree, weights=area) > 0.98
    # Genus from Euler's formula: V - E + F = 2 - 2 g; a knot on a base has holes, so it shadows itself.
    assert len(vertices) - len(counts) + len(faces) < 2


@pytest.mark.parametrize(("kind", "low", "high"), [("studio", 1e4, 1e6), ("overcast", 3, 30), ("hall", 1e2, 1e4)])
def test_dynamic_range(kind, low, high):
    image = environments.environment_image(
        {"kind": kind, "width": 256, "turn": 0, "scale": 1, "file": "", "mapping": "latlong"}, "key"
    )
    assert image.shape == (128, 256, 3)
    assert image.min() > 0
    luminance = image @ [0.2126, 0.7152, 0.0722]
    assert low < luminance.max() / luminance.min() < high


@pytest.mark.parametrize("width", [16, 512, 1024, 2048, 4096])
def test_a_wide_environment_is_not_more_work(width):
    """At 8192 texels and 16 points in each, minutes would pass without a word."""
    points = []

    def radiance(direction):
        points.append(direction[..., 0].size)
        return direction

    assert environments._render(radiance, width).shape == (width // 2, width, 3)
    texels = width**2 // 2
    assert sum(points) == 16 * texels if width <= 1024 else texels <= sum(points) <= 2**23


def test_the_sun_shines_from_where_it_is_put():
    variant()
    image = environments.sunsky(128, 3.0, 40.0)
    brightest = np.unravel_index(image.sum(-1).argmax(), image.shape[:2])
    sun = environments.texel_directions(128, 64)[brightest][0]
    expected = [0, np.sin(np.radians(40)), np.cos(np.radians(40))]
    assert np.degrees(np.arccos(sun @ expected)) < 3  # a texel is 2.8 degrees


def test_turning_is_anticlockwise_from_above():
    """A light at +z, turned by 90 degrees, shines from +x; a whole turn changes nothing."""
    directions = environments.texel_directions(64, 32)[:, :, 0]
    image = np.maximum(directions @ [0, 0, 1.0], 0)[..., None] ** 20 * np.ones(3)
    quarter = environments.turned(image, 90)
    np.testing.assert_allclose(quarter[..., 0], np.maximum(directions[..., 0], 0) ** 20, atol=1e-9)
    np.testing.assert_allclose(environments.turned(image, 360), image, atol=1e-12)


def test_an_angular_map_shows_each_direction_once():
    """Paint a smooth function of direction as Debevec's angular map, read it back as lat-long."""
    n = 256
    v, u = np.meshgrid((np.arange(n) + 0.5) / n * 2 - 1, (np.arange(n) + 0.5) / n * 2 - 1, indexing="ij")
    radius = np.hypot(u, v)
    angle = radius * np.pi
    right, up, forward = u / radius * np.sin(angle), -v / radius * np.sin(angle), np.cos(angle)

    def paint(x, y, z):
        return np.stack([1 + 0.5 * x, 1 + 0.5 * y, 1 + 0.5 * z], -1)

    probe = np.where((radius <= 1)[..., None], paint(-right, up, forward), 1.0)
    image = environments.from_angular_map(probe, 64)
    x, y, z = np.moveaxis(environments.texel_directions(64, 32)[:, :, 0], -1, 0)
    away = z > -0.95  # the rim of the map is one direction
    np.testing.assert_allclose(image[away], paint(x, y, z)[away], atol=0.02)


def test_the_papers_files(tmp_path):
    """A real probe and the Stanford Buddha, where they are at hand."""
    data = Path(__file__).resolve().parents[2].parent / "shared" / "data"
    if not (data / "meshes").is_dir():
        pytest.skip("no real probes and meshes beside the project")
    variant()
    mesh = {"shape": "mesh", "file": str(data / "meshes" / "happy_vrip_res4.ply"), "size": 2}
    probe = {"kind": "file", "file": str(data / "envmaps" / "grace.hdr")}
    path = write(tmp_path, ("geometry", [mesh]), ("environment", probe), ("camera.target", [0, 1, 0]))
    scene = scenes.prepare_scene("mine", read_scenes(path)["mine"], 24, 4, str(path))
    assert scene.mask.mean() > 0.05
    vertices = scene.meshes[0].vertices
    assert np.ptp(vertices[:, 1]) == pytest.approx(2, abs=1e-3)
    assert vertices[:, 1].min() == pytest.approx(0, abs=1e-4)
