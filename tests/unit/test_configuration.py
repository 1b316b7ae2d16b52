"""Configuration: defaults, and one clear line with file, key and remedy for every fault."""

import os
import re
import struct
from copy import deepcopy
from pathlib import Path

import pytest
import yaml

from brdfatlas.files import write_json
from brdfatlas.formats.merl import FILE_BYTES, write_merl
from brdfatlas.models import read_entries
from brdfatlas.pipeline.configuration import (
    ConfigError,
    check,
    check_configfiles,
    check_samples,
    choose,
    files_of_scene,
    read_config,
    read_rgl,
    read_yaml,
)
from brdfatlas.pipeline.materials import check_files, find_materials
from brdfatlas.settings import check_name

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(autouse=True)
def in_project(monkeypatch):
    monkeypatch.chdir(ROOT)


def test_shipped_files_are_valid():
    for name in ("config.yaml", "full.yaml", "ablation.yaml"):
        read_config(read_yaml(f"config/{name}"), name)
    for name in ("models", "ablation_models"):
        assert list(read_entries(f"config/{name}.yaml"))


def test_defaults_are_filled_at_every_depth():
    config = read_config({"render": {"size": 32}})
    assert config["render"]["size"] == 32
    assert config["render"]["batches"] == 8
    assert config["strict"] is False


def test_every_key_has_default_and_description_and_is_explained():
    def walk(schema, prefix=""):
        for key, part in schema["properties"].items():
            yield prefix + key, part
            if "properties" in part:
                yield from walk(part, f"{prefix}{key}.")

    text = (ROOT / "config" / "README.md").read_text()
    for key, part in walk(read_yaml("workflow/schemas/config.schema.yaml")):
        assert {"default", "description"} <= part.keys(), key
        assert f"`{key}`" in text, f"config/README.md does not explain {key}"


@pytest.mark.parametrize(
    ("config", "words"),
    [
        ({"render": {"sizes": 3}}, ["render", "sizes", "known keys", "samples"]),
        ({"render": {"samples": 0}}, ["render.samples", "0"]),
        ({"render": {"batches": 2}}, ["render.batches", "minimum of 3"]),
        ({"strict": "yes"}, ["strict", "boolean"]),
        ({"seed": -1}, ["seed", "-1", "allowed: 0 to 2147483647"]),
        ({"seed": 2**32}, ["seed", "4294967296", "allowed: 0 to 2147483647"]),
        ({"render": {"seed": 2**32}}, ["render.seed", "allowed: 0 to 2147483647"]),
        ({"render": {"size": 8}}, ["render.size", "8", "allowed: 16 to 4096"]),
        ({"render": {"size": 100_000}}, ["render.size", "100000", "allowed: 16 to 4096"]),
        ({"render": {"samples": 1.0e30}}, ["render.samples", "1e+30", "integer"]),
        ({"render": {"samples": 10**30}}, ["render.samples", "allowed: 3 to 1048576"]),
        ({"render": {"samples": True}}, ["render.samples", "integer"]),
        ({"merl_folder": "config/config.yaml"}, ["merl_folder", "config/config.yaml", "not a folder"]),
        ({"materials": "chrome"}, ["materials"]),
    ],
)
def test_faults_name_file_and_key(config, words):
    with pytest.raises(ConfigError) as caught:
        read_config(config, "config/mine.yaml")
    message = str(caught.value)
    assert message.startswith("config/mine.yaml: ")
    assert "\n" not in message
    for word in words:
        assert word in message


