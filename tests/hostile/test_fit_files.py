"""A fit's file is checked against its model when it is read: names, types, shapes, ranges, sizes."""

import io
import json
import zipfile
from functools import cache

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import brdfatlas
from brdfatlas import files
from brdfatlas.export.fit_json import export_json, import_json
from brdfatlas.fits import load_reported

MODELS = list(brdfatlas.MODELS)


def first_parameter(store):
    return next(key for key in store if key.startswith("parameter/"))


def a_missing_parameter(store):
    del store[first_parameter(store)]


def one_more_parameter(store):
    store["parameter/more"] = np.zeros(3, np.float32)


def a_wrong_shape(store):
    key = first_parameter(store)
    store[key] = np.concatenate([store[key], store[key]])


def one_dimension_more(store):
    key = first_parameter(store)
    store[key] = store[key][None]


def no_number_at_all(store):
    key = first_parameter(store)
    store[key] = store[key][:0]


def a_wrong_type(store):
    key = first_parameter(store)
    store[key] = store[key].astype(np.float16)


def big_endian(store):
    key = first_parameter(store)
    store[key] = store[key].astype(store[key].dtype.newbyteorder(">"))


def text_for_numbers(store):
    key = first_parameter(store)
    store[key] = np.full(store[key].shape, "1.0")


def nan(store):
    store[first_parameter(store)].flat[0] = np.nan


def infinity(store):
    store[first_parameter(store)].flat[-1] = np.inf


def an_option_of_nobody(store):
    store["option/colour"] = np.array(1)


CHANGES = (
    *(a_missing_parameter, one_more_parameter, a_wrong_shape, one_dimension_more, no_number_at_all, a_wrong_type),
    *(big_endian, text_for_numbers, nan, infinity, an_option_of_nobody),
)


@pytest.mark.parametrize("change", CHANGES)
@pytest.mark.parametrize("model", MODELS)
def test_a_fit_is_what_its_model_states(inputs, tmp_path, model, change):
    store = files.read_npz(inputs / f"{model}.npz")
    change(store)
    files.write_npz(tmp_path / "bad.npz", store)
    with pytest.raises(ValueError, match=r"bad.npz: ") as caught:
        brdfatlas.load_fit(tmp_path / "bad.npz")
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 600


@pytest.mark.parametrize("model", MODELS)
def test_a_fit_that_is_whole_loads_as_it_was(inputs, tmp_path, model):
    fitted = brdfatlas.load_fit(inputs / f"{model}.npz")
    export_json(fitted, tmp_path / "a.json")
    for back in (brdfatlas.load_fit(inputs / f"{model}.npz"), import_json(tmp_path / "a.json")):
        for name, array in fitted.parameters.items():
            np.testing.assert_array_equal(back.parameters[name], array)
            assert back.parameters[name].dtype == array.dtype


OUTSIDE = [
    (name, parameter.name, side)
    for name in MODELS
    for parameter in brdfatlas.MODELS[name].parameters
    for side in ("low", "high")
    if np.isfinite(getattr(parameter, side))
]


@pytest.mark.parametrize(("model", "parameter", "side"), OUTSIDE)
def test_a_range_is_kept(inputs, tmp_path, model, parameter, side):
    stated = next(p for p in brdfatlas.MODELS[model].parameters if p.name == parameter)
    store = files.read_npz(inputs / f"{model}.npz")
    bound = np.dtype(stated.dtype).type(getattr(stated, side))
    array = store[f"parameter/{parameter}"]
    array.flat[0] = bound
    files.write_npz(tmp_path / "edge.npz", store)
    assert brdfatlas.load_fit(tmp_path / "edge.npz").parameters[parameter].flat[0] == bound
    array.flat[0] = np.nextafter(bound, -np.inf if side == "low" else np.inf, dtype=array.dtype)
    files.write_npz(tmp_path / "bad.npz", store)
    with pytest.raises(ValueError, match=rf"bad.npz: .*{parameter} is not within"):
        brdfatlas.load_fit(tmp_path / "bad.npz")


