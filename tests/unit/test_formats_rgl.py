"""RGL's isotropic files: a small one of our own making by the same rules, and the real ones where they are."""

import struct
import time

import numpy as np
import pytest

import brdfatlas
from brdfatlas.angles import directions, grid_axes
from brdfatlas.formats import rgl
from brdfatlas.formats.plausibility import mean_albedo
from brdfatlas.measured import MeasuredError

TYPE = {"u1": 1, "u4": 5, "f4": 10, "f8": 11}


def container(fields: dict[str, np.ndarray]) -> bytes:
    """A tensor file of these arrays."""
    directory, body = b"", b""
    size = 18 + sum(2 + len(n) + 11 + 8 * np.ndim(a) for n, a in fields.items())
    for name, array in fields.items():
        array = np.asarray(array)
        directory += struct.pack("<H", len(name)) + name.encode()
        directory += struct.pack("<HBQ", array.ndim, TYPE[array.dtype.str[1:]], size + len(body))
        directory += struct.pack(f"<{array.ndim}Q", *array.shape)
        body += array.tobytes()
    return rgl.MAGIC + b"\1\0" + struct.pack("<I", len(fields)) + directory + body


def tensors(n: int = 3, size: int = 8, colours: int = 6) -> dict[str, np.ndarray]:
    """Fields of a smooth, coloured material."""
    rows, rng = np.linspace(0.2, 1, size), np.random.default_rng(7)
    return {
        "description": np.frombuffer(b"made up", "u1"),
        "phi_i": np.zeros(1, "f4"),
        "theta_i": np.linspace(0, np.pi / 2, n).astype("f4"),
        "sigma": np.ones((2, size), "f4"),
        "ndf": (0.3 + rng.random((2, size))).astype("f4"),
        "vndf": (rows[:, None] * (0.5 + rng.random((1, n, size, size)))).astype("f4"),
        "luminance": np.ones((1, n, colours, colours), "f4"),
        "rgb": (0.2 + rng.random((1, n, 3, colours, colours))).astype("f4"),
        "jacobian": np.ones(1, "u1"),
    }


@pytest.fixture
def path(tmp_path):
    (tmp_path / "made_rgb.bsdf").write_bytes(container(tensors()))
    return tmp_path / "made_rgb.bsdf"


def unit(theta, phi):
    return np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta) + 0 * phi], -1)


def forward(density: np.ndarray, column: float, row: float) -> tuple[float, float]:
    """The place of the unit square that the inverse warp takes to (column, row): by bisection on dense sums of the
    bilinear density itself, so by none of the formulas under test."""
    from scipy.interpolate import RegularGridInterpolator

    n = density.shape[0]
    look_up = RegularGridInterpolator((np.linspace(0, 1, n),) * 2, density)
    fine = np.linspace(0, 1, 2801)
    grid = look_up(np.stack(np.meshgrid(fine, fine, indexing="ij"), -1))

    def solve(line, target):
        sums = np.concatenate([[0], np.cumsum((line[1:] + line[:-1]) / 2)])
        return np.interp(target, sums / sums[-1], fine)

    y = solve(np.trapezoid(grid, fine, axis=1), row)
    return solve(look_up(np.stack([0 * fine + y, fine], -1)), column), y


def test_stored_values_come_back_at_their_own_nodes(path):
    """At a theta_i of the file, where the inverse warp hits a node of rgb: f cos = rgb ndf / (4 sigma)."""
    fields, read = tensors_of(path), rgl.read_tensors(path)
    theta_i = float(fields["theta_i"][1])
    for row, column in [(1, 2), (3, 3), (4, 1), (2, 4)]:
        u = forward(fields["vndf"][0, 1].astype(float), column / 5, row / 5)
        theta_h, phi_h = u[0] ** 2 * np.pi / 2, u[1] * 2 * np.pi - np.pi
        wi, h = unit(theta_i, 0.0), unit(theta_h, phi_h)
        wo = 2 * (wi @ h) * h - wi
        if wo[2] < 0.02 or wi @ h <= 0:
            continue
        ndf = np.interp(u[0], np.linspace(0, 1, 8), (1 - u[1]) * fields["ndf"][0] + u[1] * fields["ndf"][1])
        expected = fields["rgb"][0, 1, :, row, column] * ndf / 4
        np.testing.assert_allclose(rgl.evaluate(read, wi, wo) * wo[2], expected, rtol=2e-3)


