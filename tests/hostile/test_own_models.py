"""A model of one's own may be wrong in any way: the fault is its own, in one line; nothing else stops or changes."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from own_model import OWN_MODEL

import brdfatlas
from brdfatlas.cli import main
from brdfatlas.export.uber_texture import has_row
from brdfatlas.figures.jobs import figures_job
from brdfatlas.files import write_json
from brdfatlas.fits import Fit
from brdfatlas.models import Entry, loading, name_sources, read_entries
from brdfatlas.models.base import FitError, Result
from brdfatlas.pipeline.jobs import fit_job
from brdfatlas.reports.data import SceneFacts, model_facts, read_material, summarise_run
from brdfatlas.reports.fit_files import write_fit_files
from brdfatlas.reports.material_page import make_entries
from brdfatlas.settings import ConfigError

FIT = ["fit", "mine", "measured.binary", "--source", "model.py", "-o", "out.npz"]
IN_FIT = "        return Result("
RETURNED = 'return Result({"a": np.ones(3)}, 0.0, "none", 1, True)'


@pytest.fixture(autouse=True)
def registry(monkeypatch):
    """A registry that forgets, after each test, what was registered."""
    monkeypatch.setattr(brdfatlas.MODELS, "_own", {})


def in_fit(line):
    return OWN_MODEL.replace(IN_FIT, f"        {line}\n{IN_FIT}")


def with_options(option):
    stated = f"formula = 'a'\n    options = {{'k': {option}}}"
    return OWN_MODEL.replace("import Model", "import Option, Model").replace('formula = "a"', stated)


AT_IMPORT = {
    "sys.exit(0)": "import sys\nsys.exit(0)\n",
    "sys.exit()": "import sys\nsys.exit()\n",
    "sys.exit(text)": "import sys\nsys.exit('bye')\n",
    "exit in a class": "import sys\nclass A:\n    sys.exit(0)\n",
    "a syntax error": "def f(:\n",
    "a missing module": "import no_such_module_of_mine\n",
    "a name that is not": "undefined_name\n",
    "zero division": "1 / 0\n",
    "a message of two lines": "raise ValueError('a\\nb')\n",
    "recursion": "def f():\n    f()\nf()\n",
    "null bytes": "a = 1\0\n",
    "no model": "a = 1\n",
    "an abstract model": "from brdfatlas.models.base import Model\nclass Mine(Model):\n    name = 'mine'\n",
    "two models": OWN_MODEL + OWN_MODEL.replace("class Mine", "class Other"),
    "another name": OWN_MODEL.replace('"mine"', '"other"'),
    "no parameters": OWN_MODEL.replace("    parameters = (P", "    unknowns = (P"),
    "a paper of text": OWN_MODEL.replace('Paper("A. Author", "Mine", "Home", 2020)', '"Author 2020"'),
    "a paper by nobody": OWN_MODEL.replace("A. Author", "A. Author, "),
    "a parameter called by a number": OWN_MODEL.replace('Parameter("a"', "Parameter(1"),
    "a parameter in a folder": OWN_MODEL.replace('Parameter("a"', 'Parameter("a/b"'),
    "a shape that is a number": OWN_MODEL.replace("(3,),", "3,"),
    "a shape of nothing": OWN_MODEL.replace("(3,),", "(0,),"),
    "a bound of None": OWN_MODEL.replace('"", 0.0)', '"", None)'),
    "a parameter twice": OWN_MODEL.replace('"", 0.0),)', '"", 0.0),) * 2'),
    "parameters that are none": OWN_MODEL.replace("(Parameter(", "((").replace('"", 0.0),)', '"", 0.0),)'),
    "no parameter at all": OWN_MODEL.replace('(Parameter("a", (3,), "albedo", "", 0.0),)', "()"),
    "options in a list": OWN_MODEL.replace('formula = "a"', 'formula = "a"\n    options = ["a"]'),
    "options that are numbers": OWN_MODEL.replace('formula = "a"', 'formula = "a"\n    options = {"k": 3}'),
    "a title that fails": OWN_MODEL + "\n    def title_of(self, options):\n        raise RuntimeError('a')\n",
    "a title that is none": OWN_MODEL + "\n    def title_of(self, options):\n        return None\n",
    "parameters_of that fails": OWN_MODEL + "\n    def parameters_of(self, options):\n        return options['k']\n",
    "parameters_of that are none": OWN_MODEL + "\n    def parameters_of(self, options):\n        return ['a']\n",
    "half a character": OWN_MODEL.replace('title = "Mine"', 'title = "a\\ud800"'),
    "no status": OWN_MODEL.replace('formula = "a"', 'formula = "a"\n    status = None'),
    "no targets": OWN_MODEL.replace('formula = "a"', 'formula = "a"\n    targets = None'),
    "no number of bytes": OWN_MODEL.replace('formula = "a"', 'formula = "a"\n    bytes = None'),
    "an option of two values": with_options("Option((1, 2), 'a pair')"),
    "an option that does not allow its default": with_options("Option('z', 'a choice', ('x', 'y'))"),
    "a constructor that fails": OWN_MODEL + "\n    def __init__(self):\n        raise OSError\n",
}


@pytest.mark.parametrize("what", AT_IMPORT)
def test_a_file_that_is_no_model(refused, linked, what):
    linked("measured.binary")
    (refused.folder / "model.py").write_text(AT_IMPORT[what])
    refused(FIT, "model.py")


@pytest.mark.parametrize("name", ["model", "model.txt", "model.py.bak", "model.PY3"])
def test_a_source_ends_in_py(refused, linked, name):
    linked("measured.binary")
    (refused.folder / name).write_text(OWN_MODEL)
    refused([name if item == "model.py" else item for item in FIT], name, ".py")


def with_hook(name, body):
    return f"{OWN_MODEL}\n    def {name}(self, parameters):\n        {body}\n"


def function(numbers):
    return f"from brdfatlas.models.base import Function; return (Function('D', {numbers}),)"


def factors(numbers):
    return f"from brdfatlas.models.base import Factors; return Factors({numbers})"


WHILE_FITTING = {
    "factors of another kind": with_hook("factors", "return 'D F G'"),
    "a sampler that fails": with_hook("sampler", "return 1 / 0"),
    "functions that are none": with_hook("functions", "return None"),
    "functions among which is none": with_hook("functions", "return (None,)"),
    "a function over another angle": with_hook("functions", function("'theta_i', np.zeros(9), np.ones(9)")),
    "a function of another length": with_hook("functions", function("'theta', np.zeros(9), np.ones(8)")),
    "a function of two colours": with_hook("functions", function("'theta', np.zeros(9), np.ones((9, 2))")),
    "factors of another grid": with_hook("factors", factors("np.zeros(3), np.ones((3, 1, 45)), np.ones((3, 1, 90))")),
    "factors without products": with_hook("factors", factors("np.zeros(3), np.ones((3, 90)), np.ones((3, 90))")),
    "factors of one number": with_hook("factors", factors("0.0, np.ones((3, 1, 90)), np.ones((3, 1, 90))")),
    "a value out of its range": OWN_MODEL.replace("np.ones(3)", "-np.ones(3)"),
    "sys.exit(0)": in_fit("sys.exit(0)"),
    "zero division": in_fit("1 / 0"),
    "a write to the table": in_fit("measured.table[:] = 0"),
    "a write to a row of it": in_fit("measured.table[0, 0, 0] += 1"),
    "a sort of it": in_fit("measured.table.sort(axis=0)"),
    "an attribute of the material": in_fit("measured.name = 'gold'"),
    "a failed assertion": in_fit("assert False, 'never'"),
    "a KeyError": in_fit("{}['x']"),
    "StopIteration": in_fit("next(iter(()))"),
    "GeneratorExit": in_fit("raise GeneratorExit"),
    "an exception without a text": in_fit("raise type('Mute', (Exception,), {'__str__': lambda self: 1 / 0})"),
    "values of what it keeps": in_fit("self.gain = 2").replace(
        'parameters["a"],', 'parameters["a"] * getattr(self, "gain", 1),'
    ),
    "no result": OWN_MODEL.replace(RETURNED, "return None"),
    "no parameter": OWN_MODEL.replace('{"a": np.ones(3)}', "{}"),
    "a parameter of another shape": OWN_MODEL.replace("np.ones(3)", "np.ones(4)"),
    "a parameter of text": OWN_MODEL.replace("np.ones(3)", "'abc'"),
    "NaN": OWN_MODEL.replace("np.ones(3)", "np.full(3, np.nan)"),
    "an objective of text": OWN_MODEL.replace("0.0, ", "'best', "),
    "no objective": OWN_MODEL.replace("0.0, ", "None, "),
    "details that JSON cannot hold": OWN_MODEL.replace("True)", "True, details={'a': object()})"),
    "details with a set": OWN_MODEL.replace("True)", "True, details={'a': {1}})"),
    "details with a complex number": OWN_MODEL.replace("True)", "True, details={'a': 1j})"),
    "details that hold themselves": in_fit("d = {}; d['d'] = d").replace("True)", "True, details=d)"),
}


@pytest.mark.parametrize("what", WHILE_FITTING)
def test_a_fit_that_fails(refused, linked, what):
    linked("measured.binary")
    (refused.folder / "model.py").write_text(WHILE_FITTING[what])
    refused(FIT, "mine on measured: ")


@pytest.mark.parametrize("body", ["return 'D F G'", "return 1 / 0", "return parameters['b']", "raise SystemExit"])
def test_a_plan_is_made_whatever_a_model_says_of_its_factors(tmp_path, body):
    (tmp_path / "model.py").write_text(with_hook("factors", body))
    assert not has_row(loading.load_model("mine", tmp_path / "model.py"))


def test_bounds_of_whole_numbers_are_numbers(linked, tmp_path, monkeypatch):
    """Infinity, the default, is no int8."""
    linked("measured.binary")
    monkeypatch.chdir(tmp_path)
    model = OWN_MODEL.replace('"", 0.0)', '"", 0, dtype="int8")')
    (tmp_path / "model.py").write_text(model)
    assert main(FIT) == 0
    assert brdfatlas.load_fit(tmp_path / "out.npz").parameters["a"].dtype == np.int8


@pytest.mark.parametrize("what", WHILE_FITTING)
def test_in_a_run_the_fit_fails_and_not_the_job(linked, tmp_path, capsys, what):
    linked("measured.binary")
    (tmp_path / "model.py").write_text(WHILE_FITTING[what])
    paths = [str(tmp_path / name) for name in ("model.py", "measured.binary", "out.npz", "out.json")]
    entry = Entry("mine", "mine", source=paths[0])
    fit_job([entry.plain], 0, paths[1], False, {"mine": paths[2:]}, {"mine": ""}, str(tmp_path / "made"))
    report = json.loads((tmp_path / "out.json").read_text())
    assert report["status"] == "failed"
    assert "\n" not in report["reason"]
    assert (tmp_path / "out.npz").read_bytes() == b""


def test_the_reason_of_a_failed_fit_names_no_folder_of_the_machine(linked, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    linked("measured.binary")
    (tmp_path / "model.py").write_text(in_fit("raise RuntimeError('no lamp')"))
    entry = Entry("mine", "mine", source="model.py")
    fit_job([entry.plain], 0, "measured.binary", False, {"mine": ("a.npz", "a.json")}, {"mine": ""}, "made")
    reason = json.loads((tmp_path / "a.json").read_text())["reason"]
    assert "model.py: line" in reason
    assert str(tmp_path) not in reason


def test_what_a_model_prints_is_no_part_of_a_result(linked, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    linked("measured.binary")
    (tmp_path / "model.py").write_text(in_fit("print('step 1')").replace("return np.b", "print('step 1'); return np.b"))
    assert main([*FIT, "--json"]) == 0
    out, err = capsys.readouterr()
    assert json.loads(out)["model"] == "mine"
    assert set(err.splitlines()) == {"step 1"}
    assert main(["export", "out.npz", "-o", "-"]) == 0
    assert json.loads(capsys.readouterr().out)["model"] == "mine"


GOES = {
    "while fitting": in_fit("import os; os.chdir('/')"),
    "while evaluated": OWN_MODEL.replace(
        "        return np.broadcast", "        import os; os.chdir('/')\n        return np.broadcast"
    ),
}


@pytest.mark.parametrize("what", GOES)
def test_a_model_that_leaves_the_folder_takes_no_output_with_it(linked, tmp_path, monkeypatch, capsys, what):
    monkeypatch.chdir(tmp_path)
    linked("measured.binary")
    (tmp_path / "model.py").write_text(GOES[what])
    assert main(FIT) == 0
    assert capsys.readouterr().out.startswith("out.npz: ")
    for command in (["table", "-o", "sub/out.binary"], ["export", "-o", "out.xml", "--to", "mitsuba", "--force"]):
        monkeypatch.chdir(tmp_path)
        loading._from_file.cache_clear()
        assert main([command[0], "out.npz", *command[1:], "--source", "model.py"]) == 0
        assert capsys.readouterr().out.startswith("sub/out.binary: " if "table" in command else "out.xml, out.npz: ")
    monkeypatch.chdir(tmp_path)
    found = sorted(str(path.relative_to(tmp_path)) for path in tmp_path.rglob("out.*"))
    assert found == ["out.npz", "out.xml", "sub/out.binary"]


@pytest.mark.parametrize("what", GOES)
def test_in_a_run_it_stays_in_the_folder(linked, tmp_path, monkeypatch, what):
    """A job's outputs are named from the project's folder."""
    monkeypatch.chdir(tmp_path)
    linked("measured.binary")
    (tmp_path / "model.py").write_text(GOES[what])
    entry = Entry("mine", "mine", source="model.py")
    outputs = "out/mine.npz", "out/mine.json"
    fit_job([entry.plain], 0, "measured.binary", False, {"mine": outputs}, {"mine": ""}, "out/made")
    assert Path.cwd() == tmp_path
    assert {path.name for path in (tmp_path / "out").iterdir()} == {"mine.npz", "mine.json", "made"}


def test_a_title_that_fails_with_an_option_is_told_before_any_work(tmp_path):
    model = OWN_MODEL.replace("Parameter, Result", "Option, Parameter, Result")
    model = model.replace('formula = "a"', 'formula = "a"\n    options = {"k": Option(1, "a number")}')
    (tmp_path / "mine.py").write_text(
        model + "\n    def title_of(self, options):\n        return ('one',)[options['k'] - 1]\n"
    )
    (tmp_path / "rows.yaml").write_text(
        f"mine: {{source: {tmp_path}/mine.py}}\nmore: {{model: mine, source: {tmp_path}/mine.py, k: 2}}\n"
    )
    with pytest.raises(ConfigError, match=r"rows.yaml: more: .*mine.py: line \d+: IndexError"):
        read_entries(tmp_path / "rows.yaml")


def test_a_models_file_that_leaves_the_folder_takes_no_input_with_it(linked, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    linked("measured.binary")
    (tmp_path / "model.py").write_text("import os; os.chdir('/')\n" + OWN_MODEL)
    assert main(FIT) == 0
    assert main(["compare", "out.npz", "measured.binary", "--source", "model.py"]) == 0


BAD_VALUES = {
    "an exception": "raise RuntimeError('no value')",
    "sys.exit": "sys.exit(0)",
    "another shape": "return np.zeros(7)",
    "text": "return 'grey'",
    "none": "return None",
    "truth": "return np.ones(np.shape(wi), bool)",
    "objects": "return np.full(np.shape(wi), None)",
}


@pytest.mark.parametrize("command", [["table", "-o", "out.binary"], ["compare", "measured.binary"]])
@pytest.mark.parametrize("what", BAD_VALUES)
def test_a_fit_that_has_no_values(refused, linked, what, command):
    linked("measured.binary")
    (refused.folder / "model.py").write_text(OWN_MODEL)
    assert main(FIT) == 0
    bad = OWN_MODEL.replace("return np.broadcast_to", BAD_VALUES[what] + "\n        return np.broadcast_to")
    (refused.folder / "model.py").write_text(bad)
    refused([command[0], "out.npz", *command[1:], "--source", "model.py"], "mine on measured: ")


@pytest.mark.parametrize("value", ["np.nan", "np.inf"])
@pytest.mark.parametrize("command", [["table", "-o", "out.binary"], ["compare", "measured.binary"]])
def test_a_fit_of_nan_makes_no_table(refused, linked, value, command):
    linked("measured.binary")
    (refused.folder / "model.py").write_text(OWN_MODEL)
    assert main(FIT) == 0
    bad = OWN_MODEL.replace("return np.broadcast_to", f"return np.full(np.shape(wi), {value})\n        np.broadcast_to")
    (refused.folder / "model.py").write_text(bad)
    refused([command[0], "out.npz", *command[1:], "--source", "model.py"], "out.npz")


LIKE_A_MODULE = """
from __future__ import annotations
import pickle
from dataclasses import dataclass
import typing