def test_compiled_models_get_terms_that_agree(inputs, tmp_path):
    """tucker and lawrence loop over terms in compiled code, which trusts shapes."""
    for model, key in (("tucker", "phi_h"), ("lawrence", "u"), ("lawrence", "v"), ("tucker", "phi_o")):
        store = files.read_npz(inputs / f"{model}.npz")
        array = store[f"parameter/{key}"]
        store[f"parameter/{key}"] = array[:, :1].copy()
        files.write_npz(tmp_path / "bad.npz", store)
        with pytest.raises(ValueError, match=rf"bad.npz: .*{key} has shape"):
            brdfatlas.load_fit(tmp_path / "bad.npz")


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("model", np.array("no_such_model")),
        ("model", np.array(3)),
        ("model", np.array(["ggx", "ggx"])),
        ("material", np.array("")),
        ("material", np.array("a\nb")),
        ("material", np.array("x" * 1000)),
        ("material", np.array(b"felt")),
        ("standin", np.array("False")),
        ("standin", np.array([True, False])),
        ("stranger", np.zeros(3)),
        ("report/seconds", np.zeros(3)),
        ("option/start", np.array([1, 2])),
    ],
)
@pytest.mark.parametrize("command", [["table", "-o", "out.binary"], ["export", "-o", "out.json"], ["info"]])
def test_labels_are_checked(refused, inputs, key, value, command):
    store = files.read_npz(inputs / "ggx.npz")
    files.write_npz("bad.npz", store | {key: value})
    refused([command[0], "bad.npz", *command[1:]], "bad.npz")


def archive(path, members):
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as store:
        for name, data in members:
            store.writestr(name, data)


def npy(array):
    handle = io.BytesIO()
    np.lib.format.write_array(handle, array)
    return handle.getvalue()


@cache
def zip_bomb() -> bytes:
    """A small npz that is a quarter of a gigabyte of zeros."""
    handle = io.BytesIO()
    shape = (2**25 + 1,)
    with (
        zipfile.ZipFile(handle, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as store,
        store.open("a.npy", "w", force_zip64=True) as out,
    ):
        np.lib.format.write_array_header_1_0(out, {"descr": "<f8", "fortran_order": False, "shape": shape})
        for _ in range(256):
            out.write(bytes(2**20))
        out.write(bytes(8))
    return handle.getvalue()


def a_bomb(path):
    path.write_bytes(zip_bomb())


def a_header_that_promises_terabytes(path):
    data = npy(np.zeros(3)).replace(b"(3,), }          ", b"(99999999999,), }")
    archive(path, [("model.npy", data)])


def python_objects(path):
    np.savez(path.with_suffix(".tmp.npz"), model=np.array([{}], object))
    path.write_bytes(path.with_suffix(".tmp.npz").read_bytes())
    path.with_suffix(".tmp.npz").unlink()


def a_name_twice(path):
    with pytest.warns(UserWarning, match="Duplicate"):
        archive(path, [("model.npy", npy(np.array("ggx")))] * 2)


def an_unknown_version(path):
    archive(path, [("model.npy", npy(np.zeros(3)).replace(b"NUMPY\x01", b"NUMPY\x07"))])


def no_npy_inside(path):
    archive(path, [("word/document.xml", b"<xml/>")])


def a_negative_size(path):
    archive(path, [("model.npy", npy(np.zeros(3)).replace(b"(3,)", b"(-3,)"))])


def code_in_a_header(path):
    archive(path, [("model.npy", npy(np.zeros(3)).replace(b"(3,), }", b"exit(), }"))])


def cut_off(path):
    data = io.BytesIO()
    np.savez_compressed(data, a=np.arange(1000.0))
    path.write_bytes(data.getvalue()[:400])


def a_wrong_checksum(path):
    data = io.BytesIO()
    np.savez(data, model=np.arange(100.0))
    content = bytearray(data.getvalue())
    content[300] ^= 255
    path.write_bytes(content)


def only_a_magic(path):
    path.write_bytes(b"PK\x03\x04")


BROKEN = (
    *(a_bomb, a_header_that_promises_terabytes, python_objects, a_name_twice, an_unknown_version, no_npy_inside),
    *(a_negative_size, code_in_a_header, cut_off, a_wrong_checksum, only_a_magic),
)


@pytest.mark.parametrize("make", BROKEN)
@pytest.mark.parametrize("command", [["table", "-o", "out.binary"], ["render", "-o", "out.exr"], ["info"]])
def test_an_archive_is_checked_before_it_is_unpacked(refused, make, command):
    make(refused.folder / "bad.npz")
    err = refused([command[0], "bad.npz", *command[1:]], "bad.npz", "not a brdfatlas fit")
    assert "allow_pickle" not in err


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_a_damaged_fit_is_named_or_whole(inputs, tmp_path, data):
    """Any bytes changed anywhere: one line, or a fit that its model can evaluate."""
    content = bytearray((inputs / "ward.npz").read_bytes())
    for _ in range(data.draw(st.integers(1, 4))):
        content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.integers(0, 255))
    (tmp_path / "bad.npz").write_bytes(content)
    fitted, message = None, ""
    try:
        fitted = brdfatlas.load_fit(tmp_path / "bad.npz")
    except ValueError as error:
        message = str(error)
    if fitted is None:
        assert "bad.npz" in message
        assert "\n" not in message
    else:
        assert np.isfinite(fitted.evaluate([0, 0, 1], [0.6, 0, 0.8])).all()


def edited(**changes):
    def change(value):
        value |= changes

    return change