def tensors_of(path):
    directory = rgl._directory(path)
    data = path.read_bytes()
    return {
        name: np.frombuffer(data, f.dtype, int(np.prod(f.shape)), f.offset).reshape(f.shape)
        for name, f in directory.items()
    }


def test_mitsubas_measured_plugin_agrees(tmp_path):
    """The plugin reads spectral files: the same tensors, three wavelengths in the place of rgb."""
    mi = pytest.importorskip("mitsuba")
    mi.set_variant("scalar_spectral")
    fields = tensors()
    (tmp_path / "x_rgb.bsdf").write_bytes(container(fields))
    waves = np.array([400.0, 550.0, 700.0], "f4")
    spectral = {k: v for k, v in fields.items() if k != "rgb"} | {"spectra": fields["rgb"], "wavelengths": waves}
    (tmp_path / "x_spec.bsdf").write_bytes(container(spectral))
    plugin = mi.load_dict({"type": "measured", "filename": str(tmp_path / "x_spec.bsdf")})
    read = rgl.read_tensors(tmp_path / "x_rgb.bsdf")
    rng = np.random.default_rng(3)
    checked = 0
    for _ in range(200):
        wi, wo = unit(rng.random(2) * 1.4, rng.random(2) * 2 * np.pi)
        interaction = mi.SurfaceInteraction3f()
        interaction.wi = mi.Vector3f(*map(float, wi))
        interaction.wavelengths = [400.0, 550.0, 700.0, 550.0]
        value = np.array(plugin.eval(mi.BSDFContext(), interaction, mi.Vector3f(*map(float, wo))))[:3]
        np.testing.assert_allclose(rgl.evaluate(read, wi, wo) * wo[2], value, rtol=2e-3, atol=1e-5)
        checked += value.max() > 0
    assert checked > 100


def test_the_grid_is_the_mean_of_both_orders_and_the_name_loses_its_ending(path):
    from brdfatlas.angles import directions, grid_axes

    measured, read = brdfatlas.read(path), rgl.read_tensors(path)
    assert measured.name == "made"
    assert measured.provenance.note == "made up"
    at = (30, 20, 70)
    wi, wo = directions(*(axis.ravel()[i] for axis, i in zip(grid_axes(), at)))
    expected = (rgl.evaluate(read, wi, wo) + rgl.evaluate(read, wo, wi)) / 2
    np.testing.assert_allclose(measured.table[at], expected, rtol=1e-5)


def test_negative_channels_are_colours_out_of_gamut(tmp_path):
    fields = tensors()
    fields["rgb"][:, :, 0] = -0.01
    (tmp_path / "blue.bsdf").write_bytes(container(fields))
    measured = brdfatlas.read(tmp_path / "blue.bsdf")
    assert measured.provenance.shares["out of gamut"] == 1
    assert (measured.table[measured.valid][:, 0] == 0).all()
    assert (measured.table[measured.valid][:, 1:] > 0).all()


def test_what_a_file_does_not_hold_is_not_measured(tmp_path):
    """Incidences beside those of the file, and cells all of whose channels are negative."""
    fields = tensors()
    fields["theta_i"] = np.deg2rad([20, 40, 60]).astype("f4")
    fields["rgb"][:, :, :, :3] *= -1
    (tmp_path / "some.bsdf").write_bytes(container(fields))
    measured = brdfatlas.read(tmp_path / "some.bsdf")
    wi, wo = directions(*(axis[measured.valid] for axis in np.broadcast_arrays(*grid_axes())))
    angles = np.rad2deg(np.arccos(np.stack([wi[:, 2], wo[:, 2]])))
    assert 19 <= angles.min() < 20 < 60 < angles.max() <= 61
    stored = rgl.read_tensors(tmp_path / "some.bsdf")
    exact = rgl.evaluate(stored, wi, wo) + rgl.evaluate(stored, wo, wi)
    assert (exact >= 0).any(-1).all()
    assert any("elsewhere the nearest" in line for line in measured.provenance.warnings)


def test_spectral_files_are_read_in_rgb(tmp_path):
    """Equal values at all wavelengths are grey, of that value."""
    fields = tensors()
    grey = np.repeat(fields["rgb"][:, :, :1], 3, 2)
    (tmp_path / "a.bsdf").write_bytes(container(fields | {"rgb": grey}))
    waves = np.array([400.0, 550.0, 700.0], "f4")
    spectral = {k: v for k, v in fields.items() if k != "rgb"} | {"spectra": grey, "wavelengths": waves}
    (tmp_path / "b.bsdf").write_bytes(container(spectral))
    a, b = (brdfatlas.read(tmp_path / f"{name}.bsdf") for name in "ab")
    np.testing.assert_allclose(a.table, b.table, rtol=1e-4)


