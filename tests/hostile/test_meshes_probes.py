"""No mesh and no probe ends the process: each is parsed here, and its fault is one line with key and file."""

import contextlib
import json
import os
import struct
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from brdfatlas.rendering import use_variant
from brdfatlas.rendering.environments import ProbeError, environment_image, read_probe
from brdfatlas.rendering.meshes import MeshError, read_mesh
from brdfatlas.rendering.scenes import SceneError, prepare_scene, read_scenes

CUBE = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
FACES = np.array(
    [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4]]
    + [[1, 5, 7], [1, 7, 3]]
)


def ply(form="ascii", vertices=CUBE, faces=FACES, n_vertices=None, n_faces=None, index="int", length="uchar"):
    """A PLY file of the cube, or of what the arguments say."""
    header = f"ply\nformat {form} 1.0\nelement vertex {len(vertices) if n_vertices is None else n_vertices}\n"
    header += "property float x\nproperty float y\nproperty float z\n"
    header += f"element face {len(faces) if n_faces is None else n_faces}\n"
    header += f"property list {length} {index} vertex_indices\n"
    data = (header + "end_header\n").encode()
    if form == "ascii":
        rows = [" ".join(map(str, v)) for v in vertices] + [" ".join(map(str, [len(f), *f])) for f in faces]
        return data + "\n".join(rows).encode() + b"\n"
    order = "<" if "little" in form else ">"
    data += np.asarray(vertices, order + "f4").tobytes()
    kinds = {"uchar": "B", "int": "i", "uint": "I", "char": "b", "short": "h", "double": "d"}
    for face in faces:
        data += struct.pack(order + kinds[length], len(face)) + struct.pack(order + f"{len(face)}{kinds[index]}", *face)
    return data


def obj(vertices=CUBE, faces=FACES + 1, more=""):
    lines = ["v " + " ".join(map(str, v)) for v in vertices] + ["f " + " ".join(map(str, f)) for f in faces]
    return ("\n".join(lines) + "\n" + more).encode()


FORMS = ("ascii", "binary_little_endian", "binary_big_endian")


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("quads", [False, True])
def test_every_form_of_a_cube_is_the_cube(tmp_path, form, quads):
    """Triangles or squares, text or bytes of either order: the same volume, 8, by the divergence theorem."""
    squares = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
    for name, data in (
        ("cube.ply", ply(form, faces=squares if quads else FACES)),
        ("cube.obj", obj(faces=(squares if quads else FACES) + 1)),
    ):
        (tmp_path / name).write_bytes(data)
        vertices, faces, normals, _ = read_mesh(str(tmp_path / name), "key")
        a, b, c = (vertices[faces[:, i]] for i in range(3))
        assert abs((np.cross(a, b) * c).sum() / 6) == pytest.approx(8)
        np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, rtol=1e-6)


@pytest.mark.parametrize("change", [b"\xef\xbb\xbf".__add__, lambda data: data.replace(b"\n", b"\r")])
def test_an_obj_file_of_another_system_is_the_cube(tmp_path, change):
    data = obj().replace(b"\nf", b" # a comment\n# another\nf")
    (tmp_path / "a.obj").write_bytes(data)
    (tmp_path / "b.obj").write_bytes(change(data))
    one, other = (read_mesh(str(tmp_path / name), "k")[:3] for name in ("a.obj", "b.obj"))
    for a, b in zip(one, other):
        np.testing.assert_array_equal(a, b)
    assert len(one[1]) == 12


SOUP = CUBE[FACES].reshape(-1, 3)
BACKS = {
    "none": ("mesh", 0, None, ""),
    "some faces": ("mesh", 4, None, "of the material is its back"),
    "all faces": ("mesh", 12, SceneError, "100% of what is seen of the material is its back"),
    "a sphere from inside": ("sphere", 0, SceneError, "100% of what is seen of the material is its back"),
}


