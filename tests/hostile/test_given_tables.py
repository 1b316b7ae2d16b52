"""Tables of numbers that contradict themselves or say what cannot be: one line, and never numbers in other places."""

import itertools

import pytest

import brdfatlas
from brdfatlas.models.given import ParameterFileError, read_parameters
from brdfatlas.settings import ConfigError, check_name

NAMES = "theta_i,phi_i,theta_o,phi_o,r,g,b\n"


def table(values="0.2,0.1,0.1", azimuth="{}", head="# values: f\n"):
    angles = itertools.product((0, 20, 40, 60), (0, 30, 60), (0, 90, 180))
    return head + NAMES + "".join(f"{i},0,{o},{azimuth.format(p)},{values}\n" for i, o, p in angles)


BAD_TABLES = {
    "two kinds of values": (table(head="# values: f\n# values: f cos\n"), "line 2: values: 'f cos', before: 'f'"),
    "negative values only": (table("-1,-1,-1"), "negative values only"),
    "black in float32": (table("1e-50,1e-50,1e-50"), "black"),
    "an azimuth of thousands of turns": (table(azimuth="{}e15"), "an azimuth of "),
}


@pytest.mark.parametrize("what", BAD_TABLES)
def test_a_table_that_contradicts_itself_is_named(refused, what):
    text, words = BAD_TABLES[what]
    (refused.folder / "bad.csv").write_text(text)
    refused(["info", "bad.csv"], "bad.csv: ", words)


BAD_PARAMETERS = {
    "a column twice": "material,kd_r,kd_r,kd_g,kd_b\nfelt,1,2,3,4\n",
    "a cell more": "material,kd_r,kd_g,kd_b\nfelt,1,2,3,4\n",
    "a cell less": "material,kd_r,kd_g,kd_b\nfelt,1,2\n",
    "a column left out": "material,kd_1,kd_5,kd_9\nfelt,1,2,3\n",
    "two kinds of endings": "material,kd_r,kd_1,kd_2\nfelt,1,2,3\n",
    "the whole and its parts": "material,kd,kd_r,kd_g,kd_b\nfelt,1,2,3,4\n",
    "no number of the usual digits": "material,kd_1,kd_2,kd_\u00b3\nfelt,1,2,3\n",
    "a cell without end": f"material,kd_r,kd_g,kd_b\nfelt,1,2,{'3' * 200_000}\n",
}


@pytest.mark.parametrize("what", BAD_PARAMETERS)
def test_given_parameters_do_not_move_to_other_places(tmp_path, what):
    path = tmp_path / "given.csv"
    path.write_text(BAD_PARAMETERS[what], encoding="utf-8")
    with pytest.raises(ParameterFileError, match=r"given\.csv: .{5,200}$"):
        read_parameters(path, brdfatlas.MODELS["lambert"], "felt")


@pytest.mark.parametrize("names", ["kd_b,kd_g,kd_r", "kd_3,kd_2,kd_1"])
def test_the_endings_of_columns_say_where_numbers_belong_and_not_their_order(tmp_path, names):
    (tmp_path / "given.csv").write_text(f"material,{names},run_7,run_9\nfelt,0.3,0.2,0.1,0,0\n")
    given = read_parameters(tmp_path / "given.csv", brdfatlas.MODELS["lambert"], "felt")
    assert given["kd"].tolist() == [0.1, 0.2, 0.3]


BAD_TEXTS = {
    "brackets without end.json": ("[" * 100_000, "nested too deeply"),
    "brackets without end.txt": (f"felt = f(kd=[{'[' * 100_000}", "nested too deeply"),
    "digits without end.json": (f'{{"felt": {{"kd": [1, 1, {"9" * 5000}]}}}}', "kd: holds NaN or Inf"),
    "a parameter twice.json": ('{"felt": {"kd": [1, 1, 1], "kd": [2, 2, 2]}}', "'kd' is in it twice"),
    "a material twice.json": ('{"felt": {"kd": [1, 1, 1]}, "felt": {}}', "'felt' is in it twice"),
    "a truth.json": ('{"felt": {"kd": [0.5, true, 0.5]}}', "is no number or list of numbers"),
    "pairs.json": ('[["felt", [["kd", [1, 1, 1]]]]]', "is not {material"),
}


@pytest.mark.parametrize("name", BAD_TEXTS)
def test_given_parameters_that_are_none_are_named_in_one_line(tmp_path, name):
    text, words = BAD_TEXTS[name]
    (tmp_path / name).write_text(text)
    with pytest.raises(ParameterFileError) as caught:
        read_parameters(tmp_path / name, brdfatlas.MODELS["lambert"], "felt")
    told = str(caught.value)
    assert told.startswith(str(tmp_path / name))
    assert words in told
    assert "\n" not in told
    assert len(told) < 400


def test_a_spreadsheets_byte_order_mark_is_no_letter(tmp_path):
    (tmp_path / "given.csv").write_text("\ufeffmaterial,kd_r,kd_g,kd_b\nfelt,0.1,0.2,0.3\n", encoding="utf-8")
    given = read_parameters(tmp_path / "given.csv", brdfatlas.MODELS["lambert"], "felt")
    assert given["kd"].tolist() == [0.1, 0.2, 0.3]


def test_the_name_of_a_row_fits_into_the_name_of_a_file():
    assert check_name("a" * 80, "models.yaml") == "a" * 80
    with pytest.raises(ConfigError, match=r"^models\.yaml: aaa.*80 characters; shorten it$"):
        check_name("a" * 81, "models.yaml")
