"""Tables of numbers that contradict themselves or say what cannot be: one line, and never numbers in other places."""

import itertools
import os

import numpy as np
import pytest

import brdfatlas
from brdfatlas.angles import GRID_SHAPE
from brdfatlas.cli import main
from brdfatlas.formats import tables
from brdfatlas.measured import Measured, MeasuredError
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
    "angles of two units": (table(head="# angles: radians\n# angles: degrees\n"), "line 2: angles in degrees, before"),
    "angles in gradians": (table().replace("theta_i", "theta_i (grad)"), "line 2: angles in grad; convert"),
    "angles in thousandths": (table(head="# units: mrad\n"), "line 1: angles in mrad; convert"),
    "an unknown kind": (table(head="# kind: synthetic\n"), "line 1: kind: 'synthetic'; write one of: measured"),
    "angles of no known unit": (table(head="# angles: gons\n"), "line 1: angles: 'gons'; write"),
    "1_0": (table("1_0,0.1,0.1"), "line 3: '1_0' is not a number"),
    "digits of another script": (table("\u0663,0.1,0.1"), "line 3: '\u0663' is not a number"),
    "an azimuth of thousands of turns": (table(azimuth="{}e15"), "an azimuth of "),
}


@pytest.mark.parametrize("what", BAD_TABLES)
def test_a_table_that_contradicts_itself_is_named(refused, what):
    text, words = BAD_TABLES[what]
    (refused.folder / "bad.csv").write_text(text, encoding="utf-8")
    refused(["info", "bad.csv"], "bad.csv: ", words)


def test_spaces_of_other_kinds_do_no_harm(tmp_path):
    """A spreadsheet's no-break space is no other digit."""
    (tmp_path / "mine.csv").write_text(table(head="# values: f\n").replace(",0.2,", ",\u00a00.2,"), encoding="utf-8")
    assert brdfatlas.read(tmp_path / "mine.csv").valid.any()


def test_spectral_text_takes_no_1_0_for_10(refused):
    (refused.folder / "bad.brdf").write_text("3\n400 500 600\n" + "0 0 0 0 1 1 1_0\n")
    refused(["info", "bad.brdf"], "bad.brdf: line 3: '1_0' is not a number")


def one_column(names, values="0.2", head=""):
    return table(values, head=head).replace("r,g,b\n", f"{names}\n")


def quantity_read(folder, text):
    """The name of what a table is taken for, from its value 0.2 at a theta_o of 60 degrees."""
    (folder / "mine.csv").write_text(text, encoding="utf-8")
    samples = tables._load(folder / "mine.csv")[0]
    value = samples.values[samples.wo[:, 2] < 0.6][0, 0]
    return {0.2: "f", 0.4: "f cos", round(0.2 / np.pi, 6): "reflectance factor"}[round(float(value), 6)]


@pytest.mark.parametrize(
    ("words", "quantity"),
    [
        *[(words, "f") for words in ("f", "f_s", "BRDF", "BRDF in 1/sr", "brdf [sr^-1]", "f (1/sr)")],
        *[(words, "f cos") for words in ("f cos", "f*cos(theta_o)", "f·cos θ_o", "BRDF times cosine", "f cos_theta_r")],
        *[(words, "reflectance factor") for words in ("Reflectance Factor", "pi f", "π·f", "pi * BRDF", "rf")],
    ],
)
def test_what_a_table_says_of_its_values_is_understood(tmp_path, words, quantity):
    assert quantity_read(tmp_path, table(head=f"# values: {words}\n")) == quantity
    assert quantity_read(tmp_path, one_column(words)) == quantity


def test_comments_count_wherever_they_stand(tmp_path):
    assert quantity_read(tmp_path, table(head="") + "# values: f cos\n") == "f cos"


def test_columns_and_characters_that_are_not_needed_do_no_harm(tmp_path):
    """A name for each row; a separator of lines that is none in a table."""
    rows = [line + ("" if line[0] == "#" else ",name" if "theta" in line else ",s1") for line in table().splitlines()]
    text = "# note: one\u2028two\n" + "\n".join(rows) + "\n"
    assert quantity_read(tmp_path, text) == quantity_read(tmp_path, table())