def test_yaml_faults_name_file_and_line(tmp_path):
    (tmp_path / "bad.yaml").write_text("a: 1\nb: [1,\n")
    with pytest.raises(ConfigError, match=r"bad.yaml: line \d+"):
        read_yaml(tmp_path / "bad.yaml")
    with pytest.raises(ConfigError, match="no such file"):
        read_yaml(tmp_path / "absent.yaml")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("seed: 1\nseed: 2\n", "line 2: .*'seed' stands twice"),
        ("render: {size: 16, size: 32}\n", "line 1: .*'size' stands twice"),
        ("!!binary c2VlZA==: 1\n", "line 1: .*is no text"),
        ("1: 2\n", "line 1: .*'1' is no text"),
        ("[a]: 2\n", "line 1: .*is no text"),
        ("render: {samples: 010}\n", "line 1: .*010 would be read as 8; write decimal"),
        ("seed: 1\nrender: {samples: 1:30}\n", "line 2: .*1:30 would be read as 90; write decimal"),
        ("a: 0x20\n", "line 1: .*0x20 would be read as 32"),
        ("a: [1, -0b11]\n", "line 1: .*-0b11 would be read as -3"),
        ("a: 1_000\n", "line 1: .*1_000 would be read as 1000"),
        ("a: 1:30.5\n", "line 1: .*1:30.5 would be read as 90.5"),
        ("a: 1_0.5\n", "line 1: .*1_0.5 would be read as 10.5"),
        ("seed: 99999-99-99999\ndate: 2026-99-99\n", "not usable YAML"),
        ("a0: &a0 [1, 1]\n" + "".join(f"a{k + 1}: &a{k + 1} [*a{k}, *a{k}]\n" for k in range(40)), "write fewer"),
        ("a: &a {b: *a}\n", "write fewer"),
    ],
)
def test_keys_of_yaml_are_text_and_stand_once_and_numbers_are_decimal(tmp_path, text, words):
    (tmp_path / "bad.yaml").write_text(text)
    with pytest.raises(ConfigError, match=rf"bad\.yaml: .*{words}|bad\.yaml: {words}") as caught:
        read_yaml(tmp_path / "bad.yaml")
    assert "\n" not in str(caught.value)


def test_decimal_numbers_and_quoted_texts_are_what_they_look_like(tmp_path):
    (tmp_path / "a.yaml").write_text("a: [0, -7, +8, 0.5, 1.5e+3, .inf, '010', \"1:30\", 12:a]\n")
    values = [0, -7, 8, 0.5, 1500.0, float("inf"), "010", "1:30", "12:a"]
    assert read_yaml(tmp_path / "a.yaml")["a"] == values


def test_faults_of_a_configuration_that_snakemake_says_nothing_of_are_told(tmp_path):
    (tmp_path / "mine.yaml").write_text("seed: 1\nrender: {samples: 010}\n")
    (tmp_path / "twice.yaml").write_text("seed: 1\nseed: 2\n")
    (tmp_path / "good.json").write_text('{\t"seed": 1}')
    check_configfiles([tmp_path / "good.json"])
    for name in ("mine.yaml", "twice.yaml"):
        with pytest.raises(ConfigError, match=rf"{name}: line 2: "):
            check_configfiles([tmp_path / "good.json", tmp_path / name])
    for text in ('{"seed": 1, "seed": 2}', '{"render": {"size": 32, "samples": 8, "size": 64}}'):
        (tmp_path / "twice.json").write_text(text)
        with pytest.raises(ConfigError, match=r"twice\.json: .*'(seed|size)' stands twice"):
            check_configfiles([tmp_path / "twice.json"])


def numbers(value, key=()):
    """The keys of all numbers in a value."""
    parts = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    if isinstance(value, (int, float)):
        yield key
    for name, part in parts:
        yield from numbers(part, (*key, name))


@pytest.mark.parametrize("wrong", [float("nan"), float("inf"), -float("inf")])
def test_numbers_of_a_scene_are_finite(wrong):
    schema = read_yaml("workflow/schemas/scenes.schema.yaml")
    scene = {
        "geometry": [{"shape": "statue", "position": [0, 0, 0], "size": 1, "turn": 0}],
        "environment": {"kind": "studio"},
        "camera": {"origin": [0, 0, 5], "target": [0, 0, 0]},
    }
    whole = check({"mine": scene}, schema, "scenes.yaml")
    keys = list(numbers(whole))
    assert len(keys) > 15
    for key in keys:
        broken = deepcopy(whole)
        *path, last = key
        part = broken
        for name in path:
            part = part[name]
        part[last] = wrong
        with pytest.raises(ConfigError, match=r"^scenes\.yaml: " + re.escape(".".join(map(str, key)))):
            check(broken, schema, "scenes.yaml")