@pytest.mark.parametrize("variant", ["llvm_ad_rgb", "scalar_rgb"])
@pytest.mark.parametrize("what", BACKS)
def test_backs_of_a_material_make_no_black_picture_without_a_word(tmp_path, monkeypatch, variant, what):
    """Faces without normals of their own, the last so many of them turned; a corner for each, so none is smoothed."""
    use_variant(variant)
    monkeypatch.chdir(tmp_path)
    shape, turned, error, words = BACKS[what]
    faces = np.arange(36).reshape(-1, 3) + 1
    faces[len(faces) - turned :] = faces[len(faces) - turned :, ::-1]
    (tmp_path / "a.obj").write_bytes(obj(SOUP, faces))
    geometry = {"shape": shape, "size": 2} | ({"file": "a.obj"} if shape == "mesh" else {})
    camera = {"origin": [1.4, 1, -0.5] if shape == "sphere" else [6, 5, -4], "target": [0, 0.9, 0]}
    mine = {"geometry": [geometry], "environment": {"kind": "overcast", "width": 16}, "camera": camera}
    (tmp_path / "scenes.yaml").write_text(json.dumps({"mine": mine}))
    with pytest.raises(error, match=f"mine: {words}") if error else contextlib.nullcontext():
        scene = prepare_scene("mine", read_scenes("scenes.yaml")["mine"], 16, 1)
        assert any("is its back" in note for note in scene.notes) == bool(words)


def test_meshes_are_what_mitsuba_reads(tmp_path):
    """The same triangles as the stock reader's, for files that it can read."""
    import mitsuba as mi

    if mi.variant() is None:
        mi.set_variant("scalar_rgb")
    rng = np.random.default_rng(0)
    vertices = rng.normal(size=(50, 3)).astype(np.float32).astype(float)
    faces = np.array([rng.choice(50, 3, replace=False) for _ in range(80)])
    normals = "".join(f"vn {x} {y} {z}\n" for x, y, z in vertices)
    pairs = "".join("f " + " ".join(f"{i}//{i}" for i in face) + "\n" for face in faces + 1)
    files = {"a.ply": ply("binary_little_endian", vertices, faces), "b.ply": ply("ascii", vertices, faces)}
    files |= {"c.obj": obj(vertices, faces + 1), "d.obj": obj(vertices, [], normals + pairs)}
    for name, data in files.items():
        (tmp_path / name).write_bytes(data)
        stock = mi.traverse(mi.load_dict({"type": name[-3:], "filename": str(tmp_path / name)}))
        theirs = np.array(stock["vertex_positions"]).reshape(-1, 3)[np.array(stock["faces"]).reshape(-1, 3)]
        mine, corners, _, _ = read_mesh(str(tmp_path / name), "key")
        np.testing.assert_allclose(mine[corners], theirs, rtol=1e-6)


def faces_with(value):
    return np.concatenate([FACES[:-1], [[0, 1, value]]])