def broken():
    """name -> (bytes, words of the message)."""
    fields, whole = tensors(), container(tensors())
    bad = fields["rgb"].copy()
    bad[0, 0, 0, 0, 0] = np.nan
    lying = bytearray(whole)
    at = lying.index(b"vndf") + 4 + 11
    lying[at + 8 : at + 16] = struct.pack("<Q", 1 << 60)
    return {
        "empty": (b"", "empty|does not begin"),
        "magic": (b"X" + whole[1:], "does not begin"),
        "truncated": (whole[:-100], "truncated"),
        "header only": (whole[:30], "truncated"),
        "no rgb": (container({k: v for k, v in fields.items() if k != "rgb"}), "no field 'rgb'"),
        "no vndf": (container({k: v for k, v in fields.items() if k != "vndf"}), "no field 'vndf'"),
        "nan": (container(fields | {"rgb": bad}), "NaN or Inf"),
        "type": (container(fields | {"sigma": np.ones((2, 8), "u4")}), "floating point"),
        "shape": (container(fields | {"rgb": np.ones((1, 2, 3, 6, 6), "f4")}), "shape"),
        "anisotropic": (container(fields | {"phi_i": np.zeros(4, "f4")}), "anisotropic"),
        "degrees": (container(fields | {"theta_i": np.array([0, 45, 90], "f4")}), "radians"),
        "negative": (container(fields | {"vndf": -fields["vndf"]}), "negative"),
        "black": (container(fields | {"rgb": 0 * fields["rgb"]}), "black"),
        "huge": (container(fields | {"rgb": 1e30 * fields["rgb"]}), "the most accepted"),
        "no area": (container(fields | {"sigma": np.eye(2, 8, 7, "f4")}), "field 'sigma' is 0 at some angle"),
        "overflow": (container(fields | {"vndf": np.full(fields["vndf"].shape, 1e308)}), "'vndf' holds 1e\\+308"),
        "lying": (bytes(lying), "truncated"),
    }


@pytest.mark.parametrize("name", list(broken()))
def test_broken_files_get_one_line(tmp_path, name):
    data, words = broken()[name]
    path = tmp_path / "broken.bsdf"
    path.write_bytes(data)
    with pytest.raises(MeasuredError, match=words) as caught:
        brdfatlas.read(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_random_damage_is_refused_or_read(tmp_path):
    """2,000 files with random bytes at random places: a material or one line, nothing else."""
    whole, rng = container(tensors(2, 4, 3)), np.random.default_rng(11)
    path = tmp_path / "x.bsdf"
    refused = 0
    for case in range(2000):
        data = bytearray(whole)
        end = 450 if case % 2 else len(data)  # half of them in the list of fields
        for at in rng.integers(0, end, rng.integers(1, 6)):
            data[at] = rng.integers(256)
        path.write_bytes(data[: len(data) - (rng.integers(len(data)) if case % 7 == 0 else 0)])
        try:
            rgl.check(path)
        except MeasuredError as error:
            refused += len(str(error).splitlines()) == 1
    assert refused > 500


@pytest.mark.parametrize("name", ["aurora_white", "chm_orange", "ilm_solo_m_68", "irid_flake_paint1", "vch_silk_blue"])
def test_real_files(shared, name):
    """Real measurements: reciprocal within their noise, no more light than arrives, within seconds."""
    path = shared / "data" / "rgl" / f"{name}_rgb.bsdf"
    rgl.read(path)
    start = time.process_time()
    measured = brdfatlas.read(path)
    print(f"{name}: {time.process_time() - start:.2f} s")
    assert measured.name == name
    assert measured.valid.sum() > 900_000
    assert measured.table[measured.valid].min() >= 0
    assert (mean_albedo(measured.table) < 1).all()
    read, rng = rgl.read_tensors(path), np.random.default_rng(5)
    wi, wo = (
        unit(rng.random(3000) * 1.1, rng.random(3000) * 6.28),
        unit(rng.random(3000) * 1.1, rng.random(3000) * 6.28),
    )
    one, other = rgl.evaluate(read, wi, wo).sum(-1), rgl.evaluate(read, wo, wi).sum(-1)
    gap = np.abs(one - other) / np.maximum(np.abs(one + other) / 2, 1e-4)
    assert np.median(gap) < 0.2  # noise of two measurements; a wrong order of axes gives 0.5 and more
