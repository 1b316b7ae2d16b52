"""Stored tables, and tables made by hand, that hold what no reader would let through: one line, and no fit of them."""

import json
from dataclasses import replace

import numpy as np
import pytest

import brdfatlas
from brdfatlas.angles import GRID_SHAPE, above_horizon
from brdfatlas.files import read_json
from brdfatlas.formats import stored
from brdfatlas.measured import Measured, MeasuredError
from brdfatlas.pipeline.materials import check_files
from brdfatlas.pipeline.records import describe_material_job, read_material_job
from brdfatlas.settings import ConfigError, check_name


def grey():
    table = np.full((*GRID_SHAPE, 3), 0.1, np.float32)
    table[~above_horizon()] = np.nan
    return table


@pytest.fixture(scope="module")
def parts(tmp_path_factory):
    """Header and numbers of a sound stored table."""
    path = tmp_path_factory.mktemp("stored") / "felt.measured"
    stored.write(path, Measured("felt", grey()))
    line, numbers = path.read_bytes()[len(stored.MAGIC) :].split(b"\n", 1)
    return json.loads(line), np.frombuffer(numbers, "<f4").reshape(*GRID_SHAPE, 3)


def write(path, header, table):
    path.write_bytes(stored.MAGIC + json.dumps(header).encode() + b"\n" + table.tobytes())
    return path


def changed(header, **changes):
    provenance = header["provenance"] | {k: v for k, v in changes.items() if k in header["provenance"]}
    return header | {k: v for k, v in changes.items() if k in header} | {"provenance": provenance}


BAD_HEADERS = [
    *({"path": 5}, {"path": ["a"]}, {"standin": "no"}, {"shares": None}, {"shares": {"a": "b"}}, {"shares": [1]}),
    *(
        {"shares": {"a": float("nan")}},
        {"shapes": {"table": [float("inf")]}},
        {"shapes": {"table": [90.0, 90, 180, 3]}},
    ),
    *({"shapes": {"table": [-90, -90, 180, 3]}}, {"shapes": [1]}, {"shapes": None}, {"warnings": "abc"}),
    *({"warnings": [1]}, {"note": {}}, {"kind": []}, {"kind": "x"}, {"provenance": []}, {"name": None}),
    *({"name": name} for name in ("", "x/y", "..", "a\nb", "\x1b[31m", "n" * 81, "a b")),
]


@pytest.mark.parametrize("changes", BAD_HEADERS, ids=lambda changes: ascii(changes)[:40])
def test_a_header_of_other_types_is_refused_in_one_line(tmp_path, parts, changes):
    header, table = parts
    bad = header | changes if "provenance" in changes else changed(header, **changes)
    path = write(tmp_path / "bad.measured", bad, table)
    verdict = check_files({"bad": path}, tmp_path / "none.json")[str(path)]["reason"]
    assert verdict.startswith(f"{path}: ")
    assert "again" in verdict
    assert verdict.isprintable()


@pytest.mark.parametrize("name", ["a", "n" * 80, "n" * 81, "0.b_c-d", "-a", ".a", "\u00e9", "a b", "a\n", ""])
def test_names_obey_the_rule_of_all_others(tmp_path, parts, name):
    path = write(tmp_path / "named.measured", changed(parts[0], name=name), parts[1])
    try:
        check_name(name, "x")
        assert stored.read(path).name == name
    except ConfigError:
        with pytest.raises(MeasuredError, match="a name has letters, digits"):
            stored.read(path)


def test_a_damaged_header_is_told_on_the_command_line(refused, parts):
    write(refused.folder / "bad.measured", changed(parts[0], path=5), parts[1])
    refused(["info", "bad.measured"], "bad.measured: its header cannot be read; convert")


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda t: -t, "negative values"),
        (lambda t: np.concatenate([t[..., :1] * np.nan, t[..., 1:]], -1), "NaN or Inf"),
        (lambda t: np.concatenate([t[..., :1] * np.nan, t[..., 1:] * np.inf], -1), "NaN or Inf"),
    ],
)
def test_stored_numbers_that_are_no_reflectance_are_refused(tmp_path, parts, change, told):
    path = write(tmp_path / "bad.measured", parts[0], change(parts[1]))
    with pytest.raises(MeasuredError, match=rf"bad\.measured: .*{told}"):
        brdfatlas.read(path)


@pytest.mark.parametrize("other_is_there", [False, True])
def test_the_record_of_a_copied_table_is_of_the_copy(tmp_path, parts, other_is_there):
    """The path and name that it was stored under lead nowhere, or to a file that is another one now."""
    other = tmp_path / "other.binary"
    if other_is_there:
        other.write_bytes(b"another")
    copy = write(tmp_path / "copy.measured", changed(parts[0], path=str(other)), parts[1])
    read_material_job(str(copy), str(tmp_path / "job.measured"))
    describe_material_job(str(tmp_path / "job.measured"), False, str(tmp_path / "copy.json"))
    record = read_json(tmp_path / "copy.json")
    assert (record["name"], record["source"]) == ("copy", str(copy))
    assert record["sha256"] == stored_digest(copy)