BAD_MESHES = {
    "an index of 2^31 - 1.ply": ply(faces=faces_with(2**31 - 1)),
    "an index of 2^31.ply": ply("binary_little_endian", faces=faces_with(2**31), index="uint"),
    "an index of 2^32 - 1.ply": ply("binary_little_endian", faces=faces_with(2**32 - 1), index="uint"),
    "an index one too far.ply": ply(faces=faces_with(8)),
    "a negative index.ply": ply(faces=faces_with(-1)),
    "a negative index, binary.ply": ply("binary_big_endian", faces=faces_with(-5)),
    "an index beyond 64 bits.ply": ply(faces=[[0, 1, 2**70]]),
    "an index of 1_0.ply": ply(faces=faces_with("1_0")),
    "a coordinate of 1_0.ply": ply().replace(b"end_header\n-1", b"end_header\n-0_1"),
    "an index that is no number.ply": ply(faces=[["a", "b", "c"]]),
    "more vertices than there are.ply": ply(n_vertices=9),
    "a billion vertices.ply": ply(n_vertices=10**9),
    "a billion vertices, binary.ply": ply("binary_little_endian", n_vertices=10**9),
    "10^30 faces.ply": ply("binary_little_endian", n_faces=10**30),
    "a negative count.ply": ply(n_faces=-1),
    "more faces than there are.ply": ply("binary_little_endian", n_faces=13),
    "a list of negative length.ply": ply("binary_little_endian", length="char", faces=[]).replace(b"face 0", b"face 1")
    + b"\xff",
    "NaN.ply": ply(vertices=np.where(CUBE > 0, np.nan, CUBE)),
    "infinity.ply": ply(vertices=np.where(CUBE > 0, np.inf, CUBE)),
    "beyond float32.ply": ply(vertices=CUBE * 1e300),
    "no height.ply": ply(vertices=CUBE * [1, 0, 1]),
    "one point.ply": ply(vertices=CUBE * 0),
    "no faces.ply": ply(faces=[]),
    "no vertices.ply": ply(vertices=np.empty((0, 3))),
    "lines only.ply": ply(faces=[[0, 1], [1, 2]]),
    "a header alone.ply": ply(vertices=np.empty((0, 3)), n_vertices=8),
    "no end of the header.ply": ply().replace(b"end_header", b"end"),
    "no format.ply": ply().replace(b"format ascii 1.0\n", b""),
    "another format.ply": ply().replace(b"ascii 1.0", b"binary_middle_endian 1.0"),
    "another version.ply": ply().replace(b"ascii 1.0", b"ascii 2.0"),
    "an unknown type.ply": ply().replace(b"float x", b"quaternion x"),
    "no x.ply": ply().replace(b"float x", b"float u"),
    "two x.ply": ply("binary_little_endian").replace(b"float y", b"float x"),
    "lists of positions.ply": ply().replace(b"property float x", b"property list uchar float x"),
    "a property without an element.ply": b"ply\nformat ascii 1.0\nproperty float x\nend_header\n",
    "text.ply": b"hello\n",
    "empty.ply": b"",
    "zeros.ply": bytes(1000),
    "an index of 0.obj": obj(faces=[[0, 1, 2]]),
    "an index too far.obj": obj(faces=[[1, 2, 9]]),
    "an index of 2^31.obj": obj(faces=[[1, 2, 2**31]]),
    "an index of 10^30.obj": obj(faces=[[1, 2, 10**30]]),
    "a negative index too far.obj": obj(faces=[[-1, -2, -9]]),
    "a normal too far.obj": obj(faces=[["1//1", "2//1", "3//1"]]),
    "a corner of text.obj": obj(faces=[["one", "two", "three"]]),
    "an empty corner.obj": obj(faces=[["/1/", "//", "1"]]),
    "two coordinates.obj": obj(vertices=CUBE[:, :2]),
    "coordinates of 1_0.obj": obj(more="v 1_0 1 1\n"),
    "a corner of 0_1.obj": obj(faces=[["0_1", "2", "3"]]),
    "coordinates of text.obj": obj(more="v a b c\n"),
    "NaN.obj": obj(vertices=np.where(CUBE > 0, np.nan, CUBE)),
    "a plane but for rounding.obj": b"v -1 0 -1\nv 1 4e-8 -1\nv 1 0 1\nv -1 4e-8 1\nf 1 2 3\nf 1 3 4\n",
    "no faces.obj": obj(faces=[]),
    "faces alone.obj": obj(vertices=[]),
    "empty.obj": b"",
    "zeros.obj": bytes(1000),
}


@pytest.mark.parametrize("name", BAD_MESHES)
def test_a_bad_mesh_is_named(tmp_path, name):
    (tmp_path / name).write_bytes(BAD_MESHES[name])
    with pytest.raises(MeshError) as caught:
        read_mesh(str(tmp_path / name), "scenes.yaml: mine.geometry.0.file")
    message = str(caught.value)
    assert message.startswith(f"scenes.yaml: mine.geometry.0.file: {tmp_path / name}: ")
    assert "\n" not in message