def in_kd(**changes):
    def change(value):
        value["parameters"]["kd"] |= changes

    return change


DEEP = "[" * 100_000 + "]" * 100_000
JSON_CHANGES = {
    "another format": edited(format="brdfatlas fit 99"),
    "no model": edited(model=None),
    "an unknown model": edited(model="no_such_model"),
    "a model that is a list": edited(model=["ward"]),
    "a material that is a number": edited(material=3),
    "a material of two lines": edited(material="a\nb"),
    "standin as text": edited(standin="no"),
    "options as a list": edited(options=[1]),
    "an option of nobody": edited(options={"colour": 1}),
    "parameters as a list": edited(parameters=[1, 2]),
    "no parameters": edited(parameters={}),
    "a parameter that is a number": edited(parameters={"kd": 3}),
    "object dtype": in_kd(dtype="object"),
    "a dtype of text": in_kd(dtype="U10"),
    "a dtype with fields": in_kd(dtype="f4,f4"),
    "a dtype that is a number": in_kd(dtype=4),
    "another dtype": in_kd(dtype="float64"),
    "a shape that promises terabytes": in_kd(shape=[10**12]),
    "a shape of text": in_kd(shape="3"),
    "values of text": in_kd(values=["1", "2", "3"]),
    "values of truth": in_kd(values=[True, False, True]),
    "a missing value": in_kd(values=[1.0, None, 2.0]),
    "rows that differ": in_kd(values=[[1.0], [2.0, 3.0], 1.0]),
    "a huge integer": in_kd(values=[10**400, 1, 1]),
    "a number beyond float32": in_kd(values=[1e39, 1.0, 1.0]),
    "a negative albedo": in_kd(values=[-0.5, 1.0, 1.0]),
    "objects": in_kd(values=[{}, {}, {}]),
}


@pytest.mark.parametrize("what", JSON_CHANGES)
def test_json_is_checked_like_a_fit(inputs, tmp_path, what):
    export_json(brdfatlas.load_fit(inputs / "ward.npz"), tmp_path / "bad.json")
    value = json.loads((tmp_path / "bad.json").read_text())
    JSON_CHANGES[what](value)
    (tmp_path / "bad.json").write_text(json.dumps(value))
    with pytest.raises(ValueError, match=r"bad\.json: ") as caught:
        import_json(tmp_path / "bad.json")
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 600


@pytest.mark.parametrize(
    "text",
    ["", "{", "[]", "null", "NaN", '{"format": 1}', DEEP, '{"a": ' * 50_000, "1" * 10_000, "\ufeff{}", '"\\ud800"'],
    ids=range(11),
)
def test_json_of_any_other_kind_is_named(tmp_path, text):
    (tmp_path / "bad.json").write_text(text)
    with pytest.raises(ValueError, match=r"bad\.json: ") as caught:
        import_json(tmp_path / "bad.json")
    assert "\n" not in str(caught.value)


def test_json_that_is_no_text_is_named(tmp_path):
    (tmp_path / "bad.json").write_bytes(b"\xff\xfe{}")
    with pytest.raises(ValueError, match=r"bad\.json: "):
        import_json(tmp_path / "bad.json")


@pytest.mark.parametrize("constant", ["NaN", "Infinity", "-Infinity", "1e999"])
def test_json_numbers_are_finite(inputs, tmp_path, constant):
    export_json(brdfatlas.load_fit(inputs / "ward.npz"), tmp_path / "bad.json")
    value = json.loads((tmp_path / "bad.json").read_text())
    value["parameters"]["kd"]["values"] = [1.0, 1.0, "HERE"]
    (tmp_path / "bad.json").write_text(json.dumps(value).replace('"HERE"', constant))
    with pytest.raises(ValueError, match=r"bad.json: .*kd"):
        import_json(tmp_path / "bad.json")


@pytest.mark.parametrize("key", ["entry", "material"])
def test_a_file_copied_over_a_result_is_named(inputs, key):
    """Else the errors of one fit would stand under the name of another."""
    report = {"status": "ok", "entry": "ggx", "material": "felt"}
    assert load_reported(inputs / "ggx.npz", report, "ggx", "felt").entry == "ggx"
    with pytest.raises(ValueError, match=r"ggx\.npz: a fit of ggx to felt, its report is of .*other.*; delete it"):
        load_reported(inputs / "ggx.npz", report | {key: "other"}, "ggx", "felt")


@pytest.mark.parametrize("place", [("ward", "felt"), ("ggx", "chrome")])
def test_a_fit_copied_with_its_report_to_another_place_is_named(inputs, place):
    with pytest.raises(ValueError, match=r"ggx\.npz: a fit of ggx to felt, .* is of another \(.*\); delete it"):
        load_reported(inputs / "ggx.npz", {"status": "ok", "entry": "ggx", "material": "felt"}, *place)
