"""Arguments, help, interrupts and pipes; and directions that are none."""

import contextlib
import errno
import os
import re
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from own_model import OWN_MODEL

import brdfatlas
from brdfatlas.angles import GRID_SHAPE, above_horizon
from brdfatlas.cli import main, parser
from brdfatlas.export.targets import targets_of
from brdfatlas.formats.merl import write_merl
from brdfatlas.measures.tsv import read_tsv, write_tsv

RENDER = ["render", "measured.binary", "-o", "out.exr"]
FIT = ["fit", "ggx", "measured.binary", "-o", "out.npz"]
ERRORS = ["image-errors", "picture.exr", "picture.exr"]
CONVERT = ["convert", "measured.binary", "-o", "out.csv"]
BEYOND = ("1_0", "\u0663", "-1", "4294967296", "1e3", "1.5", "", "ten", "9" * 500, "0x10", "nan")
BAD_NUMBERS = [(FIT, "--seed", text) for text in BEYOND] + [(RENDER, "--seed", text) for text in BEYOND]
BAD_NUMBERS += [(RENDER, "--size", text) for text in ("0", "3_2", "-8", "4097", "100000", "1e2", "big")]
BAD_NUMBERS += [(RENDER, "--spp", text) for text in ("0", "-1", "7", "1000000000000", "1e30", "inf")]
BAD_NUMBERS += [
    (CONVERT, "--step", text) for text in ("1e-300", "1e-3", "0.99", "1000", "45.1", "nan", "inf", "-5", "1_0")
]
BAD_NUMBERS += [
    (ERRORS, key, text)
    for key in ("--gamma", "--exposure")
    for text in ("0", "-1", "nan", "inf", "x", "1e300", "1e-300")
]


@pytest.mark.parametrize(("command", "key", "text"), BAD_NUMBERS)
def test_a_number_out_of_range(refused, command, key, text):
    refused([*command, f"{key}={text}"], key, "is not a", status=2)


BAD_LINES = {
    "no command": [],
    "an unknown command": ["fti", "ggx"],
    "no file": ["info"],
    "an unknown option": ["info", "a.binary", "--jsn"],
    "no output": ["fit", "ggx", "a.binary"],
    "an output without a name": ["fit", "ggx", "a.binary", "-o"],
    "a line break in a command": ["fit\nggx"],
    "an escape in an option": ["info", "a.binary", "--\x1b[31m"],
    "two sets of directions": [*CONVERT, "--like", "a.csv", "--step", "5"],
    "two targets": ["export", "a.npz", "-o", "a.json", "--to", "merl", "--sampler"],
    "two outputs": [*FIT, "--output", "b.npz"],
    "two sizes": [*RENDER, "--size", "8", "--size", "16"],
    "another integrator": ["render", "a.binary", "-o", "a.exr", "--integrator", "volume"],
}


@pytest.mark.parametrize("what", BAD_LINES)
def test_a_wrong_command_line_is_one_line(refused, what):
    refused(BAD_LINES[what], "--help", status=2)


BAD_OPTIONS = [
    "colour=1",
    "colour",
    "=1",
    "",
    "start=",
    "start=[1, 2]",
    "start={}",
    "start=null",
    "start=NaN",
    "a\nb=1",
    "objective=" + 50_000 * "[",
    "objective=" + 50_000 * "a",
    "starts=" + 5_000 * "9",
    "starts=" + 23 * "9",
    "starts=1e400",
    100_000 * "k" + "=1",
]


@pytest.mark.parametrize("option", BAD_OPTIONS)
def test_an_option_of_a_model(refused, linked, option):
    linked("measured.binary")
    command = [item.replace("ggx", "ward") for item in FIT]
    assert len(refused([*command, "--option", option])) < 1000


@pytest.mark.parametrize("model", ["ward", "sgd", "gltf"])
def test_an_option_has_an_end_and_stands_once(refused, linked, model):
    linked("measured.binary")
    command = [item.replace("ggx", model) for item in FIT]
    refused([*command, "--option", "starts=10001"], "starts = 10001 is not a whole number of 1 to 10000")
    refused([*command, "--option", "starts=5", "--option", "starts=5"], "starts", "twice")