def stored_digest(path):
    return brdfatlas.files.digests(path.parent, [path.name])[path.name]


def spoilt(values, at=(10, 0, 90)):
    table = grey()
    table[at] = values
    return table


@pytest.mark.parametrize(
    ("make", "told"),
    [
        (lambda: spoilt([np.inf, 1, 1]), "holds Inf"),
        (lambda: spoilt([np.nan, 1, 1]), "NaN in some channels of 1 cells"),
        (lambda: spoilt([1, 1, np.nan]), "NaN in some channels of 1 cells"),
        (lambda: grey()[:, :, :90], r"shape \(90, 90, 90, 3\)"),
        (lambda: np.ones((*GRID_SHAPE, 3), int), "a table of int64"),
        (lambda: np.ones((*GRID_SHAPE, 3), ">f4"), "a table of >f4; float32"),
        (lambda: np.ones((*GRID_SHAPE, 3), "f2"), "a table of float16; float32"),
        (lambda: None, r"shape \(\)"),
    ],
)
def test_a_table_made_by_hand_is_checked_before_anything_is_fitted_to_it(make, told):
    with pytest.raises(MeasuredError, match=f"^hand: .*{told}"):
        Measured("hand", make())
    with pytest.raises(MeasuredError, match=told):
        replace(Measured("hand", grey()), table=make())


def test_directions_that_are_no_unit_vectors_are_refused():
    felt, up = Measured("felt", grey()), np.array([0.0, 0.0, 1.0])
    for item in (felt, brdfatlas.fit("lambert", felt)):
        assert np.isnan(item.evaluate(up * np.nan, up)).all()
        assert np.isnan(item.evaluate(up, np.ma.masked_equal(up, 0))).all()
        for wi, wo in [(2 * up, up), (up, np.stack([up, 0.9 * up])), (0 * up, up)]:
            with pytest.raises(ValueError, match=r"a direction of length .*; unit vectors are needed"):
                item.evaluate(wi, wo)
        for none in (None, 1.0, up[1:], np.ones((3, 4))):
            with pytest.raises(ValueError, match=r"directions .*\(\.\.\., 3\) is needed"):
                item.evaluate(none, none)


def test_masked_cells_were_not_measured():
    table = grey()
    table[:, :, 90:] = 0.7
    masked = np.ma.masked_equal(table, np.float32(0.7))
    table[:, :, 90:] = np.nan
    assert Measured("felt", masked) == Measured("felt", table)
    assert np.array_equal(Measured("felt", masked).extended, Measured("felt", table).extended)


def test_no_table_is_written_that_is_not_read(tmp_path):
    with pytest.raises(ValueError, match=r"a\.binary: the table holds Inf"):
        brdfatlas.write_merl(tmp_path / "a.binary", np.full((*GRID_SHAPE, 3), np.inf))
    assert not list(tmp_path.iterdir())


def test_a_merl_file_holds_real_numbers_and_no_masked_ones(tmp_path):
    table = np.full((*GRID_SHAPE, 3), 0.2, np.float32)
    hidden = np.zeros(table.shape, bool)
    hidden[0, :, 1] = True
    brdfatlas.write_merl(tmp_path / "a.binary", np.ma.array(np.where(hidden, 7, table), mask=hidden))
    read = brdfatlas.read(tmp_path / "a.binary")
    assert not read.valid[0, :, 1].any()
    assert np.nanmax(read.table) < 1
    for other in (table.astype(complex), table.astype(str), table.astype(object), table > 0):
        with pytest.raises(ValueError, match=r"b\.binary: a MERL table holds real numbers, not "):
            brdfatlas.write_merl(tmp_path / "b.binary", other)
    assert not (tmp_path / "b.binary").exists()


@pytest.mark.parametrize("call", [brdfatlas.fit, lambda model, *rest, **named: brdfatlas.recommend(*rest, **named)])
def test_seeds_that_are_none_are_refused_before_any_fit(call):
    for seed in (-1, 1.5, "1"):
        with pytest.raises(ValueError, match=f"seed {seed!r}: a whole number from 0"):
            call("lambert", Measured("felt", grey()), seed=seed)


def test_a_table_on_the_full_circle_is_not_fitted():
    with pytest.raises(ValueError, match=r"felt: a table on the full circle; brdfatlas.measured.fold"):
        brdfatlas.fit("lambert", Measured("felt", np.concatenate([grey(), grey()], 2)))


def test_a_path_is_no_material_and_one_name_is_a_list_of_one(tmp_path):
    with pytest.raises(ValueError, match=r"'m.binary' is no Measured; brdfatlas.read\(PATH\)"):
        brdfatlas.fit("lambert", "m.binary")
    with pytest.raises(KeyError, match="no_such_model"):
        brdfatlas.recommend(Measured("felt", grey()), models="no_such_model")