@dataclass
class State:
    count: int = 1

assert typing.get_type_hints(State) == {"count": int}
assert pickle.loads(pickle.dumps(State(2))) == State(2)
"""


def test_a_models_file_is_a_module_like_any_other(inputs, tmp_path):
    """Dataclasses, type hints and pickle look for it by its name."""
    (tmp_path / "model.py").write_text(LIKE_A_MODULE + OWN_MODEL)
    assert loading.load_model(name="mine", source=tmp_path / "model.py").title == "Mine"


def test_a_fit_of_ones_own_model_goes_everywhere_with_its_source(linked, tmp_path, capsys, monkeypatch):
    """The fit remembers its model's file; where that has moved, each command says what it needs, and takes it."""
    monkeypatch.chdir(tmp_path)
    linked("measured.binary")
    linked("model.py")
    assert main(FIT) == 0
    commands = (
        ["info", "out.npz"],
        ["table", "out.npz", "-o", "out.binary", "--force"],
        ["export", "out.npz", "-o", "out.json"],
        ["compare", "measured.binary", "out.npz"],
    )
    for command in commands:
        assert main(command) == 0, command
    (tmp_path / "model.py").rename("moved.py")
    for command in commands:
        capsys.readouterr()
        assert main(command) == 1
        err = capsys.readouterr().err
        assert "--source" in err
        assert err.count("\n") == 1
        assert main([*command, "--source", "moved.py"]) == 0, command
    np.testing.assert_allclose(np.nanmax(brdfatlas.read_merl("out.binary").table), 1.0, rtol=1e-6)


