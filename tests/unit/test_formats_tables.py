"""Spectral text, tables and what lies between their samples; broken ones of every kind."""

import os
import pickle
from dataclasses import replace

import numpy as np
import pytest

import brdfatlas
from brdfatlas import formats
from brdfatlas.angles import GRID_SHAPE, above_horizon, directions, grid_axes, half_difference
from brdfatlas.formats import scattered, spectral, stored, tables
from brdfatlas.formats.colour import rgb_weights
from brdfatlas.formats.plausibility import mean_albedo
from brdfatlas.measured import Measured, MeasuredError, Provenance

WAVES = np.arange(400, 701, 50)


def unit(theta, phi):
    return np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta) + 0 * phi], -1)


def ggx(alpha: float, diffuse: float, f0: float):
    """A reciprocal function f(wi, wo): Lambert and one lobe."""

    def f(wi, wo):
        theta_h, theta_d, _ = half_difference(wi, wo)
        cos_i, cos_o = wi[..., 2], wo[..., 2]
        ndf = alpha**2 / (np.pi * (np.cos(theta_h) ** 2 * (alpha**2 - 1) + 1) ** 2)
        smith = [(-1 + np.sqrt(1 + alpha**2 * (1 / c**2 - 1))) / 2 for c in (cos_i, cos_o)]
        fresnel = f0 + (1 - f0) * (1 - np.cos(theta_d)) ** 5
        return diffuse / np.pi + ndf * fresnel / (1 + sum(smith)) / (4 * cos_i * cos_o)

    return f


def cornell_like() -> tuple[np.ndarray, np.ndarray]:
    """Angles (n, 4), radians, as of a Cornell file: eight incidences, rings of 180 directions on one side."""
    rows = []
    for theta_i in np.deg2rad(np.arange(10, 81, 10)):
        rows.append((theta_i, 0.0, 0.0, 0.0))
        for ring, theta_o in enumerate(np.deg2rad([8.1, 16.3, 24.5, 32.9, 41.4, 50.2, 59.3, 68.9, 79.0]), 1):
            rows += [(theta_i, 0.0, theta_o, phi) for phi in np.linspace(-np.pi, 0, 4 * ring + 1)]
    angles = np.array(rows)
    return unit(angles[:, 0], angles[:, 1]), unit(angles[:, 2], angles[:, 3])


def write_spectral(path, wi, wo, values):
    """Equal values at all wavelengths."""
    lines = ["# made up", str(len(WAVES)), " ".join(map(str, WAVES))]
    for i, o, value in zip(wi, wo, values):
        angles = [np.arccos(i[2]), np.arctan2(i[1], i[0]), np.arccos(min(o[2], 1)), np.arctan2(o[1], o[0])]
        lines.append(" ".join(f"{x:.8g}" for x in [*angles, *[value] * len(WAVES)]))
    path.write_text("\n".join(lines) + "\n")


@pytest.fixture(scope="module")
def grid():
    return directions(*np.broadcast_arrays(*grid_axes()))


@pytest.mark.parametrize(
    ("alpha", "diffuse", "f0"), [(0.1, 0.2, 0.04), (0.3, 0.05, 0.04), (0.4, 0.0, 0.9), (1, 0.3, 0)]
)
def test_known_functions_come_back(tmp_path, grid, alpha, diffuse, f0):
    """Sampled at a gonioreflectometer's 1,500 directions; 5 % in the median away from the highlight is the promise, a
    spline does better."""
    f, (wi, wo) = ggx(alpha, diffuse, f0), cornell_like()
    write_spectral(tmp_path / "known.brdf", wi, wo, f(wi, wo))
    measured = brdfatlas.read(tmp_path / "known.brdf")
    valid = measured.valid
    assert valid.sum() > 0.7 * above_horizon().sum()
    away = valid & (half_difference(*grid)[0] > np.deg2rad(15))
    error = np.abs(measured.table[away] / f(grid[0][away], grid[1][away])[:, None] - 1)
    assert np.median(error) < 0.01
    assert np.quantile(error, 0.95) < 0.1
    # reciprocity and mirror: phi_d, phi_d + pi and -phi_d are one
    np.testing.assert_array_equal(measured.table, measured.table[:, :, ::-1])
    assert measured.samples.shape == (len(wi), 3)
    assert np.array_equal(np.isnan(measured.distance), ~valid)
    assert np.nanmax(measured.distance) < 25