@settings(max_examples=200, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data(), form=st.sampled_from([*FORMS, "obj"]))
def test_a_damaged_mesh_is_named_or_whole(tmp_path, data, form):
    content = bytearray(obj() if form == "obj" else ply(form))
    for _ in range(data.draw(st.integers(1, 5))):
        content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.integers(0, 255))
    cut = data.draw(st.one_of(st.none(), st.integers(0, len(content))))
    path = tmp_path / ("a.obj" if form == "obj" else "a.ply")
    path.write_bytes(content[:cut])
    try:
        vertices, faces, normals, _ = read_mesh(str(path), "key")
    except MeshError:
        return
    assert faces.max() < len(vertices) == len(normals)
    assert np.isfinite(vertices).all()
    assert np.isfinite(normals).all()


def pfm(width=8, height=4, scale="-1.0", kind="PF", values=None):
    values = np.ones((height, width, 3 if kind == "PF" else 1)) if values is None else values
    return f"{kind}\n{width} {height}\n{scale}\n".encode() + np.asarray(values, "<f4").tobytes()


def rgbe(width=8, height=4, header="#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n", pixels=None):
    body = bytes([128, 128, 128, 129]) * (width * height if pixels is None else pixels)
    return f"{header}\n-Y {height} +X {width}\n".encode() + body


HUGE = np.full((4, 8, 3), 3e38)
BAD_PROBES = {
    "0 x 0.pfm": pfm(0, 0),
    "0 wide.pfm": pfm(0, 4),
    "negative.pfm": pfm(8, 4).replace(b"8 4", b"-8 -4"),
    "a terabyte.pfm": pfm().replace(b"8 4", b"999999 999999"),
    "0_8 wide.pfm": pfm().replace(b"8 4", b"0_8 4"),
    "a scale of -0_1.pfm": pfm(scale="-0_1"),
    "beyond 64 bits.pfm": pfm().replace(b"8 4", b"9" * 30 + b" 4"),
    "an infinite scale.pfm": pfm(scale="inf"),
    "a negative infinite scale.pfm": pfm(scale="-inf"),
    "a scale of NaN.pfm": pfm(scale="nan"),
    "a scale of 0.pfm": pfm(scale="0.0"),
    "a scale of text.pfm": pfm(scale="big"),
    "a scale that overflows.pfm": pfm(scale="-1e30", values=HUGE),
    "truncated.pfm": pfm()[:-1],
    "a header alone.pfm": b"PF\n8 4\n-1.0\n",
    "no header.pfm": bytes(400),
    "empty.pfm": b"",
    "NaN.pfm": pfm(values=np.full((4, 8, 3), np.nan)),
    "negative radiance.pfm": pfm(values=-np.ones((4, 8, 3))),
    "black.pfm": pfm(values=np.zeros((4, 8, 3))),
    "square.pfm": pfm(8, 8),
    "small.pfm": pfm(2, 1),
    "0 x 0.hdr": rgbe(0, 0),
    "a terabyte.hdr": rgbe(8, 4).replace(b"-Y 4 +X 8", b"-Y 999999 +X 999999"),
    "turned.hdr": rgbe().replace(b"-Y 4 +X 8", b"+X 8 -Y 4"),
    "truncated.hdr": rgbe(16, 8, pixels=9),
    "no size.hdr": b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n",
    "text.hdr": b"hello\n" * 30,
    "empty.hdr": b"",
    "zeros.hdr": bytes(5000),
    "empty.exr": b"",
    "text.exr": b"hello\n" * 30,
    "a magic alone.exr": b"v/1\x01",
    "a picture.png": b"\x89PNG\r\n",
}


@pytest.mark.parametrize("name", BAD_PROBES)
def test_a_bad_probe_is_named(tmp_path, name):
    import mitsuba as mi

    if mi.variant() is None:
        mi.set_variant("scalar_rgb")
    (tmp_path / name).write_bytes(BAD_PROBES[name])
    with pytest.raises(ProbeError) as caught:
        read_probe(str(tmp_path / name), "latlong", 16, "scenes.yaml: mine.environment.file")
    message = str(caught.value)
    assert message.startswith(f"scenes.yaml: mine.environment.file: {tmp_path / name}: ")
    assert "\n" not in message