@pytest.mark.parametrize(("message", "told"), [("", "did not converge, "), ("why", "did not converge (why), ")])
def test_a_fit_that_did_not_converge_says_no_more_than_it_knows(linked, tmp_path, monkeypatch, capsys, message, told):
    monkeypatch.chdir(tmp_path)
    linked("measured.binary")
    (tmp_path / "model.py").write_text(OWN_MODEL.replace('"none", 1, True', f'"none", 1, False, "{message}"'))
    assert main(["fit", "mine", "measured.binary", "--source", "model.py", "-o", "out.npz"]) == 0
    assert told in capsys.readouterr().out


def black(folder):
    table = np.zeros((*GRID_SHAPE, 3), np.float32)
    table[~above_horizon()] = np.nan
    write_merl(folder / "black.binary", table)


def test_a_black_material_is_named_before_any_fit(refused):
    black(refused.folder)
    told = refused(["recommend", "black.binary", "--models", "lambert"], "black.binary: black, no value is above 0")
    assert "fit 1" not in told


@pytest.mark.parametrize("size", [1, 2])
def test_a_picture_too_small_for_its_scene_says_so(refused, linked, size):
    linked("measured.binary")
    told = f"no pixel of {size} x {size} shows the material alone; take a larger size"
    refused(["render", "measured.binary", "--size", size, "--spp", "8", "-o", "out.exr"], told)


def test_an_uber_texture_names_the_models_that_it_holds(refused, linked, inputs):
    linked("lambert.npz")
    told = refused(["uber-texture", "lambert.npz", "-o", "out.exr"], "not lambert; those are ")
    for name in told.rstrip().split("those are ")[1].split(", "):
        assert main(["uber-texture", str(inputs / f"{name}.npz"), "-o", f"{name}.exr"]) == 0