def test_what_is_no_text_file_is_named(tmp_path):
    (tmp_path / "latin.yaml").write_bytes(b"a: \xe4\n")
    with pytest.raises(ConfigError, match=r"latin\.yaml: not UTF-8"):
        read_yaml(tmp_path / "latin.yaml")
    os.mkfifo(tmp_path / "pipe.yaml")
    with pytest.raises(ConfigError, match=r"pipe\.yaml: not a regular file"):
        read_yaml(tmp_path / "pipe.yaml")


def test_words_of_the_command_line_become_what_the_key_wants():
    """Snakemake hands on text inside of mappings, and booleans that are not written as in Python."""
    config = read_config({"strict": "true", "render": {"size": "32"}, "materials": ["12"], "merl_folder": "12"})
    assert config["strict"] is True
    assert config["render"]["size"] == 32
    assert config["materials"] == ["12"]
    assert config["merl_folder"] == "12"


@pytest.mark.parametrize(
    ("models", "words"),
    [
        ({"ggxx": {}}, "ggxx.*source"),
        ({"ggx": {"colour": 1}}, "ggx.*colour.*known options"),
        ({"reference": {}}, "reserved"),
        ({"a b;rm": {}}, "not a usable name"),
        ({"mine": {"source": "absent.py"}}, "mine.*absent.py.*no such model file"),
    ],
)
def test_model_faults(tmp_path, models, words):
    path = tmp_path / "models.yaml"
    path.write_text(yaml.safe_dump(models))
    with pytest.raises(ConfigError, match=words) as caught:
        read_entries(path)
    assert str(path) in str(caught.value)


def test_samples_are_checked_under_the_settings_of_the_run():
    config = read_config({"scenes_file": "mine.yaml", "render": {"samples": 16, "batches": 8}})
    check_samples(config, {"hall": {"samples": None}})
    with pytest.raises(ConfigError, match=r"^mine\.yaml: hall\.samples: 4: at least one sample a batch"):
        check_samples(config, {"hall": {"samples": 4}})
    config["render"]["samples"] = 6
    with pytest.raises(ConfigError, match=r"^config: render\.samples: 6: at least one sample a batch"):
        check_samples(config, {"hall": {"samples": None}})


def test_a_file_that_a_scene_lacks_is_named_with_its_key(tmp_path):
    mesh, gone = tmp_path / "teapot.ply", tmp_path / "gone.ply"
    mesh.touch()

    def files(environment: str, *meshes: Path) -> list[str]:
        scene = {"geometry": [{"file": ""}, *({"file": str(m)} for m in meshes)], "environment": {"file": environment}}
        return files_of_scene("hall", scene, "mine.yaml", ["probe.hdr"])

    assert files("", mesh) == [str(mesh)]
    with pytest.raises(ConfigError) as caught:
        files("", mesh, gone)
    fault = f"mine.yaml: hall.geometry.2.file: {gone}: no such file"
    assert str(caught.value) == f"{fault}; correct the path or leave the scene out"
    with pytest.raises(ConfigError, match=r"hall\.environment\.file: .*; `snakemake assets` fetches it"):
        files("data/assets/probe.hdr")


def test_choose_says_what_is_known():
    assert choose("all", ["a", "b"], "models", "f") == ["a", "b"]
    assert choose(["b", "b"], ["a", "b"], "models", "f") == ["b"]
    with pytest.raises(ConfigError, match="'c' is not known; known: a, b"):
        choose(["c"], ["a", "b"], "models", "f")


