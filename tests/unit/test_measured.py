"""Reading and writing MERL files, every kind of damage, and looking up between cells."""

import os

import numpy as np
import pytest

from brdfatlas import read_merl
from brdfatlas.angles import GRID_SHAPE, above_horizon, directions, grid_axes, half_difference
from brdfatlas.formats.merl import FILE_BYTES, HEADER_BYTES, SCALE, write_merl
from brdfatlas.formats.plausibility import suspicions
from brdfatlas.measured import N_CELLS, Measured, MeasuredError, extend, extension_index, look_up


@pytest.fixture(scope="module")
def table():
    """Smooth, coloured, positive, NaN below the horizon."""
    theta_h, theta_d, phi_d = grid_axes()
    base = 0.2 + np.exp(-((theta_h / 0.3) ** 2)) + 0.1 * theta_d**2 + 0.05 * np.sin(2 * phi_d) ** 2
    values = (base[..., None] * [1.0, 0.5, 0.25]).astype(np.float32)
    values[~above_horizon()] = np.nan
    return values


@pytest.fixture
def path(tmp_path, table):
    write_merl(tmp_path / "smooth.binary", table)
    return tmp_path / "smooth.binary"


def damage(path, offset, value):
    with open(path, "r+b") as handle:
        handle.seek(offset)
        handle.write(value)


def test_round_trip(path, table):
    measured = read_merl(path)
    assert measured.name == "smooth"
    assert not measured.standin
    assert path.stat().st_size == FILE_BYTES
    np.testing.assert_allclose(measured.table, table, rtol=1e-6)
    np.testing.assert_array_equal(measured.valid, above_horizon())


def test_layout_is_planar_with_phi_fastest(path, table):
    stored = np.fromfile(path, "<f8", offset=HEADER_BYTES)
    index = 7 + 180 * (5 + 90 * 3)
    for channel in range(3):
        assert stored[channel * N_CELLS + index] * SCALE[channel] == pytest.approx(table[3, 5, 7, channel], rel=1e-6)


def test_a_cell_is_invalid_only_if_all_channels_are_negative(path):
    """A single negative channel is a colour outside the gamut: 0, counted, and no reason to throw the cell away."""
    one = HEADER_BYTES + 8 * 90
    damage(path, one + 16 * N_CELLS, np.array([-0.001], "<f8").tobytes())
    measured = read_merl(path)
    assert measured.table[0, 0, 90, 2] == 0
    assert (measured.table[0, 0, 90, :2] > 0).all()
    np.testing.assert_array_equal(measured.valid, above_horizon())
    assert measured.provenance.shares["out of gamut"] == pytest.approx(1 / above_horizon().sum())
    for channel in range(3):
        damage(path, one + 8 * channel * N_CELLS, np.array([-0.001], "<f8").tobytes())
    measured = read_merl(path)
    assert np.isnan(measured.table[0, 0, 90]).all()
    assert measured.valid.sum() == above_horizon().sum() - 1


def test_measured_can_be_compared(path, table):
    """Equal by name, kind and values; a comparison of arrays raises nothing."""
    one, other = read_merl(path), read_merl(path)
    assert one == other
    assert hash(one) == hash(other)
    assert one != Measured("other", one.table)
    assert one != Measured("smooth", one.table, standin=True)
    assert one != Measured("smooth", np.nan_to_num(one.table))
    assert one != "smooth"