def test_what_a_fit_is_judged_by_does_not_change(inputs):
    """A model that gets hold of the table cannot write into it."""
    measured = brdfatlas.read_merl(inputs / "measured.binary")
    before = measured.table.copy()

    class Writer(type(brdfatlas.MODELS["ggx"])):
        name = "writer"

        def fit(self, measured, *, seed=0, **options):
            measured.table[...] = 0
            return Result({}, 0.0, "", 0, True)

    with pytest.raises(FitError, match=r"writer on measured: .*read-only"):
        brdfatlas.fit(Writer(), measured)
    np.testing.assert_array_equal(measured.table, before)
    assert measured.table.flags.writeable


class BrokenPoint:
    """An entry point of another package that does not load."""

    name, value = "theirs", "their_package.models:Theirs"

    def __init__(self, error):
        self.error = error

    def load(self):
        raise self.error


@pytest.mark.parametrize("error", [ImportError("gone"), SystemExit(0), RuntimeError("a\nb"), AttributeError("Theirs")])
def test_a_broken_model_of_another_package_is_left_out(capsys, monkeypatch, error):
    monkeypatch.setattr("brdfatlas.models.loading.entry_points", lambda group: [BrokenPoint(error)])
    assert main(["models", "--json"]) == 0
    out, err = capsys.readouterr()
    assert {"ggx", "sgd"} <= json.loads(out).keys()
    assert err.count("\n") == 1
    assert "theirs" in err
    assert "their_package" in err