def test_nothing_is_invented_outside_the_hull(tmp_path, grid):
    wi, wo = cornell_like()
    keep = (wi[:, 2] > np.cos(np.deg2rad(45))) & (wo[:, 2] > np.cos(np.deg2rad(55)))
    write_spectral(tmp_path / "part.brdf", wi[keep], wo[keep], ggx(0.3, 0.2, 0.04)(wi, wo)[keep])
    valid = brdfatlas.read(tmp_path / "part.brdf").valid
    largest = np.rad2deg(np.arccos(np.clip(np.minimum(grid[0][..., 2], grid[1][..., 2]), -1, 1)))
    assert valid.any()
    assert largest[valid].max() < 55  # the widest ring is at 50.2, a degree of margin, and cells beside it


def test_regular_tables_are_exact_at_their_nodes(tmp_path):
    wi, wo = tables.regular_directions(15.0)
    values = ggx(0.3, 0.2, 0.5)(wi, wo)[:, None] * [1.0, 0.6, 0.0]
    samples = scattered.Samples(wi, wo, values, np.arange(len(wi)))
    table = scattered.regular(samples)
    assert table is not None
    np.testing.assert_allclose(scattered._joined(table(wi, wo)), values, rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(scattered._joined(table(wo, wi)), values, rtol=1e-6, atol=1e-12)
    tables.write_csv(tmp_path / "x.csv", wi, wo, values, "measured", "x")
    assert "regular table" in " ".join(brdfatlas.read(tmp_path / "x.csv").provenance.warnings)


@pytest.mark.parametrize(
    ("head", "factor"),
    [
        ("# values: f", lambda wo: 1.0),
        ("# values: f cos", lambda wo: wo[:, 2]),
        ("# values are f·cos theta_o", lambda wo: wo[:, 2]),
        ("# values: reflectance factor", lambda wo: np.pi),
        ("# Values: pi f", lambda wo: np.pi),
    ],
)
@pytest.mark.parametrize("shape", ["degrees", "radians", "vectors"])
def test_headers_and_columns_mean_what_they_say(tmp_path, head, factor, shape):
    """One function, written in every way, is read as the same samples."""
    wi, wo = cornell_like()
    values = ggx(0.3, 0.2, 0.04)(wi, wo)
    theta_o, phi_o = np.arccos(np.minimum(wo[:, 2], 1)), np.arctan2(wo[:, 1], wo[:, 0])
    angles = np.stack([np.arccos(wi[:, 2]), 0 * values, theta_o, phi_o], 1)
    columns = {"degrees": np.rad2deg(angles), "radians": angles, "vectors": np.concatenate([wi, wo], 1)}[shape]
    names = "wi_x;wi_y;wi_z;wo_x;wo_y;wo_z;value" if shape == "vectors" else "theta_i;phi_i;theta_o;phi_o;value"
    comment = "# angles: radians\n" if shape == "radians" else ""
    rows = np.concatenate([columns, (values * factor(wo))[:, None]], 1)
    path = tmp_path / "x.csv"
    np.savetxt(path, rows, "%.10g", ";", header=f"{head}\n{comment}{names}", comments="")
    samples = tables._load(path)[0]
    np.testing.assert_allclose(samples.wo, wo, atol=1e-7)
    np.testing.assert_allclose(samples.values, np.repeat(values[:, None], 3, 1), rtol=1e-5)


def test_a_table_without_a_word_on_its_values_is_read_with_one(tmp_path):
    wi, wo = tables.regular_directions(30.0)
    tables.write_csv(tmp_path / "x.csv", wi, wo, np.ones((len(wi), 3)), "measured", "x")
    text = (tmp_path / "x.csv").read_text()
    (tmp_path / "y.csv").write_text(text.replace("# values: f\n", ""))
    assert any("does not say" in w for w in brdfatlas.read(tmp_path / "y.csv").provenance.warnings)


def test_colours():
    """Flat spectra are grey; a red one is red; the white of D65 needs no library of ours."""
    weights = rgb_weights(WAVES)
    np.testing.assert_allclose(weights.sum(0), 1, atol=1e-12)
    red = (WAVES > 620) @ weights
    assert red[0] > 0 > red[1]
    with pytest.raises(ValueError, match="rise"):
        rgb_weights(WAVES[::-1])
    with pytest.raises(ValueError, match="in nm"):
        rgb_weights(WAVES / 1000)


def test_what_is_stored_is_what_was_read(tmp_path):
    rng = np.random.default_rng(2)
    table = rng.random((*GRID_SHAPE, 3)).astype(np.float32)
    table[~above_horizon()] = np.nan
    about = Provenance("RGL", "here", "ours", "a note", "reconstructed", {"out of gamut": 0.25}, ("one", "two"))
    measured = Measured("m", table, False, tmp_path / "m.bsdf", about, table[..., 0], rng.random((7, 3)))
    stored.write(tmp_path / "m.measured", measured)
    again = brdfatlas.read(tmp_path / "m.measured")
    assert again == measured
    assert (again.provenance, again.path) == (about, measured.path)
    np.testing.assert_array_equal(again.distance, measured.distance)
    np.testing.assert_allclose(again.samples, measured.samples, rtol=1e-6)
    whole = (tmp_path / "m.measured").read_bytes()
    for data in (
        whole[:-4],
        whole[:40],
        whole.replace(b'"shapes"', b'"shapez"', 1),
        whole.replace(b"[90, 90", b"[99, 90", 1),
    ):
        (tmp_path / "b.measured").write_bytes(data)
        with pytest.raises(MeasuredError, match="again"):
            brdfatlas.read(tmp_path / "b.measured")


def csv_text(**changes) -> list[str]:
    wi, wo = cornell_like()
    wi, wo = wi[::9], wo[::9]
    values = ggx(0.3, 0.2, 0.04)(wi, wo)
    lines = ["# values: f", "theta_i,phi_i,theta_o,phi_o,r,g,b"]
    for i, o, v in zip(wi, wo, values):
        angles = np.rad2deg([np.arccos(i[2]), 0, np.arccos(min(o[2], 1)), np.arctan2(o[1], o[0])])
        lines.append(",".join(f"{x:.8g}" for x in [*angles, v, v, v]))
    return lines


def spectral_text() -> list[str]:
    lines = [line.split(",") for line in csv_text()[2:]]
    rows = [[*np.deg2rad(np.array(cells[:4], float)), *[float(cells[4])] * len(WAVES)] for cells in lines]
    return [str(len(WAVES)), " ".join(map(str, WAVES)), *(" ".join(f"{x:.8g}" for x in row) for row in rows)]


def with_line(lines, number, text):
    return [*lines[: number - 1], text, *lines[number:]]


CSV, TEXT = csv_text(), spectral_text()
CELLS = CSV[9].split(",")
WORDS = TEXT[9].split()
BROKEN_CSV = {
    "empty": ([], "no line with the names"),
    "no rows": (CSV[:2], "no row"),
    "truncated": ([*CSV[:40], CSV[40][:20]], "line 41: .* cells"),
    "missing column": (with_line(CSV, 2, "theta_i,phi_i,theta_o,azimuth,r,g,b"), "no column phi_o"),
    "missing value": (with_line(CSV, 2, "theta_i,phi_i,theta_o,phi_o,u,v,w"), "no column of values"),
    "one channel": (with_line(CSV, 2, "theta_i,phi_i,theta_o,phi_o,r,x,z"), "only r"),
    "text": (with_line(CSV, 10, ",".join([*CELLS[:4], "abc", *CELLS[5:]])), "line 10: 'abc' is not a number; correct"),
    "nan": (with_line(CSV, 10, ",".join([*CELLS[:4], "nan", *CELLS[5:]])), "line 10: NaN"),
    "below": (with_line(CSV, 10, ",".join(["95", *CELLS[1:]])), "line 10: .*below the surface"),
    "disagree": ([*CSV, ",".join([*CELLS[:4], "9", "9", "9"])], "lines 10 and .*different values"),
    "radians": ([*CSV[:2], *(",".join(f"{float(c) / 57.3:g}" for c in r.split(",")) for r in CSV[2:])], "radians"),
    "degrees": (["# angles: radians", *CSV], "degrees"),
    "unit": (with_line(CSV, 1, "# values: furlongs"), "line 1: .*furlongs|line 1: values"),
    "huge": (with_line(CSV, 10, ",".join([*CELLS[:4], "1e30", "1", "1"])), "most accepted"),
    "few": (CSV[:8], "at least 20"),
    "black": ([*CSV[:2], *(",".join([*r.split(",")[:4], "0", "0", "0"]) for r in CSV[2:])], "black"),
    "plane": ([*CSV[:2], *(f"{t},0,{o},0,1,1,1" for t in range(10, 60, 10) for o in range(0, 70, 10))], "one plane"),
}
BROKEN_TEXT = {
    "empty": ([], "number of wavelengths"),
    "count": (["0", *TEXT[1:]], "number of wavelengths"),
    "count too large": (["9", *TEXT[1:]], "rise|no rows"),
    "truncated": ([*TEXT[:40], TEXT[40][:30]], "no rows"),
    "falling": (with_line(TEXT, 2, " ".join(map(str, WAVES[::-1]))), "rise"),
    "micrometres": (with_line(TEXT, 2, " ".join(str(w / 1000) for w in WAVES)), "nm"),
    "text": (with_line(TEXT, 10, " ".join([*WORDS[:5], "abc", *WORDS[6:]])), "line 10: 'abc' is not a number; correct"),
    "comma": (with_line(TEXT, 10, " ".join([*WORDS[:5], "0,1", *WORDS[6:]])), "line 10: '0,1' .*; write .* a point"),
    "nan": (with_line(TEXT, 10, " ".join([*WORDS[:5], "nan", *WORDS[6:]])), "line 10"),
    "below": (with_line(TEXT, 10, " ".join(["1.6", *WORDS[1:]])), "line 10: .*below the surface"),
    "degrees": (with_line(TEXT, 10, " ".join(["50", *WORDS[1:]])), "line 10: .*degrees"),
    "disagree": ([*TEXT, " ".join([*WORDS[:4], *["9"] * len(WAVES)])], "lines 10 and .*different values"),
    "huge": (with_line(TEXT, 10, " ".join([*WORDS[:4], *["1e30"] * len(WAVES)])), "most accepted"),
}


@pytest.mark.parametrize(
    ("ending", "lines", "words"),
    [
        *(pytest.param(".csv", *case, id=f"csv {name}") for name, case in BROKEN_CSV.items()),
        *(pytest.param(".brdf", *case, id=f"text {name}") for name, case in BROKEN_TEXT.items()),
    ],
)
def test_broken_files_get_one_line(tmp_path, ending, lines, words):
    path = tmp_path / f"broken{ending}"
    path.write_text("".join(f"{line}\n" for line in lines))
    for read in (brdfatlas.read, formats.check):
        with pytest.raises(MeasuredError, match=words) as caught:
            read(path)
        assert str(path) in str(caught.value)
        assert len(str(caught.value).splitlines()) == 1


@pytest.mark.parametrize(("module", "lines"), [(tables, CSV), (spectral, TEXT)], ids=["csv", "text"])
def test_random_damage_is_refused_or_read(tmp_path, module, lines):
    """2,000 files with random bytes at random places: samples or one line, nothing else."""
    whole, rng = "\n".join(lines).encode(), np.random.default_rng(3)
    path = tmp_path / "x"
    refused = 0
    for case in range(2000):
        data = bytearray(whole)
        for at in rng.integers(0, 200 if case % 2 else len(data), rng.integers(1, 6)):
            data[at] = rng.integers(256) if case % 3 else rng.choice(list(b"0123456789.,;- #e\n"))
        path.write_bytes(data[: len(data) - (rng.integers(len(data)) if case % 7 == 0 else 0)])
        try:
            module.check(path)
        except MeasuredError as error:
            refused += len(str(error).splitlines()) == 1
    assert refused > 500


def test_what_is_no_measurement_is_called_so(tmp_path):
    for name, data, words in [
        ("a.gz", b"\x1f\x8b\x08\0", "gunzip"),
        ("a.zip", b"PK\3\4" + bytes(40), "unpack"),
        ("a.csv", b"\x1f\x8b\x08\0", "gunzip"),
        ("a.binary", b"\x1f\x8b\x08\0" + bytes(40), "gunzip"),
        ("a.bsdf", b"PK\3\4" + bytes(40), "unpack"),
        ("a.png", b"\x89PNG\r\n", "no file of measured reflectance"),
        ("empty", b"", "empty"),
    ]:
        (tmp_path / name).write_bytes(data)
        with pytest.raises(MeasuredError, match=words):
            brdfatlas.read(tmp_path / name)
    os.mkfifo(tmp_path / "pipe.csv")
    with pytest.raises(MeasuredError, match="not a regular file"):
        brdfatlas.read(tmp_path / "pipe.csv")


def test_single_pairs_and_what_is_none_have_a_place_beside_samples(tmp_path):
    wi, wo = tables.regular_directions(20)
    tables.write_csv(tmp_path / "a.csv", wi, wo, 0.2 + 0.1 * wi * wo, "measured", "f")
    measured = brdfatlas.read(tmp_path / "a.csv")
    assert np.isfinite(measured.evaluate_measured(wi[-1], wo[-1])).all()
    assert measured.evaluate_measured(wi[-1], wo[-1]).shape == (3,)
    assert np.isnan(measured.evaluate_measured(np.nan * wi, wo)).all()


def test_samples_are_put_in_order_once_for_all_questions(tmp_path, monkeypatch):
    """By each Measured for itself: one with other samples, or a copy, answers for its own."""
    import scipy.spatial

    wi, wo = tables.regular_directions(20)
    tables.write_csv(tmp_path / "a.csv", wi, wo, 0.2 + 0.1 * wi * wo, "measured", "f")
    measured = brdfatlas.read(tmp_path / "a.csv")
    for name in ("table", "distance", "samples"):
        getattr(measured, name).flags.writeable = False
    made, build = [], scipy.spatial.cKDTree
    monkeypatch.setattr(scipy.spatial, "cKDTree", lambda points: made.append(len(points)) or build(points))
    known = np.isfinite(measured.evaluate_measured(wi, wo))
    for _ in range(3):
        assert np.array_equal(np.isfinite(measured.evaluate_measured(wi, wo)), known)
    assert made == [len(measured.samples)]
    copy = pickle.loads(pickle.dumps(measured))
    assert copy == measured
    assert np.array_equal(np.isfinite(copy.evaluate_measured(wi, wo)), known)
    assert known.all()
    assert not np.isfinite(replace(measured, samples=measured.samples[:1]).evaluate_measured(wi, wo)).all()


def test_a_table_keeps_its_pairs_whatever_often_it_is_converted(tmp_path):
    """Those at the edge of what was measured among them, where most cells around have no value."""
    from brdfatlas.cli import main

    source = tmp_path / "0.csv"
    wi, wo = tables.regular_directions(20)
    tables.write_csv(source, wi, wo, 0.2 + 0.1 * wi * wo, "measured", "f")
    for count in range(1, 3):
        output = tmp_path / f"{count}.csv"
        assert main(["convert", str(source), "-o", str(output), "--like", str(tmp_path / "0.csv")]) == 0
        rows = [[line.split(",")[:4] for line in path.read_text().splitlines()[4:]] for path in (source, output)]
        np.testing.assert_allclose(np.array(rows[0], float), np.array(rows[1], float), atol=1e-6)
        source = output


def test_pairs_that_are_there_twice_are_worth_a_word_where_their_values_differ(tmp_path):
    """A regular table names the pair of two normals once for each azimuth."""
    wi, wo = tables.regular_directions(20)
    values = np.full((len(wi), 3), 0.2)
    for change, told in ((1.0, False), (1.01, True)):
        values[0] *= change
        tables.write_csv(
            tmp_path / "m.csv",
            np.concatenate([wi, wi[:1]]),
            np.concatenate([wo, wo[:1]]),
            np.concatenate([values, [[0.2] * 3]]),
            "measured",
            "f",
        )
        assert any("averaged" in note for note in brdfatlas.read(tmp_path / "m.csv").provenance.warnings) is told


def test_convert_to_a_table_and_back(tmp_path):
    """A fit of Lambert's kind on a chosen set of directions is read as a reconstruction of the same values."""
    from brdfatlas.cli import main

    wi, wo = cornell_like()
    write_spectral(tmp_path / "grey.brdf", wi, wo, np.full(len(wi), 0.1))
    assert main(["convert", str(tmp_path / "grey.brdf"), "-o", str(tmp_path / "grey.binary")]) == 0
    again = brdfatlas.read(tmp_path / "grey.binary")
    np.testing.assert_allclose(again.table[again.valid], 0.1, rtol=1e-3)
    like = ["--like", str(tmp_path / "grey.brdf")]
    assert main(["convert", str(tmp_path / "grey.binary"), "-o", str(tmp_path / "grey2.csv"), *like]) == 0
    table = brdfatlas.read(tmp_path / "grey2.csv")
    np.testing.assert_allclose(table.table[table.valid], 0.1, rtol=1e-3)
    assert table.kind == "measured"


@pytest.mark.parametrize("name", ["acryl_blue", "garnet_red", "mystique"])
def test_real_files(shared, name):
    measured = brdfatlas.read(shared / "data" / "cornell" / f"{name}.brdf")
    albedo = mean_albedo(measured.table)
    assert (albedo < 0.5).all()
    assert np.nanmedian(measured.distance) < 6
    assert any("D65" in warning for warning in measured.provenance.warnings)
    brightest = {"acryl_blue": 2, "garnet_red": 0, "mystique": 0}[name]
    assert albedo.argmax() == brightest