@pytest.mark.parametrize(
    ("offset", "value", "fault"),
    [
        (0, np.array([90, 90, 360], "<i4").tobytes(), "wrong dimensions"),
        (HEADER_BYTES + 800, np.array([np.nan], "<f8").tobytes(), "NaN or Inf"),
        (HEADER_BYTES + 800, np.array([np.inf], "<f8").tobytes(), "NaN or Inf"),
        (FILE_BYTES, b"\0" * 5, "over-long"),
        (HEADER_BYTES, np.full(3 * N_CELLS, -1.0).tobytes(), "no valid cell"),
    ],
)
def test_damage_is_named(path, offset, value, fault):
    damage(path, offset, value)
    with pytest.raises(MeasuredError, match=fault) as caught:
        read_merl(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("size", [0, 11, 12, FILE_BYTES - 1])
def test_truncation_is_named(path, size):
    os.truncate(path, size)
    with pytest.raises(MeasuredError, match="truncated"):
        read_merl(path)


def test_not_a_file(tmp_path):
    (tmp_path / "folder.binary").mkdir()
    os.mkfifo(tmp_path / "pipe.binary")
    for name in ("folder", "pipe"):
        with pytest.raises(MeasuredError, match="not a regular file"):
            read_merl(tmp_path / f"{name}.binary")
    with pytest.raises(MeasuredError, match="no such file"):
        read_merl(tmp_path / "absent.binary")


@pytest.mark.skipif(os.geteuid() == 0, reason="root may read everything")
def test_unreadable(path):
    path.chmod(0)
    with pytest.raises(MeasuredError, match="cannot be read"):
        read_merl(path)


def test_write_leaves_no_half_file(tmp_path, monkeypatch, table):
    monkeypatch.setattr(np, "moveaxis", lambda *a: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        write_merl(tmp_path / "x.binary", table)
    assert list(tmp_path.iterdir()) == []


def test_extension_is_the_nearest_valid_cell_in_phi(table):
    rng = np.random.default_rng(4)
    valid = above_horizon() & (rng.random(GRID_SHAPE) < 0.3)
    index = extension_index(valid)
    flat = valid.ravel()
    assert flat[index].all()
    for h, d, p in rng.integers(0, [90, 90, 180], (200, 3)):
        row = np.flatnonzero(valid[h, d])
        if row.size == 0:
            continue
        gap = np.abs(row - p)
        source = index[h, d, p] - (h * 90 + d) * 180
        assert min(abs(source - p), 180 - abs(source - p)) == np.minimum(gap, 180 - gap).min()


def test_extension_of_an_empty_row_comes_from_a_neighbour_and_of_nothing_fails(table):
    valid = above_horizon().copy()
    valid[10, 20] = False
    assert np.isfinite(extend(table, valid)).all()
    with pytest.raises(ValueError, match="no valid cell"):
        extension_index(np.zeros(GRID_SHAPE, bool))


def test_look_up_hits_cell_centres_and_is_reciprocal(table):
    full = extend(table, above_horizon())
    rng = np.random.default_rng(5)
    h, d, p = rng.integers(0, [60, 60, 180], (500, 3)).T
    theta_h, theta_d, phi_d = (axis.ravel() for axis in grid_axes())
    wi, wo = directions(theta_h[h], theta_d[d], phi_d[p])
    inside = (wi[:, 2] > 0) & (wo[:, 2] > 0)
    np.testing.assert_allclose(look_up(full, wi, wo)[inside], full[h, d, p][inside], rtol=1e-5)
    np.testing.assert_allclose(look_up(full, wi, wo), look_up(full, wo, wi), rtol=1e-5)


def test_look_up_equals_an_independent_interpolator(table):
    """scipy's regular-grid interpolator on the same cell coordinates, phi_d padded periodically."""
    from scipy.interpolate import RegularGridInterpolator

    full = extend(table, above_horizon()).astype(float)
    padded = np.concatenate([full[:, :, -1:], full, full[:, :, :1]], 2)
    slow = RegularGridInterpolator((np.arange(90), np.arange(90), np.arange(-1, 181)), padded)
    rng = np.random.default_rng(6)
    wi, wo = rng.normal(size=(2, 400, 3))
    wi[:, 2], wo[:, 2] = np.abs(wi[:, 2]), np.abs(wo[:, 2])
    wi, wo = (w / np.linalg.norm(w, axis=1, keepdims=True) for w in (wi, wo))
    theta_h, theta_d, phi_d = half_difference(wi, wo)
    at = np.stack([np.sqrt(theta_h / (np.pi / 2)) * 90, theta_d / (np.pi / 2) * 90, phi_d / np.pi * 180], -1) - 0.5
    at[:, :2] = np.clip(at[:, :2], 0, 89)
    np.testing.assert_allclose(look_up(full, wi, wo), slow(at), rtol=1e-9)


def test_nothing_below_the_surface(table):
    up, down = np.array([0, 0, 1.0]), np.array([0.6, 0, -0.8])
    assert (look_up(extend(table, above_horizon()), up, down) == 0).all()


def variant(path, shape, order="<"):
    """A file of another shape of the function 0.1 + 0.05 cos(phi_d) + 0.1 theta_d, below the horizon as well."""
    n_h, n_d, n_p = shape
    phi = (np.arange(n_p) + 0.5) / n_p * np.pi * (2 if n_p == 4 * n_d else 1)
    theta_d = (np.arange(n_d) + 0.5) / n_d * np.pi / 2
    values = (0.1 + 0.05 * np.cos(phi) + 0.1 * theta_d[:, None] + np.zeros((n_h, 1, 1)))[..., None] / SCALE
    with open(path, "wb") as handle:
        np.array(shape, f"{order}i4").tofile(handle)
        np.moveaxis(values, -1, 0).astype(f"{order}f8").tofile(handle)


@pytest.mark.parametrize(
    ("shape", "order", "word"),
    [
        ((90, 90, 360), "<", "mean of both orders"),
        ((45, 60, 240), "<", "resampled"),
        ((90, 90, 360), ">", "big-endian"),
    ],
)
def test_variants_are_read_with_a_word(tmp_path, shape, order, word):
    """On the full circle both orders are averaged, so the part that is not reciprocal, the cosine, goes away."""
    variant(tmp_path / "v.binary", shape, order)
    measured = read_merl(tmp_path / "v.binary")
    assert any(word in warning for warning in measured.provenance.warnings)
    assert not any("were measured" in warning for warning in measured.provenance.warnings)
    np.testing.assert_array_equal(measured.valid & ~above_horizon(), False)
    assert measured.valid.sum() > 0.98 * above_horizon().sum()
    expected = np.broadcast_to(0.1 + 0.1 * grid_axes()[1], GRID_SHAPE)
    inner = measured.valid & (grid_axes()[1] > 0.02) & (grid_axes()[1] < 1.5)
    both = np.isfinite(measured.table[:, :, ::-1, 0]) & inner
    # beside the horizon a resampled cell has fewer neighbours to be interpolated between
    tolerance = 1e-2 if word == "resampled" else 1e-4
    np.testing.assert_allclose(measured.table[both][:, 1], expected[both], rtol=tolerance)


def test_what_is_suspicious_is_said(tmp_path, table):
    for factor, word in [(1500.0, "unscaled"), (1 / 1500, "scaled twice"), (8.0, "more light"), (1.0, "")]:
        write_merl(tmp_path / "s.binary", (table / 4 * factor).astype(np.float32))
        warnings = " ".join(read_merl(tmp_path / "s.binary").provenance.warnings)
        assert word in warnings if word else not warnings


def test_a_highlight_measured_alone_does_not_reflect_more_light_than_arrives():
    table = np.full((*GRID_SHAPE, 3), np.nan, np.float32)
    table[:20][above_horizon()[:20]] = 1.0  # within 4.4 degrees of the mirror direction, black elsewhere: albedo 0.02
    assert not any("more light" in told for told in suspicions(table))


@pytest.mark.parametrize(("first", "told"), [(0, False), (40, False), (100, True), (179, True)])
def test_a_table_that_is_mostly_not_measured_says_so(tmp_path, table, first, told):
    table = (table / 4).astype(np.float32)
    table[:, :, :first] = np.nan
    write_merl(tmp_path / "s.binary", table)
    warnings = read_merl(tmp_path / "s.binary").provenance.warnings
    assert any("of the cells above the horizon were measured" in warning for warning in warnings) == told


def test_reversed_numbers_are_suspected(path):
    """Big-endian numbers behind a little-endian header."""
    stored = np.fromfile(path, "<f8", offset=HEADER_BYTES)
    damage(path, HEADER_BYTES, stored.astype(">f8").tobytes())
    with pytest.raises(MeasuredError, match="big-endian"):
        read_merl(path)


def test_kinds_are_told_apart(tmp_path, table):
    for options, kind in [
        ({}, "measured"),
        ({"reconstructed": True}, "reconstructed"),
        ({"standin": True}, "stand-in"),
    ]:
        write_merl(tmp_path / "k.binary", table, **options)
        assert read_merl(tmp_path / "k.binary").kind == kind


def test_random_damage_is_refused(tmp_path):
    """2,000 headers of random bytes before a short body: one line each, and no allocation from a header that lies."""
    path, rng = tmp_path / "x.binary", np.random.default_rng(1)
    for _ in range(2000):
        header = bytearray(np.array([90, 90, 180], "<i4").tobytes())
        for at in rng.integers(0, 12, rng.integers(0, 5)):
            header[at] = rng.integers(256)
        path.write_bytes(bytes(header) + rng.bytes(int(rng.integers(200))))
        with pytest.raises(MeasuredError) as caught:
            read_merl(path)
        assert len(str(caught.value).splitlines()) == 1