@pytest.mark.parametrize("separator", [",", ";", "\t"])
@pytest.mark.parametrize("quote", ["", '"'])
def test_a_table_that_a_spreadsheet_has_saved_is_still_read(tmp_path, separator, quote):
    """It fills the lines of comments and the empty ones with empty cells, and may quote text."""
    comments, rows = ("# values: f cos", "# note: one, two"), table(head="").splitlines()
    empty = separator * 6
    head = ",".join(f"{quote}{name}{quote}" for name in rows[0].split(","))
    lines = [*(f"{quote}{text}{quote}{empty}" for text in comments), empty, head, *rows[1:], empty, empty]
    text = "\ufeff" + "\r\n".join(lines[:3] + [line.replace(",", separator) for line in lines[3:]]) + "\r\n"
    assert quantity_read(tmp_path, text) == "f cos"
    assert tables.recognises(text.encode())


@pytest.mark.parametrize(
    "words",
    [
        *("f, without the cosine", "f (not multiplied by cos theta_o)", "BRDF in 1/sr, no cosine factor", "f / cos"),
        *("f*cos(theta_i)", "brdf*pi", "BRDF in %/sr", "1000 brdf", "brdf (log10)", "BRDF dB/sr", "radiance factor"),
    ],
)
def test_what_is_not_exactly_understood_is_refused_and_not_guessed(tmp_path, words):
    path = tmp_path / "mine.csv"
    for text in (table(head=f"# values: {words}\n"), one_column(words.replace(",", " "))):
        path.write_text(text)
        with pytest.raises(MeasuredError, match=r"f, f cos, reflectance factor$|no column of values"):
            brdfatlas.formats.reader.check(path)


@pytest.mark.parametrize(
    ("text", "found"),
    [
        (table(head="# cos theta is not included in the values\n"), r"line 1: 'cos theta is .* write # values: "),
        (table(head="# values are 1000 f\n"), r"line 1: 'values are 1000 f'; write # values: "),
        (table(head="# values\n# value of a sample: 9\n"), "f"),
        (table(head="# cos theta is included\n# values: f\n"), "f"),
        (table(head="# converted from radians to degrees\n"), "f"),
        (table(head="# unit: W / m^2 sr, radiance of a lamp\n"), "f"),
        (one_column("x,y,value", "9,9,0.2"), "f"),
        (one_column("Y,brdf", "9,0.2"), "f"),
        (one_column("f,f_cos", "0.2,0.2"), "columns f and fcos may all be the values; keep one"),
        (one_column("value,brdf", "0.2,0.2"), "columns value and brdf may all be the values; keep one"),
        (one_column("r,g,b,f_cos", "0.2,0.2,0.2,9"), "f"),
        (one_column("f_cos", head="# values: f\n"), "a column of f cos, before: 'f'"),
        (one_column("r (log10),g (log10),b (log10)", "1,1,1"), "no column of values"),
    ],
)
def test_the_quantity_is_that_of_the_chosen_column(tmp_path, text, found):
    if found == "f":
        assert quantity_read(tmp_path, text) == "f"
    else:
        with pytest.raises(MeasuredError, match=found):
            quantity_read(tmp_path, text)