@pytest.mark.parametrize("way", ["{there}", "../there", "link"])
@pytest.mark.parametrize("form", ["npz", "json"])
def test_a_fit_of_others_runs_no_file_outside_the_working_directory(refused, tmp_path, monkeypatch, way, form):
    """Unless somebody else than the fit named that file."""
    from brdfatlas.export.fit_json import export_json, import_json

    here, there = tmp_path / "here", tmp_path / "there"
    here.mkdir()
    there.mkdir()
    (here / "link").symlink_to(there)
    monkeypatch.chdir(here)
    model = there / "model.py"
    model.write_text(OWN_MODEL + f"\n\nopen({str(tmp_path / 'ran')!r}, 'w')\n")
    source = f"{way.format(there=there)}/model.py"
    fitted = Fit("mine", "felt", {"a": np.ones(3, np.float32)}, source=source)
    fitted.save("fit.npz")
    if form == "json":
        export_json(fitted, "fit.json")
        (tmp_path / "ran").unlink()
        loading._from_file.cache_clear()
        with pytest.raises(ValueError, match=r"^fit\.json: .*outside the working directory.*--source FILE\.py$"):
            import_json("fit.json")
    else:
        refused(["info", "fit.npz"], "fit.npz: ", "model.py", "outside the working directory", "--source FILE.py")
    assert not (tmp_path / "ran").exists()
    assert main(["info", "fit.npz", "--source", source]) == 0
    assert (tmp_path / "ran").exists()
    monkeypatch.setenv("BRDFATLAS_SOURCES", "")
    name_sources([Entry("row", "mine", source=str(model))])  # as a run does, for its jobs
    assert brdfatlas.load_fit("fit.npz").source == source
    monkeypatch.setenv("BRDFATLAS_SOURCES", "")
    brdfatlas.MODELS.register_file("mine", model)
    assert brdfatlas.load_fit("fit.npz").source == source