def test_good_probes_are_read(tmp_path):
    import mitsuba as mi

    if mi.variant() is None:
        mi.set_variant("scalar_rgb")
    values = np.random.default_rng(0).random((4, 8, 3)).astype(np.float32)
    (tmp_path / "a.pfm").write_bytes(pfm(scale="-2.0", values=values))
    np.testing.assert_allclose(read_probe(str(tmp_path / "a.pfm"), "latlong", 16, "k"), 2 * values[::-1], rtol=1e-6)
    big = b"PF 8 4 1.0\n" + values.astype(">f4").tobytes()
    (tmp_path / "b.pfm").write_bytes(big)
    np.testing.assert_array_equal(read_probe(str(tmp_path / "b.pfm"), "latlong", 16, "k"), values[::-1])
    (tmp_path / "c.pfm").write_bytes(pfm(kind="Pf"))
    assert read_probe(str(tmp_path / "c.pfm"), "latlong", 16, "k").shape == (4, 8, 3)
    (tmp_path / "d.hdr").write_bytes(rgbe())
    np.testing.assert_allclose(read_probe(str(tmp_path / "d.hdr"), "latlong", 16, "k"), 1.0, rtol=0.01)


@pytest.mark.parametrize("scale", [float("inf"), float("nan"), 1e39, 1e30, 1e-40])
def test_a_scale_that_overflows_or_vanishes_is_named(tmp_path, scale):
    (tmp_path / "a.pfm").write_bytes(pfm())
    environment = {"kind": "file", "file": str(tmp_path / "a.pfm"), "mapping": "latlong", "width": 16, "turn": 0}
    with pytest.raises(ProbeError, match=r"^scenes.yaml: mine.environment.scale: "):
        environment_image(environment | {"scale": scale}, "scenes.yaml: mine.environment")


@pytest.mark.parametrize("make", [os.mkfifo, os.mkdir])
@pytest.mark.parametrize("name", ["a.ply", "a.obj", "a.pfm", "a.hdr", "a.exr"])
def test_no_reader_waits_for_a_fifo(tmp_path, name, make):
    make(tmp_path / name)
    mesh = name.endswith(("ply", "obj"))
    with pytest.raises(MeshError if mesh else ProbeError, match="not a regular file"):
        read_mesh(str(tmp_path / name), "k") if mesh else read_probe(str(tmp_path / name), "latlong", 16, "k")


def test_forged_sizes_of_an_exr_allocate_nothing(tmp_path):
    """In a process of its own that may have 3 GB: a data window of 32,000 x 32,000 in a file of some hundred bytes."""
    import OpenEXR

    from brdfatlas.rendering.images import ImageError, load_exr

    path = tmp_path / "a.exr"
    channels = {name: np.ones((4, 8), np.float32) for name in "RGB"}
    OpenEXR.File({"type": OpenEXR.scanlineimage}, channels).write(str(path))
    data = path.read_bytes()
    at = data.index(b"dataWindow\0box2i\0") + 21
    for window in ((0, 0, 31999, 31999), (0, 0, 2**31 - 2, 2**31 - 2), (5, 5, 1, 1), (-(2**31), 0, 2**31 - 1, 3)):
        path.write_bytes(data[:at] + struct.pack("<4i", *window) + data[at + 16 :])
        with pytest.raises(ImageError, match=r"a\.exr: "):
            load_exr(path)


def test_the_process_that_2_to_the_31_killed_lives(tmp_path):
    """The case that ended a process without a word, in a process of its own."""
    (tmp_path / "a.ply").write_bytes(BAD_MESHES["an index of 2^31.ply"])
    code = "import sys; from brdfatlas.rendering.meshes import read_mesh; read_mesh(sys.argv[1], 'key')"
    done = subprocess.run([sys.executable, "-c", code, str(tmp_path / "a.ply")], capture_output=True, text=True)
    assert done.returncode == 1
    assert "MeshError: key: " in done.stderr