BAD_PARAMETERS = {
    "a column twice": "material,kd_r,kd_r,kd_g,kd_b\nfelt,1,2,3,4\n",
    "a cell more": "material,kd_r,kd_g,kd_b\nfelt,1,2,3,4\n",
    "a cell less": "material,kd_r,kd_g,kd_b\nfelt,1,2\n",
    "a column left out": "material,kd_1,kd_5,kd_9\nfelt,1,2,3\n",
    "two kinds of endings": "material,kd_r,kd_1,kd_2\nfelt,1,2,3\n",
    "the whole and its parts": "material,kd,kd_r,kd_g,kd_b\nfelt,1,2,3,4\n",
    "no number of the usual digits": "material,kd_1,kd_2,kd_\u00b3\nfelt,1,2,3\n",
    "1_0": "material,kd_r,kd_g,kd_b\nfelt,0.1,0.2,1_0\n",
    "digits of another script": "material,kd_r,kd_g,kd_b\nfelt,0.1,0.2,\u0663\n",
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


def measured_table(folder, f, unit="{},{},{},{}", head="# values: f\n"):
    """A regular table of f(i, o, phi), degrees, written row by row as ``unit`` says."""
    angles = itertools.product((0, 20, 40, 60, 80), (0,), (0, 20, 40, 60, 80), (0, 45, 90, 135, 180))
    rows = "".join(f"{unit.format(i, p, o, q)},{f(*np.deg2rad((i, o, q)))}\n" for i, p, o, q in angles)
    (folder / "mine.csv").write_text(head + NAMES.replace("r,g,b", "value") + rows)
    return folder / "mine.csv"


def glossy(i, o, q):
    """A lobe about the mirror direction, at azimuth pi."""
    return 0.1 + 0.5 * np.exp(-20 * (np.sin(i) ** 2 + np.sin(o) ** 2 + 2 * np.sin(i) * np.sin(o) * np.cos(q)))


DOUBTS = {
    "nothing": (glossy, ""),
    "a highlight towards the light": (lambda i, o, q: glossy(i, o, q + np.pi), "brightest towards the light"),
    "cosines that nobody mentions": (lambda i, o, q: glossy(i, o, q) * np.cos(o), "the values look like f cos"),
    "another value for each order": (lambda i, o, q: 0.1 + 0.3 * i, "change by"),
}


@pytest.mark.parametrize("what", DOUBTS)
def test_a_table_that_looks_misread_says_so(tmp_path, what):
    f, words = DOUBTS[what]
    told = brdfatlas.read(measured_table(tmp_path, f)).provenance.warnings
    for doubt in (words for _, words in DOUBTS.values() if words):
        assert any(doubt in line for line in told) == (doubt == words or (doubt == "change by" and "cos" in words))


def test_few_directions_are_told_whatever_the_format(tmp_path):
    path = measured_table(tmp_path, glossy)
    few = "".join(row for row in path.open() if not row.startswith(("60", "80")) and ",80," not in row)
    path.write_text(few)
    assert any("elsewhere the nearest" in line for line in brdfatlas.read(path).provenance.warnings)


@pytest.mark.parametrize("radians", ["phi", "theta", "both"])
def test_angles_of_two_units_that_nobody_names_are_refused(tmp_path, radians):
    scale = [np.pi / 180 if radians in (name, "both") else 1 for name in ("theta", "phi")]
    text = measured_table(tmp_path, glossy).read_text().splitlines()
    rows = [row.split(",") for row in text[2:]]
    rows = [",".join([*(f"{float(x) * s:.9g}" for x, s in zip(row, 2 * scale)), row[4]]) for row in rows]
    (tmp_path / "mine.csv").write_text("\n".join([*text[:2], *rows]) + "\n")
    with pytest.raises(MeasuredError, match=r"mine\.csv: no (theta|phi) above .*radians\?"):
        brdfatlas.read(tmp_path / "mine.csv")
    tables.check(measured_table(tmp_path, glossy, "0.0{},{},0.0{},{}", "# values: f\n# angles: degrees\n"))


def test_values_that_disagree_are_those_that_are_named(tmp_path):
    """Three rows of one pair: the third is another."""
    path = measured_table(tmp_path, glossy)
    path.write_text(path.read_text() + "20,0,40,90,0.1\n20,0,40,90,0.9\n")
    with pytest.raises(MeasuredError) as caught:
        brdfatlas.read(path)
    lines = [int(word) for word in str(caught.value).replace(",", " ").split() if word.isdigit()]
    values = [float(path.read_text().splitlines()[line - 1].split(",")[-1]) for line in lines]
    assert sorted(values) == [0.1, 0.9]
    assert "(0.1 and 0.9)" in str(caught.value)


def test_the_direction_that_is_too_long_is_named(refused):
    names = "wi_x,wi_y,wi_z,wo_x,wo_y,wo_z,value\n"
    (refused.folder / "bad.csv").write_text(f"# values: f\n{names}" + "0,0,2,0,0,1,0.2\n")
    refused(["info", "bad.csv"], "line 3: a direction of length 2; 1 is wanted")


def test_a_table_in_utf_16_says_how_to_save_it(refused):
    (refused.folder / "bad.csv").write_text(table(), encoding="utf-16")
    refused(["info", "bad.csv"], "bad.csv: UTF-16 text; save it as UTF-8")


def test_a_table_of_a_file_whose_name_is_no_text(tmp_path, monkeypatch, inputs):
    """Latin-1 names of old disks, or any in the locale C."""
    monkeypatch.chdir(tmp_path)
    name = b"\xe9.binary".decode("utf-8", "surrogateescape")
    os.link(inputs / "measured.binary", name)
    assert main(["convert", name, "-o", "out.csv", "--step", "30"]) == 0
    assert brdfatlas.read("out.csv").valid.any()


@pytest.mark.parametrize("take", [lambda measured: brdfatlas.fit("lambert", measured), brdfatlas.recommend])
def test_a_table_with_another_programs_marks_is_not_fitted(take):
    """MERL files have negative numbers where nothing was measured; as values they would make a black fit."""
    values = np.full((*GRID_SHAPE, 3), 0.2, np.float32)
    values[0, 0, 0] = -1
    with pytest.raises(ValueError, match="negative values in 1 cells"):
        take(Measured("mine", values))