def test_check_says_what_a_key_means():
    schema = {"type": "object", "properties": {"n": {"type": "integer", "description": "How many."}}}
    with pytest.raises(ConfigError, match="How many"):
        check({"n": "x"}, schema, "f")


@pytest.fixture(scope="module")
def good_file(tmp_path_factory):
    import numpy as np

    path = tmp_path_factory.mktemp("merl") / "good.binary"
    write_merl(path, np.full((90, 90, 180, 3), 0.1, np.float32))
    return path


def test_bad_materials_are_left_out_with_a_reason_and_recorded_verdicts_are_believed(tmp_path, good_file, monkeypatch):
    folder = tmp_path / "merl"
    folder.mkdir()
    (folder / "good.binary").symlink_to(good_file)
    (folder / "short.binary").write_bytes(good_file.read_bytes()[: FILE_BYTES // 2])
    (folder / "a b;rm.binary").symlink_to(good_file)
    (folder / "<script>.binary").symlink_to(good_file)
    config = read_config({"merl_folder": str(folder)})
    checks = tmp_path / "checks.json"
    usable, left_out, verdicts = find_materials(config, "standins", checks)
    assert not checks.exists(), "who plans writes nothing"
    assert [m.name for m in usable] == ["good"]
    assert {item.name for item in left_out} == {"short", "a b;rm", "<script>"}
    assert all(item.path in item.reason for item in left_out)

    write_json(checks, verdicts)
    monkeypatch.setattr("brdfatlas.pipeline.materials.merl.load", lambda path: pytest.fail("read again"))
    assert find_materials(config, "standins", checks) == (usable, left_out, verdicts)
    with pytest.raises(ConfigError, match="strict"):
        find_materials(config | {"strict": True}, "standins", checks)
    monkeypatch.undo()
    for damaged in ("[]", "null", '{"%s": 3}' % (folder / "good.binary"), "{"):
        checks.write_text(damaged)
        assert find_materials(config, "standins", checks) == (usable, left_out, verdicts)


def test_files_on_which_no_fit_can_be_judged_are_left_out(tmp_path, good_file):
    """Black ones, and those measured at grazing angles only: image errors are relative to what the reference shows."""
    import numpy as np

    from brdfatlas.angles import GRID_SHAPE, above_horizon, grid_cosines

    folder = tmp_path / "merl"
    folder.mkdir()
    (folder / "good.binary").symlink_to(good_file)
    black = np.zeros((*GRID_SHAPE, 3), np.float32)
    write_merl(folder / "black.binary", black)
    cosines = np.minimum(*grid_cosines())
    grazing = np.where((above_horizon() & (cosines < np.cos(np.deg2rad(89.1))))[..., None], black + 1, np.nan)
    write_merl(folder / "grazing.binary", grazing)
    usable, left_out, _ = find_materials(read_config({"merl_folder": str(folder)}), "standins", tmp_path / "none.json")
    assert [m.name for m in usable] == ["good"]
    reasons = {item.name: item.reason for item in left_out}
    assert "black, every sample" in reasons["black"]
    assert "no valid cell with both directions within 89 degrees" in reasons["grazing"]


def test_a_repaired_file_is_checked_again(tmp_path, good_file):
    folder = tmp_path / "merl"
    folder.mkdir()
    (folder / "m.binary").write_bytes(b"")
    config, checks = read_config({"merl_folder": str(folder)}), tmp_path / "checks.json"
    with pytest.raises(ConfigError, match="can be used"):
        find_materials(config, "standins", checks)
    write_json(checks, check_files({"m": folder / "m.binary"}, checks))
    (folder / "m.binary").write_bytes(good_file.read_bytes())
    assert [m.name for m in find_materials(config, "standins", checks)[0]] == ["m"]


def test_a_verdict_follows_a_file_that_is_renamed(tmp_path, good_file):
    good, bad, checks = tmp_path / "good.binary", tmp_path / "bad.binary", tmp_path / "checks.json"
    good.write_bytes(good_file.read_bytes())
    bad.write_bytes(bytes(good.stat().st_size))
    for path in (good, bad):
        os.utime(path, ns=(0, 0))
    files = {"good": good, "bad": bad}
    found = check_files(files, checks)
    write_json(checks, found)
    good.rename(tmp_path / "aside")
    bad.rename(good)
    (tmp_path / "aside").rename(bad)
    assert [bool(found[str(path)]["reason"]) for path in (good, bad)] == [False, True]
    found = check_files(files, checks)
    assert [bool(found[str(path)]["reason"]) for path in (good, bad)] == [True, False]


def test_standins_where_there_is_no_file(tmp_path, capsys):
    config = read_config({"merl_folder": str(tmp_path / "none")})
    usable, left_out, _ = find_materials(config, "standins", tmp_path / "checks.json")
    assert len(usable) == 4
    assert all(m.standin for m in usable)
    assert left_out == []
    assert capsys.readouterr().err.endswith(f"{tmp_path / 'none'}: no such folder; built-in stand-ins are used\n")
    with pytest.raises(ConfigError, match=r"none: no such folder \(strict: true"):
        find_materials(config | {"strict": True}, "standins", tmp_path / "checks.json")
    everything = find_materials(config | {"standins": "all"}, "standins", tmp_path / "checks.json")[0]
    assert len(everything) == 100
    with pytest.raises(ConfigError, match="unobtainium"):
        find_materials(config | {"materials": ["unobtainium"]}, "standins", tmp_path / "checks.json")


@pytest.mark.parametrize(
    ("file", "remedy"),
    [
        ("brdfs/a.binary", "set measured_folder: .*brdfs$"),
        ("mine/brdfs/a.binary", "set measured_folder: .*brdfs$"),
        ("a.BINARY", "can be used"),
        (".unpacked/a.binary", ""),
        ("very/much/further/a.binary", ""),  # a whole disk is not searched
        ("brdfs/prices.csv", ""),
    ],
)
def test_files_that_are_not_quite_where_they_are_looked_for(tmp_path, file, remedy):
    path = tmp_path / file
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(b"a,b\n" if path.suffix == ".csv" else struct.pack("<3i", 90, 90, 180))
    config = read_config({"merl_folder": str(tmp_path)})
    if not remedy:
        assert all(m.standin for m in find_materials(config, "standins", tmp_path / "checks.json")[0])
        return
    with pytest.raises(ConfigError, match=remedy):
        find_materials(config, "standins", tmp_path / "checks.json")


def test_a_folder_that_vanishes_while_it_is_searched_is_no_fault(tmp_path, monkeypatch, capsys):
    (tmp_path / "gone").mkdir()
    listed = os.scandir

    def scandir(path):
        if str(path).endswith("gone"):
            raise FileNotFoundError(path)
        return listed(path)

    monkeypatch.setattr(os, "scandir", scandir)
    find_materials(read_config({"measured_folder": str(tmp_path)}), "standins", tmp_path / "checks.json")
    assert "no measurement there; built-in stand-ins are used" in capsys.readouterr().err


def test_the_home_folder_may_be_called_so(tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))
    assert read_config({"measured_folder": "~/brdfs"})["measured_folder"] == f"{tmp_path}/brdfs"


@pytest.mark.parametrize("folder", ["$HOME/brdfs", "${HOME}/brdfs", "data/$NO_SUCH_NAME"])
def test_a_variable_in_a_folder_is_refused(tmp_path, monkeypatch, folder):
    """It is not expanded: stand-ins would take the place of the measurements."""
    monkeypatch.chdir(tmp_path)
    for key in ("measured_folder", "merl_folder"):
        with pytest.raises(ConfigError, match=rf"^config: {key}: {re.escape(folder)}: .*not expanded, ~ is; write .*$"):
            read_config({key: folder})
        (tmp_path / "$1").mkdir(exist_ok=True)
        assert read_config({key: "$1"})[key] == "$1"  # a folder that is called so


def test_names_that_could_escape_are_refused():
    for name in ("../x", "a b", "<script>", "a/b", "", ".hidden", "-rf", "a\n"):
        with pytest.raises(ConfigError):
            check_name(name, "f")


def test_any_mixture_of_files_is_found_by_content(tmp_path, good_file):
    """Endings do not matter, stray files are no materials, and RGL's ending is no part of a name."""
    from test_formats_rgl import container, tensors
    from test_formats_tables import CSV

    (tmp_path / "merl.dat").symlink_to(good_file)
    (tmp_path / "silk_rgb.bsdf").write_bytes(container(tensors()))
    (tmp_path / "mine.txt").write_text("\n".join(CSV))
    (tmp_path / "notes.txt").write_text("theta is the angle")
    (tmp_path / "picture.png").write_bytes(b"\x89PNG")
    (tmp_path / "folder").mkdir()
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "bad.csv").write_text("a,b\n1,2\n")
    config = read_config({"measured_folder": str(tmp_path)})
    usable, left_out, _ = find_materials(config, "standins", tmp_path / "none.json")
    assert {m.name: bool(m.source) for m in usable} == {"merl": False, "silk": True, "mine": True}
    assert {m.binary for m in usable if m.source} == {f"results/measured/{n}.measured" for n in ("silk", "mine")}
    assert [item.name for item in left_out] == ["bad"]
    (tmp_path / "silk.csv").write_text("\n".join(CSV))
    with pytest.raises(ConfigError, match=r"silk\.csv and .*silk_rgb\.bsdf would both be the material 'silk'"):
        find_materials(config, "standins", tmp_path / "none.json")
    # their folders would be one on a system that takes no heed of case
    (tmp_path / "silk.csv").rename(tmp_path / "SILK.csv")
    with pytest.raises(ConfigError, match=r"SILK\.csv and .*silk_rgb\.bsdf would both be the material 'silk'"):
        find_materials(config, "standins", tmp_path / "none.json")