def test_rows_of_two_files_have_two_titles(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    text = OWN_MODEL.replace("import Model,", "import Model, Option,")
    text = text.replace('formula = "a"', 'formula = "a"\n    options = {"k": Option(1, "a choice")}')
    header = "material,kd_r,kd_g,kd_b,ks_r,ks_g,ks_b,f0,m\n"
    for number in (1, 2):
        Path(f"v{number}.py").write_text(text)
        Path(f"v{number}.csv").write_text(f"{header}gold,1,1,1,1,1,1,0.5,0.1\n")
    Path("models.yaml").write_text(
        "first: {model: mine, source: v1.py, k: 3}\nsecond: {model: mine, source: v2.py, k: 3}\n"
        "ngan_published: {model: ngan, parameters: v1.csv}\nours_published: {model: ngan, parameters: v2.csv}\n"
    )
    titles = [entry.title for entry in read_entries("models.yaml").values()]
    assert len(set(titles)) == 4
    assert titles[2].endswith(", published")


@pytest.mark.parametrize(
    "details",
    [
        "{'bound': 0.5}",
        "{'bound': {'held': 3, 'count': 4, 'value': 0.0}}",
        "{'bounds': 3}",
        "{'channels': 3}",
        "{'channels': ['red', 'green', 'blue']}",
        "{'channels': [{'starts': 3}] * 3}",
        "{'channels': [{'history': 'abc'}] * 3}",
        "{'channels': [{'history': [np.nan] * 9}] * 3}",
        "{'channels': [{'golden_section_calls': 'many'}] * 3}",
        "[1, 2]",
    ],
)
def test_details_may_have_the_names_of_ours_and_another_meaning(linked, tmp_path, monkeypatch, details):
    monkeypatch.chdir(tmp_path)
    Path("model.py").write_text(OWN_MODEL.replace("1, True)", f"1, True, details={details})"))
    entry = Entry("mine", "mine", source="model.py")
    brdfatlas.MODELS.use([entry])
    binary = str(linked("measured.binary"))
    outputs = {"mine": ("fits/mine.npz", "fits/mine.json")}
    fit_job([entry.plain], 0, binary, False, outputs, {"mine": ""}, "made")
    figures_job(binary, ["mine"], "fits", "measured", "figures.json")
    write_json("facts.json", {"name": "measured", "class": "glossy"})
    material = read_material("facts.json", ["fits/mine.json"])
    summary = summarise_run([material], {"mine": model_facts("mine")})
    assert [made.bounds for made in make_entries(material, summary, [SceneFacts("studio")], None)] == [""]


@pytest.mark.parametrize(
    ("options", "fault"),
    [("{**OPTIONS}", ""), ("property(lambda self: OPTIONS)", "options is a property")],
)
def test_a_row_has_its_options_or_is_refused(tmp_path, monkeypatch, options, fault):
    """Pages state the defaults of the class however it states them."""
    monkeypatch.chdir(tmp_path)
    text = with_options("0").replace("options = {'k': 0}", f"options = {options}")
    text = text.replace("class Mine", "OPTIONS = {'k': Option('x', 'a choice', ('x', 'y'))}\n\n\nclass Mine")
    Path("mine.py").write_text(text)
    Path("rows.yaml").write_text("mine: {source: mine.py}\n")
    brdfatlas.MODELS.use(read_entries("rows.yaml").values())
    assert model_facts("mine").options[0]["default"] == "x"
    Path("rows.yaml").write_text("mine: {source: mine.py, k: y}\n")
    if fault:
        with pytest.raises(ConfigError, match=fault):
            read_entries("rows.yaml")
    else:
        assert read_entries("rows.yaml")["mine"].instance.check_options({}) == {"k": "y"}


def test_with_options_gives_a_model(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("mine.py").write_text(OWN_MODEL + "\n    def with_options(self, options):\n        return None\n")
    Path("rows.yaml").write_text("mine: {source: mine.py}\n")
    with pytest.raises(ConfigError, match=r"mine\.py: TypeError: with_options gives a NoneType"):
        read_entries("rows.yaml")


@pytest.mark.parametrize("how", ["spawn", "forkserver"])
def test_workers_that_a_model_starts_find_its_functions(linked, tmp_path, how):
    """They were started for ever. In a process of its own: workers import the main program."""
    linked("measured.binary")
    text = in_fit(f"with multiprocessing.get_context({how!r}).Pool(1) as pool: print(pool.map(twice, [1, 2]))")
    text = text.replace("import sys", "import multiprocessing\nimport sys")
    (tmp_path / "model.py").write_text(text.replace("class Mine", "def twice(x):\n    return 2 * x\n\n\nclass Mine"))
    done = subprocess.run(
        [sys.executable, "-m", "brdfatlas", *FIT], cwd=tmp_path, capture_output=True, text=True, timeout=120
    )
    assert done.returncode == 0, done.stderr
    assert "[2, 4]" in done.stdout
    assert "Traceback" not in done.stderr


def test_two_files_of_one_name_are_two_modules(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    fails = "\n    def title_of(self, options):\n        return 'Mine' if options['k'] == 'x' else 1 / 0\n"
    for folder, more in {"a": fails, "b": "\n"}.items():
        Path(folder).mkdir()
        Path(folder, "mine.py").write_text(with_options("Option('x', 'a choice', ('x', 'y'))") + more)
    rows = ("a: {model: mine, source: a/mine.py}", "b: {model: mine, source: b/mine.py}")
    Path("rows.yaml").write_text("\n".join([*rows, "c: {model: mine, source: a/mine.py, k: y}\n"]))
    with pytest.raises(ConfigError, match=r"c: .*a/mine\.py: line"):
        read_entries("rows.yaml")


def test_a_moved_fit_takes_the_file_of_its_own_row(linked, tmp_path, monkeypatch):
    """Two files hold a class of one name; the first one's was taken for both."""
    measured = brdfatlas.read(linked("measured.binary"))
    fits, wi = {}, np.array([0.6, 0.0, 0.8])
    monkeypatch.chdir(tmp_path)
    for name, gain in {"one": 1, "two": 2}.items():
        text = OWN_MODEL.replace('parameters["a"],', f'{gain} * parameters["a"],')
        Path(f"{name}.py").write_text(text)
        fits[name] = brdfatlas.fit(Entry(name, "mine", source=f"{name}.py"), measured)
        fits[name].save(f"{name}.npz")
    (tmp_path / "moved").mkdir()
    monkeypatch.chdir(tmp_path / "moved")
    brdfatlas.MODELS.use(Entry(name, "mine", source=str(tmp_path / f"{name}.py")) for name in fits)
    for name, fitted in fits.items():
        np.testing.assert_array_equal(brdfatlas.load_fit(f"../{name}.npz").evaluate(wi, wi), fitted.evaluate(wi, wi))
    brdfatlas.MODELS.use([Entry("other", "mine", source=str(tmp_path / "two.py"))])
    Fit("mine", "m", fits["one"].parameters, {}, entry="third", source="gone.py").save("third.npz")
    with pytest.raises(ValueError, match=r"gone\.py"):
        brdfatlas.load_fit("third.npz")


def test_a_model_in_python_has_a_name_of_its_own(linked):
    """Saved, its fit would be one of the package's model."""
    measured = brdfatlas.read(linked("measured.binary"))

    class Mine(type(brdfatlas.MODELS["lambert"])):
        pass

    with pytest.raises(ValueError, match=r"lambert.*another name"):
        brdfatlas.fit(Mine(), measured)


def material_of(target, text):
    hook = f"\n    targets = ({target!r},)\n    def material(self, parameters, target):\n        return {text}\n"
    return OWN_MODEL + hook


def test_a_material_of_numpy_values_and_another_plugin_is_read_by_mitsuba(linked, tmp_path, monkeypatch, capsys):
    mitsuba = pytest.importorskip("mitsuba")
    monkeypatch.chdir(tmp_path)
    linked("measured.binary")
    colour = "{'type': 'rgb', 'value': parameters['a'] / 4}"
    plastic = (
        f"{{'type': 'roughplastic', 'alpha': np.float32(0.5), 'nonlinear': True, 'diffuse_reflectance': {colour}}}"
    )
    (tmp_path / "model.py").write_text(material_of("mitsuba", f"{{'type': 'twosided', 'bsdf': {plastic}}}"))
    assert main(FIT) == 0
    assert main(["export", "out.npz", "--to", "mitsuba", "-o", "out.xml"]) == 0
    mitsuba.set_variant("scalar_rgb")
    told = str(mitsuba.load_file("out.xml"))
    assert "alpha = 0.5" in told
    assert "0.25, 0.25, 0.25" in told


@pytest.mark.parametrize("target", ["mitsuba", "materialx", "gltf"])
@pytest.mark.parametrize(
    "material", ["{'kind': 'x'}", "{'type': 'diffuse', 'reflectance': {}, 'node': 'x', 'inputs': 3}"]
)
def test_a_material_that_is_none_fails_its_export_alone(linked, tmp_path, monkeypatch, target, material):
    monkeypatch.chdir(tmp_path)
    linked("measured.binary")
    (tmp_path / "model.py").write_text(material_of(target, material))
    assert main(FIT) == 0
    write_fit_files([Path("out.npz")], tmp_path / "m" / "fits")
    assert (tmp_path / "m" / "fits" / "m-out.npz").is_file()