def test_what_a_library_prints_of_a_damaged_picture_is_no_part_of_the_result(inputs, tmp_path):
    """OpenEXR prints of what it cannot read."""
    data = (inputs / "picture.exr").read_bytes()
    (tmp_path / "picture.exr").write_bytes(data)
    (tmp_path / "bad.exr").write_bytes(data[: len(data) // 2] + bytes(40) + data[len(data) // 2 + 40 :])
    code = "import sys; from brdfatlas.cli import main; sys.exit(main(['image-errors', 'picture.exr', 'bad.exr']))"
    process = in_a_process(code, cwd=tmp_path)
    out, err = process.communicate()
    assert (process.returncode, out) == (1, "")
    assert "bad.exr: not a readable EXR" in err.splitlines()[-1]
    assert len(err.splitlines()) > 1  # else it does not show what it is to show


NOT_REPLACED = ["~/a.npz", "~user/a.npz", "$HOME/a.npz", "file:///tmp/a.npz", "out/s3:/a.npz"]


@pytest.mark.parametrize("output", NOT_REPLACED)
def test_what_a_shell_has_not_replaced_makes_no_folder(refused, linked, output):
    """``--output=~/a.npz`` reaches a command as it stands."""
    linked("measured.binary")
    refused([*FIT[:-1], output], output, "write the path in full")
    folder = output.removesuffix("/a.npz")
    refused(["recommend", "measured.binary", "--models", "lambert", "-o", folder], "write the path in full")


def test_standard_output_is_no_folder(refused, linked):
    linked("measured.binary")
    refused(["recommend", "measured.binary", "--models", "lambert", "-o", "-"], "several files", "name a folder")


def test_a_folder_of_any_name_that_is_there_is_used(linked, tmp_path, monkeypatch):
    linked("measured.binary")
    monkeypatch.chdir(tmp_path)
    (tmp_path / "~").mkdir()
    assert main([*FIT[:-1], "~/a.npz"]) == 0
    assert (tmp_path / "~" / "a.npz").exists()


NO_NAME = [
    ["info", ""],
    ["fit", "lambert", "", "-o", "a.npz"],
    ["fit", "lambert", "measured.binary", "-o", ""],
    ["fit", "lambert", "measured.binary", "-o", "a.npz", "--source", ""],
    ["compare", "measured.binary", ""],
    ["standin", "chrome", "-o", ""],
]


@pytest.mark.parametrize("line", NO_NAME, ids=" ".join)
def test_an_empty_name_is_told(refused, linked, line):
    linked("measured.binary")
    refused(line, "empty name", "variable of the shell")


@pytest.mark.parametrize("output", ["", ".", "..", "/", "out/", "a" * 300 + ".npz", "x/" * 3000 + "a.npz"])
def test_an_output_that_cannot_be(refused, linked, output):
    linked("measured.binary")
    line = [*FIT[:-1], output]
    refused(line)


@pytest.mark.parametrize("line", [[*FIT[:-1], "new/" + "é" * 128], ["recommend", "measured.binary", "-o", "a" * 256]])
def test_a_name_that_no_file_system_holds_is_told_before_any_work(refused, linked, monkeypatch, line):
    linked("measured.binary")
    monkeypatch.setattr("brdfatlas.cli.commands.fit", None)
    monkeypatch.setattr(sys.modules["brdfatlas.recommend"], "recommend", None)
    refused(line, "choose a shorter one")


@pytest.mark.parametrize("variant", ["cuda_ad_rgb", "llvm_ad_rgbx", "", "scalar"])
def test_a_variant_that_this_machine_has_not(refused, linked, variant):
    from brdfatlas.rendering import use_variant

    if variant.startswith("cuda"):
        import drjit as dr

        if dr.has_backend(dr.JitBackend.CUDA):
            pytest.skip("this machine has a GPU")
    linked("measured.binary")
    use_variant("llvm_ad_rgb")
    refused([*RENDER, "--variant", variant], "variant")


def test_every_option_has_a_text_and_its_default():
    commands = next(action for action in parser()._actions if action.dest == "command").choices
    for name, command in commands.items():
        text = " ".join(command.format_help().split())
        for action in command._actions:
            assert action.help, f"{name} {action.dest}"
            if action.default not in (None, False, [], "==SUPPRESS=="):
                assert f"(default: {action.default})" in text, f"{name} {action.dest}"


def test_standin_lists_its_materials(capsys, refused):
    assert main(["standin", "--list"]) == 0
    names = capsys.readouterr().out.split()
    assert len(names) == 100
    assert "chrome" in names
    refused(["standin"], "--list")
    refused(["standin", "chrome"], "--list")
    refused(["standin", "chrom", "-o", "a.binary"], "chrome")


@pytest.mark.parametrize("model", list(brdfatlas.MODELS))
def test_info_says_what_a_fit_is(capsys, inputs, model):
    assert main(["info", str(inputs / f"{model}.npz")]) == 0
    told = capsys.readouterr().out
    assert f"a fit of {model} " in told
    assert "felt (a stand-in)" in told


@pytest.mark.parametrize("model", list(brdfatlas.MODELS))
def test_info_says_what_an_export_is(capsys, refused, inputs, model):
    path = str(inputs / f"{model}.npz")
    for target in targets_of(brdfatlas.load_fit(path)):
        assert main(["export", path, "--to", target, "-o", f"out.{target}"]) == 0
    capsys.readouterr()
    for item in (path, "out.json"):
        assert main(["info", item, "--json"]) == 0
    one, other = capsys.readouterr().out.split("\n}\n")[:2]
    assert one == other
    kinds = {"mitsuba": "XML", "materialx": "MaterialX", "gltf": "glTF", "sampler": "JSON"}
    for target in kinds.keys() & targets_of(brdfatlas.load_fit(path)):
        refused(["info", f"out.{target}"], f"out.{target}: {kinds[target]} that brdfatlas wrote, no measurement")


def test_a_list_of_standins_writes_nothing_and_says_so(refused):
    refused(["standin", "--list", "chrome", "-o", "chrome.binary"], "--list writes no file")


@pytest.mark.parametrize(("key", "value", "words"), [("scene", "b", "shows b"), ("status", "failed", "failed")])
def test_image_errors_compare_what_can_be_compared(refused, inputs, linked, key, value, words):
    from brdfatlas.rendering.images import load_render, save_render

    linked("picture.exr")
    render = load_render("picture.exr")
    save_render("other.exr", replace(render, meta=dict(render.meta) | {key: value}))
    refused(["image-errors", "picture.exr", "other.exr"], "picture.exr" if key == "scene" else "other.exr", words)


def test_image_errors_of_a_picture_that_is_no_exr(refused, inputs, linked):
    from brdfatlas.rendering.images import load_render, save_picture

    linked("picture.exr")
    save_picture("picture.png", load_render("picture.exr"))
    refused(["image-errors", "picture.exr", "picture.png"], "picture.png", "another kind of file", ".exr")


@pytest.mark.parametrize("value", ["0", "-1", "nan", "inf", "bright"])
@pytest.mark.parametrize("key", ["exposure", "gamma"])
def test_image_errors_by_a_tone_map_that_is_none(refused, linked, key, value):
    from brdfatlas.rendering.images import load_render, save_render

    linked("picture.exr")
    render = load_render("picture.exr")
    save_render("other.exr", replace(render, meta=dict(render.meta) | {key: value}))
    refused(["image-errors", "other.exr", "picture.exr"], "other.exr", f"{key} is '{value}'", f"--{key}")
    assert main(["image-errors", "other.exr", "picture.exr", f"--{key}", "2"]) == 0


def test_image_errors_of_another_size_or_of_nothing(refused, linked):
    from brdfatlas.rendering.images import Render, save_render

    linked("picture.exr")
    for name, value, size in (("small", 1.0, 4), ("black", 0.0, 8), ("nan", np.nan, 8)):
        mean = np.full((size, size, 3), value, np.float32)
        save_render(f"{name}.exr", Render(mean, mean[None], np.ones((size, size), bool)))
    refused(["image-errors", "picture.exr", "small.exr"], "small.exr", "sizes")
    refused(["image-errors", "black.exr", "picture.exr"], "black.exr", "black")
    refused(["image-errors", "picture.exr", "nan.exr"], "nan.exr", "NaN")


@pytest.mark.parametrize(("exposure", "words"), [("1e6", "white all over"), ("1e-6", "black all over")])
def test_pictures_that_show_nothing_are_not_called_alike(refused, linked, exposure, words):
    from brdfatlas.rendering.images import Render, save_render

    for name, value in (("one", 0.2), ("two", 0.4)):
        mean = np.full((16, 16, 3), value, np.float32)
        save_render(f"{name}.exr", Render(mean, mean[None], np.ones((16, 16), bool)))
    refused(["image-errors", "one.exr", "two.exr", "--exposure", exposure], words, "choose others")


NO_NAMES = ("_rgb.binary", "a\nb.binary", "f\udcff.binary", "\x1b[31m.binary")


@pytest.mark.parametrize("name", NO_NAMES)
@pytest.mark.parametrize("command", [["fit", "lambert", "-o", "out.npz"], ["recommend", "--models", "lambert"]])
def test_a_material_without_a_name_is_not_fitted(refused, linked, name, command):
    """No later command would take the fit."""
    linked("measured.binary").rename(name)
    refused([*command, f"./{name}"], "rename the file")


@pytest.mark.parametrize("name", ["", 5, None, "a" * 256, "a\0"])
def test_a_material_without_a_name_in_python(inputs, name):
    measured = replace(brdfatlas.read(inputs / "measured.binary"), name=name)
    for work in (lambda: brdfatlas.fit("lambert", measured), lambda: brdfatlas.recommend(measured, models=["lambert"])):
        with pytest.raises(ValueError, match="printable characters"):
            work()


NO_WINNER = [
    (["--models", "ggx", "--for", "gltf"], "exact in gltf", "lambert"),
    (["--models", "ggx", "--budget", "100"], "at most 100 bytes", "lambert"),
    (["--budget", "11"], "at most 11 bytes", "relax a condition"),
    (["--models", "lawrence", "--budget", "11"], "at most 11 bytes", "relax a condition"),
    (["--models", "lambert, ggx", "--budget", "1"], "at most 1 bytes", "relax a condition"),
    (["--models", "principled", "--for", "gltf", "--budget", "20"], "gltf and fitted in at most 20 bytes", "lambert"),
    (["--models", ""], "unknown model ''", "lambert"),
    (["--models", "lambert,"], "unknown model ''", "lambert"),
]


@pytest.mark.parametrize(("conditions", "fault", "remedy"), NO_WINNER)
def test_conditions_that_no_model_meets(refused, linked, conditions, fault, remedy):
    linked("measured.binary")
    refused(["recommend", "measured.binary", *conditions], fault, remedy)


ENDS = [(KeyboardInterrupt, 130, "interrupted"), (MemoryError, 1, "memory")]


@pytest.mark.parametrize(("error", "status", "words"), ENDS)
@pytest.mark.parametrize("command", [["models"], ["info", "x"], ["table", "x.npz", "-o", "y.binary"]])
def test_an_interrupt_is_one_line(refused, monkeypatch, command, error, status, words):
    def interrupted(*arguments, **options):
        raise error

    monkeypatch.setattr("brdfatlas.cli.commands.MODELS", type("M", (), {"__iter__": interrupted})())
    monkeypatch.setattr("brdfatlas.cli.commands.load_fit", interrupted)
    monkeypatch.setattr("brdfatlas.cli.commands.read_merl", interrupted, raising=False)
    monkeypatch.setattr("brdfatlas.cli.commands.read", interrupted, raising=False)
    refused(command, words, status=status)


def in_a_process(code, stdout=subprocess.PIPE, cwd=None, **environment):
    """Run Python with the package, in a process of its own."""
    env = os.environ | {"PYTHONPATH": str(Path(brdfatlas.__file__).parents[1])} | environment
    command = [sys.executable, "-c", code]
    return subprocess.Popen(command, env=env, cwd=cwd, stdout=stdout, stderr=subprocess.PIPE, text=True)


def test_a_reader_that_has_enough_ends_the_command_quietly():
    process = in_a_process("import sys; from brdfatlas.cli import main; sys.exit(main(['models', '--json']))")
    process.stdout.readline()
    process.stdout.close()
    err = process.stderr.read()
    assert process.wait() in (0, 141)
    assert err == ""


def test_a_full_standard_output_is_named():
    code = "import sys; from brdfatlas.cli import main; sys.exit(main(['standin', '--list']))"
    with open("/dev/full", "w") as full:
        process = in_a_process(code, stdout=full)
    assert process.communicate()[1] == "brdfatlas standin: standard output: No space left on device\n"
    assert process.returncode == 1


def test_a_working_folder_that_is_gone(inputs, tmp_path):
    line = ["table", str(inputs / "lambert.npz"), "-o", "out.binary"]
    code = f"import os, sys; os.rmdir(os.getcwd()); from brdfatlas.cli import main; sys.exit(main({line!r}))"
    process = in_a_process(code, cwd=tmp_path)
    out, err = process.communicate()
    assert (process.returncode, out) == (1, "")
    assert err == "brdfatlas table: the working folder is gone; change to one that exists\n"


class Own(BaseException):
    """As a model may raise."""


@pytest.mark.parametrize("error", [GeneratorExit, Own])
def test_a_fault_that_is_no_exception_is_one_line_too(refused, linked, monkeypatch, error):
    def fail(*arguments, **options):
        raise error

    linked("measured.binary")
    monkeypatch.setattr("brdfatlas.cli.commands.fit", fail)
    refused(FIT, error.__name__)


def test_closed_streams_are_no_fault_and_no_file_takes_their_place(inputs, tmp_path):
    code = (
        "import os, sys; [os.close(n) for n in (0, 1, 2)]; sys.stdin = sys.stdout = sys.stderr = None\n"
        "import brdfatlas.cli as cli, brdfatlas.cli.commands\n"
        "status = cli.main(['info', sys.argv[1]])\n"
        "open(sys.argv[2], 'w').write(f'{status} {os.readlink(\"/proc/self/fd/1\")}')"
    )
    command = [sys.executable, "-c", code, str(inputs / "ggx.npz"), str(tmp_path / "out")]
    env = os.environ | {"PYTHONPATH": str(Path(brdfatlas.__file__).parents[1])}
    assert subprocess.run(command, env=env).returncode == 0
    assert (tmp_path / "out").read_text() == f"0 {os.devnull}"


def test_an_interrupt_of_the_process_is_one_line(inputs, tmp_path):
    code = (
        "import sys, time, brdfatlas.cli as cli, brdfatlas.cli.commands\n"
        "brdfatlas.cli.commands.fit = lambda *a, **k: (print('ready', flush=True), time.sleep(600))\n"
        f"sys.exit(cli.main(['fit', 'ggx', {str(inputs / 'measured.binary')!r}, '-o', {str(tmp_path / 'a.npz')!r}]))"
    )
    process = in_a_process(code)
    assert process.stdout.readline() == "ready\n"
    process.send_signal(signal.SIGINT)
    out, err = process.communicate()
    assert (process.returncode, out) == (130, "")
    assert err == "brdfatlas: interrupted, nothing was written\n"
    assert not list(tmp_path.iterdir())


def test_names_that_are_no_text_in_this_locale_are_printed(inputs, tmp_path):
    code = (
        "import os, sys; from brdfatlas.cli import main\n"
        f"output = os.fsdecode({os.fsencode(tmp_path)!r} + b'/f\\xff.binary')\n"
        f"sys.exit(main(['table', {str(inputs / 'ggx.npz')!r}, '-o', output]))"
    )
    process = in_a_process(code, LC_ALL="C", PYTHONUTF8="0", PYTHONCOERCECLOCALE="0")
    out, err = process.communicate()
    assert (process.returncode, err) == (0, "")
    assert out.count("\n") == 1
    assert len(list(tmp_path.iterdir())) == 1


def test_the_package_works_where_compiled_code_cannot_be_kept():
    """numba without any place for its cache, as with a read-only package and home: one line, and a right answer."""
    code = (
        "import numba.core.caching as caching\n"
        "for kind in (caching.CacheImpl, caching.CompileResultCacheImpl, caching.CodeLibraryCacheImpl):\n"
        "    kind._locator_classes = []\n"
        "import numpy as np, brdfatlas.measured as m\n"
        "print(m.look_up(np.ones((90, 90, 180, 3), np.float32), [0, 0, 1], [0, 0.6, 0.8]))"
    )
    out, err = in_a_process(code).communicate()
    assert out == "[1. 1. 1.]\n"
    assert err.count("\n") == 1
    assert "NUMBA_CACHE_DIR" in err


def test_every_compiled_function_is_made_by_our_njit():
    root = Path(brdfatlas.__file__).parent
    for path in root.rglob("*.py"):
        if path.name != "compiled.py":
            assert "from numba import njit" not in path.read_text(), path


NOWHERE = [[np.nan, 0, 1], [0, 0, np.nan], [np.nan] * 3, [np.inf, 0, 0], [0, -np.inf, 1]]


@pytest.mark.parametrize("model", list(brdfatlas.MODELS))
def test_nan_in_nan_out(inputs, model):
    """One rule for every fit: a direction that is none has no value, and costs its neighbours nothing."""
    fitted = brdfatlas.load_fit(inputs / f"{model}.npz")
    up, aside = np.array([0.0, 0.0, 1.0]), np.array([0.6, 0.0, 0.8])
    expected = fitted.evaluate(up, aside)
    for bad in NOWHERE:
        for wi, wo in ((bad, aside), (up, bad), (bad, bad)):
            assert np.isnan(fitted.evaluate(wi, wo)).all()
        several = fitted.evaluate(np.array([up, bad, up]), aside)
        assert np.isnan(several).any(-1).tolist() == [False, True, False]
        np.testing.assert_array_equal(several[[0, 2]], [expected, expected])


WORDS = st.text(st.characters(codec="utf-8", exclude_characters="\r\0"), max_size=12)
CELLS = st.one_of(
    WORDS, st.sampled_from(["=1+1", "+1", "-1", "@SUM(A1)", "'=1", "''=1", "'", "\t=1", "null", "NA", "nan", '"', ""])
)


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(cells=st.lists(st.tuples(CELLS, CELLS), min_size=1, max_size=5))
def test_tables_come_back_and_no_cell_is_a_formula(tmp_path, cells):
    table = pd.DataFrame({"material": [a for a, _ in cells], "reason": [b for _, b in cells], "psnr": 1.5})
    write_tsv(tmp_path / "a.tsv", table)
    pd.testing.assert_frame_equal(read_tsv(tmp_path / "a.tsv"), table, check_dtype=False)
    raw = pd.read_csv(tmp_path / "a.tsv", sep="\t", dtype=str, na_filter=False)
    for cell in [*raw["material"], *raw["reason"]]:
        assert not cell.startswith(("=", "+", "-", "@", "\t"))


def test_negative_numbers_stay_numbers(tmp_path):
    write_tsv(tmp_path / "a.tsv", pd.DataFrame({"material": ["x"], "psnr": [-1.5]}))
    assert read_tsv(tmp_path / "a.tsv")["psnr"][0] == -1.5
    assert "'" not in (tmp_path / "a.tsv").read_text()


@pytest.mark.parametrize("threads", ["0", "-1"])
def test_numba_without_a_thread_is_one_line(threads):
    """Numba's import fails, before the command itself begins. A program that imports the package is not ended so."""
    code = "import sys; sys.argv = ['/usr/bin/brdfatlas', 'models']; from brdfatlas.cli import main; sys.exit(main())"
    process = in_a_process(code, NUMBA_NUM_THREADS=threads)
    out, err = process.communicate()
    assert (process.returncode, out) == (1, "")
    assert err == "brdfatlas: NUMBA_NUM_THREADS: less than one thread; set it to 1 or more, or unset it\n"
    process = in_a_process(code.replace("/usr/bin/brdfatlas", "mine.py"), NUMBA_NUM_THREADS=threads)
    assert "ValueError: Number of threads" in process.communicate()[1]


@pytest.mark.parametrize("text", ["abc", "", "1.5", "9" * 30])
def test_a_time_that_is_none_is_told_with_its_variable(text):
    """NumPy's and Matplotlib's own error does not name it."""
    told = f"SOURCE_DATE_EPOCH: {text!r} is no time in whole seconds; correct it, or unset it\n"
    for program, begin in (("/usr/bin/brdfatlas", "brdfatlas: "), ("mine.py", "ValueError: ")):
        process = in_a_process(f"import sys; sys.argv = [{program!r}]; import brdfatlas", SOURCE_DATE_EPOCH=text)
        err = process.communicate()[1]
        assert process.returncode == 1
        assert err.endswith(begin + told)


def test_the_package_is_the_command():
    code = "import runpy, sys; sys.argv = ['x', 'info', '']; runpy.run_module('brdfatlas', run_name='__main__')"
    out, err = (process := in_a_process(code)).communicate()
    assert (process.returncode, out) == (1, "")
    assert err.startswith("brdfatlas info: ")


def test_a_limit_on_open_files_is_told_with_its_remedy(linked, monkeypatch, capsys):
    path = linked("measured.binary")

    def full(*_, **__):
        raise OSError(errno.EMFILE, os.strerror(errno.EMFILE), "/tmp/x")

    monkeypatch.setattr("tempfile.TemporaryDirectory", full)
    assert main(["recommend", str(path), "--models", "lambert,ggx"]) == 1
    assert "Too many open files; allow more, `ulimit -n " in capsys.readouterr().err


def test_a_full_folder_of_temporary_files_is_told_with_its_remedy(linked, monkeypatch, capsys):
    path = linked("measured.binary")

    def full(*_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(Path, "write_bytes", full)
    assert main(["recommend", str(path), "--models", "lambert,ggx"]) == 1
    told = capsys.readouterr().err
    assert re.fullmatch(r"brdfatlas recommend: .*/brdfatlas\.\S+: No space left on device; set TMPDIR .*\n", told)


JOB = "/study/.snakemake/scripts/tmp1.fit_models.py"


@pytest.mark.parametrize(
    ("program", "words"), [("/usr/bin/brdfatlas", ""), (JOB, ""), ("mine.py", "KeyboardInterrupt")]
)
def test_an_interrupt_of_the_imports_ends_the_command_and_jobs_alone_quietly(program, words):
    code = f"import os, sys; sys.argv = [{program!r}]; import brdfatlas; os.kill(os.getpid(), 2)"
    process = in_a_process(code)
    out, err = process.communicate()
    assert (process.returncode, out) == (-signal.SIGINT, "")
    assert bool(err) == bool(words)
    assert words in err


def test_an_interrupt_of_a_job_at_work_is_one_line(tmp_path):
    code = (
        f"import os, sys; sys.argv = [{JOB!r}]; from brdfatlas.pipeline.logs import logged\n"
        f"with logged({str(tmp_path / 'log')!r}): os.kill(os.getpid(), 2)"
    )
    process = in_a_process(code)
    assert process.communicate() == ("", f"KeyboardInterrupt (log: {tmp_path / 'log'})\n")
    assert process.returncode == 1


WORKERS = """
import os, signal, sys, time
from brdfatlas.recommend import _fit_all
class Slow:
    name, bytes = "slow", 1
    def __reduce__(self):
        return time.sleep, (600,)
if __name__ == "__main__":
    try:
        for _ in _fit_all(None, [Slow(), Slow()], 0, 2):
            pass
    except KeyboardInterrupt:
        print("ended", file=sys.stderr)
"""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_workers_of_a_recommendation_end_with_it(tmp_path, number):
    """Ctrl-C, which reaches them too, is a line and not a traceback of each; a killed command leaves none behind."""
    (tmp_path / "workers.py").write_text(WORKERS)
    env = os.environ | {"PYTHONPATH": str(Path(brdfatlas.__file__).parents[1])}
    process = subprocess.Popen(
        [sys.executable, tmp_path / "workers.py"], env=env, stderr=subprocess.PIPE, text=True, start_new_session=True
    )

    def workers():
        told = subprocess.run(["pgrep", "-g", str(process.pid), "-f", "spawn_main"], capture_output=True, text=True)
        return told.stdout.split()

    try:
        deadline = time.monotonic() + 60
        while len(workers()) < 2:
            assert process.poll() is None
            assert time.monotonic() < deadline
            time.sleep(0.1)
        (os.killpg if number == signal.SIGINT else os.kill)(process.pid, number)
        _, err = process.communicate(timeout=60)  # waits for the workers, which hold its stderr
        if number == signal.SIGINT:
            assert err == "ended\n"
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)


@pytest.mark.parametrize("from_stdin", [False, True])
def test_a_script_without_a_guard_is_told_and_does_not_hang(inputs, tmp_path, from_stdin):
    """Each worker imports the script of its parent, and ends there before it has read what it was given."""
    code = f"import brdfatlas\nbrdfatlas.recommend({str(inputs / 'measured.binary')!r}, models=['lambert', 'ggx'])\n"
    (tmp_path / "mine.py").write_text(code)
    command = [sys.executable, "-"] if from_stdin else [sys.executable, "mine.py"]
    environment = os.environ | {"PYTHONPATH": str(Path(brdfatlas.__file__).parents[1]), "TMPDIR": str(tmp_path)}
    done = subprocess.run(
        command, input=code, capture_output=True, text=True, timeout=300, cwd=tmp_path, env=environment
    )
    assert done.returncode == 1
    assert 'outside `if __name__ == "__main__":`; ask for processes=1' in done.stderr.splitlines()[-1]
    assert not list(tmp_path.glob("brdfatlas.*"))


# A child of nohup ignores SIGHUP.
ENDED = """
import os, signal, sys, time
signal.signal({number}, signal.default_int_handler if {number} == signal.SIGINT else signal.SIG_DFL)
sys.argv = ["brdfatlas"]
import brdfatlas.cli as cli, brdfatlas.cli.commands
from brdfatlas import files, interrupts
def end():
    os.kill(os.getpid(), {number})
    time.sleep(0.01)
def fit(*_, **__):
    {body}
brdfatlas.cli.commands.fit = fit
sys.exit(cli.main(["fit", "ggx", {measured!r}, "-o", {output!r}]))
"""
WRITES = "with files.atomic_path({output!r}) as path:\n        path.write_text('half'); end()"
COMPILED = "try: end()\n    except KeyboardInterrupt: raise SystemError('a result with an exception set')"
IMPORTS = "with interrupts.held():\n        end(); print('whole', file=sys.stderr)"
SIGNALS = [(number, WRITES) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)]


@pytest.mark.parametrize(("number", "body"), [*SIGNALS, (signal.SIGINT, COMPILED), (signal.SIGINT, IMPORTS)])
def test_a_signal_leaves_no_unfinished_file_and_no_traceback(inputs, tmp_path, number, body):
    output = str(tmp_path / "a.npz")
    told = {"measured": str(inputs / "measured.binary"), "output": output, "number": int(number)}
    process = in_a_process(ENDED.format(body=body.format(output=output), **told))
    out, err = process.communicate()
    assert (process.returncode, out) == (128 + number, "")
    assert err == ("whole\n" if body is IMPORTS else "") + "brdfatlas: interrupted, nothing was written\n"
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_where_nothing_is_to_be_tidied_up_a_signal_ends_the_command_at_once(inputs, tmp_path, number):
    """Compiled code may run for minutes before Python looks at signals."""
    told = {"measured": str(inputs / "measured.binary"), "output": str(tmp_path / "a.npz"), "number": int(number)}
    process = in_a_process(ENDED.format(body="end()", **told))
    assert process.communicate() == ("", "")
    assert process.returncode == -number