UNUSABLE = ["checks", "model-ggx", "good.brdf", "good.html", "0" * 20, "a" * 100, "a b", "-rf", "é", "line\nbreak"]


@pytest.mark.parametrize("name", UNUSABLE)
def test_names_that_the_run_cannot_use_are_left_out(tmp_path, good_file, name):
    (tmp_path / "good.binary").symlink_to(good_file)
    (tmp_path / f"{name}.binary").symlink_to(good_file)
    config = read_config({"measured_folder": str(tmp_path)})
    usable, left_out, _ = find_materials(config, "standins", tmp_path / "none.json")
    assert [m.name for m in usable] == ["good"]
    assert len(left_out) == 1
    assert len(left_out[0].reason.splitlines()) == 1


def test_the_rgl_materials_have_addresses():
    materials = read_rgl("config/rgl.yaml")
    assert len(materials) == 51
    assert materials["spectralon"].endswith("/spectralon/spectralon_rgb.bsdf")


def test_a_deprecated_key_is_said_and_still_works(tmp_path, capsys):
    assert read_config({})["merl_folder"] == "data/merl"
    assert "deprecated" not in capsys.readouterr().err
    assert read_config({"merl_folder": str(tmp_path)})["merl_folder"] == str(tmp_path)
    assert capsys.readouterr().err == (
        "config: merl_folder is deprecated since 0.2.0, use measured_folder; it still works\n"
    )


@pytest.mark.parametrize("folder", ["results/standins", "reports", "./results", "elsewhere/../results"])
def test_measurements_do_not_lie_where_runs_write(tmp_path, monkeypatch, folder):
    """A run would take them for its own stand-ins, and make them again."""
    monkeypatch.chdir(tmp_path)
    for key in ("measured_folder", "merl_folder"):
        with pytest.raises(ConfigError, match=f"^config: {key}: .*keep measurements elsewhere$"):
            read_config({key: folder})
    assert read_config({"measured_folder": "results-of-others"})
