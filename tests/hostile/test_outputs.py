"""An output never destroys an input, a file of another kind, or what is no file."""

import io
import json
import os
import socket
from dataclasses import replace

import numpy as np
import pytest
from conftest import state

import brdfatlas
from brdfatlas import files
from brdfatlas.cli import main
from brdfatlas.export.targets import stem_of
from brdfatlas.recommend import Recommendation, Row

#: Command with {o} for its output -> the inputs it reads.
WRITERS = {
    "fit": (["fit", "ggx", "measured.binary", "-o", "{o}"], ["measured.binary"]),
    "fit of one's own": (
        ["fit", "mine", "measured.binary", "--source", "model.py", "-o", "{o}"],
        ["measured.binary", "model.py"],
    ),
    "table": (["table", "ggx.npz", "-o", "{o}"], ["ggx.npz"]),
    "export": (["export", "ward.npz", "-o", "{o}"], ["ward.npz"]),
    "export --sampler": (["export", "--sampler", "ward.npz", "-o", "{o}"], ["ward.npz"]),
    "uber-texture": (["uber-texture", "g_from_d.npz", "-o", "{o}"], ["g_from_d.npz"]),
    "render": (
        ["render", "measured.binary", "--scenes", "scenes.yaml", "--scene", "mine", "--size", "8", "-o", "{o}"],
        ["measured.binary", "scenes.yaml", "probe.exr"],
    ),
    "render of a fit": (
        ["render", "ggx.npz", "--reference", "measured.binary", "--size", "8", "-o", "{o}"],
        ["ggx.npz", "measured.binary"],
    ),
}
PAIRS = [(command, name) for command, (_, names) in WRITERS.items() for name in names]
RIGHT = {"fit": ".npz", "fit of one's own": ".npz", "table": ".binary", "export": ".json", "export --sampler": ".json"}
RIGHT |= {"uber-texture": ".exr", "render": ".exr", "render of a fit": ".png"}


def command_line(command, output, linked):
    arguments, names = WRITERS[command]
    for name in names:
        if not os.path.lexists(name):
            linked(name)
    return [item.replace("{o}", str(output)) for item in arguments]


def by_itself(path):
    return path.name


def by_absolute_path(path):
    return path


def by_a_detour(path):
    (path.parent / "sub").mkdir()
    return f"sub/../{path.name}"


def by_a_link(path):
    (path.parent / "link").symlink_to(path.name)
    return "link"


def by_a_linked_folder(path):
    (path.parent / "folder").symlink_to(path.parent)
    return f"folder/{path.name}"


def by_a_hard_link(path):
    os.link(path, path.parent / "twin")
    return "twin"


WAYS = (by_itself, by_absolute_path, by_a_detour, by_a_link, by_a_linked_folder, by_a_hard_link)


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize(("command", "name"), PAIRS)
def test_an_output_that_is_an_input_is_refused_also_by_force(refused, linked, command, name, way):
    arguments = command_line(command, "{o}", linked)
    output = str(way(refused.folder / name))
    arguments = [item.replace("{o}", output) for item in arguments]
    refused([*arguments, "--force"], os.path.basename(output), "is an input", "name another output")


ENDINGS = (".npz", ".binary", ".exr", ".png", ".json", ".py", ".yaml", ".csv", ".hdr", ".txt", ".glb")


WRONG = [
    (command, ending)
    for command in WRITERS
    for ending in ENDINGS
    if ending != RIGHT[command] and not (command.startswith("render") and ending in (".exr", ".png"))
]


@pytest.mark.parametrize(("command", "ending"), WRONG)
def test_the_ending_fits_what_is_written(refused, linked, command, ending):
    refused(command_line(command, f"out{ending}", linked), f"out{ending}", "name such an output")


def archive(*members):
    """The bytes of an npz file whose members are texts."""
    stream = io.BytesIO()
    np.savez(stream, **dict.fromkeys(members, np.array("resnet")))
    return stream.getvalue()


FOREIGN = {
    "text": b"my notes\n",
    "a measurement": "measured.binary",
    "a picture": b"v/1\x01" + b"channels\0" * 40,
    "an archive": b"PK\x03\x04" + b"\0" * 26 + b"thesis.docx",
    "JSON": b'{"name": "my package"}\n',
    "JSON that needs us": b'{"name": "mine", "dependencies": {"brdfatlas": "0.2.0"}}\n',
    "a report of a run": b'{\n "status": "ok",\n "entry": "ggx",\n "model": "brdfatlas-ggx"\n}\n',
    "a scene with us": b'<scene version="3.0.0"><bsdf type="brdfatlas"/><!-- written by: brdfatlas 1 --></scene>',
    "a network": archive("model", "weights"),
    "a network with much more": archive("model", "material", "standin", "weights"),
    "a picture about us": b"v/1\x01comments\0string\0\x12\0\0\0made with brdfatlas",
    "a PNG about us": b"\x89PNG\r\n\x1a\n" + b"tEXtComment\0brdfatlas",
    "a program": b"#!/bin/sh\nexit\n",
    "a PNG": b"\x89PNG\r\n\x1a\n" + b"\0" * 40,
}


@pytest.mark.parametrize("what", FOREIGN)
@pytest.mark.parametrize("command", WRITERS)
def test_a_file_that_is_not_ours_is_not_overwritten(refused, linked, inputs, command, what):
    arguments = command_line(command, f"out{RIGHT[command]}", linked)
    output = refused.folder / f"out{RIGHT[command]}"
    content = FOREIGN[what]
    output.write_bytes(content if isinstance(content, bytes) else (inputs / content).read_bytes())
    refused(arguments, output.name, "--force")


def test_force_replaces_and_what_is_ours_needs_none(linked, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for command in WRITERS:
        if command.startswith(("render", "fit")):
            continue
        output = tmp_path / f"{command}{RIGHT[command]}"
        output.write_bytes(b"my notes")
        line = command_line(command, output, linked)
        assert main(line) == 1
        assert main([*line, "--force"]) == 0
        written = output.read_bytes()
        assert len(written) > 100
        assert main(line) == 0, "a file of ours"
        assert output.read_bytes() == written


@pytest.mark.parametrize(("target", "ending"), [("mitsuba", ".xml"), ("materialx", ".mtlx"), ("gltf", ".gltf")])
def test_a_material_is_known_by_its_own_mark(refused, linked, target, ending):
    linked("lambert.npz")
    export = ["export", "lambert.npz", "--to", target, "-o", f"out{ending}"]
    for _ in range(2):
        assert main(export) == 0
    output = refused.folder / f"out{ending}"
    written = output.read_bytes()
    inside = written[: written.index(b">" if b"<" in written else b"{") + 1]
    output.write_bytes(inside + b"<mine/>" + written[len(inside) :])
    refused(export, output.name, "--force")
    refused([*export[:-1], "out.glb"], "out.glb", "name such an output")


def test_a_failed_fits_empty_mark_may_be_replaced(tmp_path, inputs):
    (tmp_path / "out.json").touch()
    assert main(["export", str(inputs / "ward.npz"), "-o", str(tmp_path / "out.json")]) == 0


def a_fifo(path):
    os.mkfifo(path)


def a_folder(path):
    path.mkdir()


def a_socket(path):
    with socket.socket(socket.AF_UNIX) as unix:
        unix.bind(path.name)


def a_link_to_itself(path):
    path.symlink_to(path.name)


def a_link_to_a_fifo(path):
    os.mkfifo(path.with_name("fifo"))
    path.symlink_to("fifo")


def a_pipe(path):
    """As /dev/stdout is in `brdfatlas ... | cat`; the caller's end of it closes with the process."""
    read, _ = os.pipe()
    path.symlink_to(f"/proc/self/fd/{read}")


def a_device(path):
    try:
        os.mknod(path, 0o20666, os.makedev(1, 3))
    except PermissionError:
        pytest.skip("only root makes devices")


SPECIAL = (a_fifo, a_folder, a_socket, a_link_to_itself, a_link_to_a_fifo, a_pipe, a_device)


@pytest.mark.parametrize("make", SPECIAL)
@pytest.mark.parametrize("command", ["fit", "table", "export", "uber-texture", "render of a fit"])
def test_what_is_no_regular_file_is_never_replaced(refused, linked, command, make):
    arguments = command_line(command, f"out{RIGHT[command]}", linked)
    make(refused.folder / f"out{RIGHT[command]}")
    refused([*arguments, "--force"], f"out{RIGHT[command]}", "name another output")


@pytest.mark.parametrize("make", SPECIAL)
def test_atomic_writing_replaces_none_either(tmp_path, monkeypatch, make):
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "out.txt"
    make(path)
    before = os.lstat(path)
    with pytest.raises(files.FileFault, match=r"out.txt: .*name another output"):
        files.write_text(path, "new")
    assert os.lstat(path).st_ino == before.st_ino
    assert not [p for p in tmp_path.iterdir() if p.name.startswith(".")]


@pytest.mark.parametrize("exists", [True, False])
def test_atomic_writing_goes_through_links(tmp_path, exists):
    target, link, second = tmp_path / "a" / "target.txt", tmp_path / "link.txt", tmp_path / "second.txt"
    target.parent.mkdir()
    if exists:
        target.write_text("old")
    link.symlink_to(target)
    second.symlink_to("link.txt")
    files.write_text(second, "new")
    assert target.read_text() == "new"
    assert link.is_symlink()
    assert second.is_symlink()


@pytest.mark.parametrize("command", ["fit", "table", "uber-texture", "render of a fit"])
def test_standard_output_takes_text_alone(refused, linked, command):
    refused(command_line(command, "-", linked), "-o -", "name a file")


def test_text_goes_to_standard_output_and_nothing_else(capsys, inputs, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for extra in ([], ["--sampler"]):
        assert main(["export", str(inputs / "ward.npz"), "-o", "out.json", "--force", *extra]) == 0
        capsys.readouterr()
        assert main(["export", str(inputs / "ward.npz"), "-o", "-", *extra]) == 0
        assert capsys.readouterr().out == (tmp_path / "out.json").read_text()
    assert [path.name for path in tmp_path.iterdir()] == ["out.json"]


def test_a_png_is_the_render_by_its_tone_map_and_says_what_it_shows(inputs, tmp_path):
    from PIL import Image

    from brdfatlas.rendering.images import load_render, tone_map

    for ending in ("exr", "png"):
        output = str(tmp_path / f"a.{ending}")
        assert main(["render", str(inputs / "ggx.npz"), "--size", "16", "--spp", "8", "-o", output]) == 0
    render, picture = load_render(tmp_path / "a.exr"), Image.open(tmp_path / "a.png")
    shown = tone_map(render.mean, float(render.meta["exposure"]), float(render.meta["gamma"]))
    assert np.abs(np.array(picture) / 255 - shown).max() <= 0.5 / 255 + 1e-6
    assert picture.text["brdfatlas:standin"] == "true"


@pytest.mark.parametrize("place", ["notes.txt/out.npz", "notes.txt/sub/out.npz"])
def test_a_folder_that_is_a_file(refused, linked, place):
    (refused.folder / "notes.txt").write_text("mine")
    refused(command_line("fit", place, linked), place, "is not a folder")


def test_equal_fits_are_equal_files_also_through_a_link(inputs, tmp_path):
    fitted = brdfatlas.load_fit(inputs / "ggx.npz")
    (tmp_path / "link.npz").symlink_to("real.npz")
    fitted.save(tmp_path / "link.npz")
    assert (tmp_path / "real.npz").read_bytes() == (inputs / "ggx.npz").read_bytes()


BESIDE = {
    "another fit": "ward.npz",
    "other arrays": b"PK\x03\x04" + b"\0" * 26 + b"data.npy",
    "text": b"my notes\n",
    "nothing": b"",
}


@pytest.mark.parametrize("what", BESIDE)
def test_a_file_beside_an_export_is_not_overwritten(refused, linked, inputs, what):
    """Mitsuba's material needs the fit beside it, in a file that nobody named."""
    linked("ggx.npz")
    content = BESIDE[what]
    beside = refused.folder / "out.npz"
    beside.write_bytes(content if isinstance(content, bytes) else (inputs / content).read_bytes())
    export = ["export", "ggx.npz", "--to", "mitsuba", "-o", "out.xml"]
    refused(export, "out.npz", "--force")
    assert main([*export, "--force"]) == 0
    assert brdfatlas.load_fit(beside) == brdfatlas.load_fit("ggx.npz")
    assert main(export) == 0, "the same fit"


def test_an_export_with_a_file_beside_it_does_not_go_to_standard_output(refused, linked, capsys):
    linked("ggx.npz")
    linked("lambert.npz")
    refused(["export", "ggx.npz", "--to", "mitsuba", "-o", "-"], "-o -", "name a file")
    assert main(["export", "lambert.npz", "--to", "mitsuba", "-o", "-"]) == 0
    assert capsys.readouterr().out.startswith("<scene")


def test_the_fit_is_beside_the_export_itself_also_through_a_link(refused, linked):
    linked("ggx.npz")
    other = refused.folder / "other"
    other.mkdir()
    (other / "real.npz").write_bytes(b"mine")
    (refused.folder / "link.xml").symlink_to("other/real.xml")
    export = ["export", "ggx.npz", "--to", "mitsuba", "-o", "link.xml"]
    refused(export, "real.npz", "--force")
    (other / "real.npz").unlink()
    assert main(export) == 0
    assert sorted(path.name for path in other.iterdir()) == ["real.npz", "real.xml"]
    assert not (refused.folder / "link.npz").exists()
    assert "real.npz" in (other / "real.xml").read_text()


DISK_FAULTS = [
    OSError(28, "No space left on device"),
    OSError(122, "Disk quota exceeded"),
    OSError("Not enough free space to write 34992000 bytes after offset 12"),
    OSError("4374000 requested and 1022 written"),
    RuntimeError('Failed to write pixel data to image file "/x/.a.exr". No space left on device.'),
]


@pytest.mark.parametrize("error", DISK_FAULTS, ids=lambda error: str(error)[:30])
def test_a_full_disk_is_one_line_that_names_the_file(refused, linked, monkeypatch, error):
    linked("measured.binary")

    def full(*args, **named):
        raise error

    monkeypatch.setattr("brdfatlas.files.np.lib.format.write_array", full)
    refused(["fit", "lambert", "measured.binary", "-o", "out.npz"], "out.npz: ")


def test_a_folder_that_takes_no_file_is_told_by_the_name_that_was_asked_for(tmp_path, monkeypatch):
    def refuse(*args, **options):
        raise PermissionError(13, "Permission denied", str(tmp_path / ".brdfatlas.a.txt.x"))

    monkeypatch.setattr("brdfatlas.files.tempfile.mkstemp", refuse)
    with pytest.raises(PermissionError) as told:
        files.write_text(tmp_path / "a.txt", "new")
    assert told.value.filename == str(tmp_path / "a.txt")


def test_other_faults_of_a_writer_stay_what_they_are(tmp_path):
    with pytest.raises(RuntimeError, match="mine"), files.atomic_path(tmp_path / "a.txt"):
        raise RuntimeError("mine")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("error", [OSError(28, "No space left on device"), KeyboardInterrupt()], ids=["full", "Ctrl-C"])
@pytest.mark.parametrize("earlier", [False, True])
def test_a_recommendation_is_saved_whole_or_not_at_all(inputs, tmp_path, monkeypatch, earlier, error):
    """Half of the files were refused by the next run as somebody else's."""
    winner = Row("ggx", 1.0, 8)
    fits = {"ggx": brdfatlas.load_fit(inputs / "ggx.npz")}
    found = Recommendation("felt", (winner,), winner, fits, {}, None)
    folder = tmp_path / "out"
    picture = b"\x89PNG tEXtSoftware\0brdfatlas"
    monkeypatch.setattr(Recommendation, "picture", lambda self, path: path.write_bytes(picture))
    if earlier:
        found.save(folder)
    before = state(tmp_path)

    def fail(self, path):
        raise error

    with monkeypatch.context() as patch:
        patch.setattr(Recommendation, "picture", fail)
        with pytest.raises(type(error)):
            found.save(folder)
    assert state(tmp_path) == before
    files_written = found.save(folder)
    assert {path.parent for path in files_written} == {folder}
    assert sorted(path.name for path in folder.iterdir()) == sorted(path.name for path in files_written)


RECOMMENDED = b'{\n "format": "brdfatlas recommendation 1",\n "material": "measured"\n}\n'


def a_text(path):
    path.write_bytes(b"mine\n")


def a_link_to_ours(path):
    """It would become a file."""
    path.with_name("elsewhere").touch()
    path.symlink_to("elsewhere")


@pytest.mark.parametrize("make", [a_text, a_folder, a_fifo, a_link_to_itself, a_link_to_ours])
@pytest.mark.parametrize(
    "name", ["side-by-side.png", "recommendation.json", "measured-lambert.npz", "measured-lambert.sampler.json"]
)
def test_a_recommendation_replaces_only_files_of_an_earlier_one(refused, linked, name, make):
    linked("measured.binary")
    (refused.folder / "out").mkdir()
    (refused.folder / "out" / "recommendation.json").write_bytes(RECOMMENDED)
    (refused.folder / "out" / name).unlink(missing_ok=True)
    make(refused.folder / "out" / name)
    line = ["recommend", "measured.binary", "--models", "lambert", "-o", "out"]
    refused(line, "out", "earlier recommendation", "name a new folder")


def test_a_recommendation_does_not_replace_its_input(refused, linked):
    (refused.folder / "out").mkdir()
    linked("measured.binary").rename("out/recommendation.json")
    line = ["recommend", "out/recommendation.json", "--models", "lambert", "-o", "out"]
    refused(line, "out/recommendation.json", "name a new folder")


def test_a_recommendation_may_replace_an_earlier_one(linked, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    linked("measured.binary")
    for _ in range(2):
        assert main(["recommend", "measured.binary", "--models", "lambert", "-o", "out"]) == 0
    assert (tmp_path / "out" / "measured-lambert.npz").is_file()


def recommendation(inputs, winner, material="felt"):
    """What names one of the plausible fits as the best."""
    row = Row(winner, 1.0, 8)
    fitted = replace(brdfatlas.load_fit(inputs / f"{winner}.npz"), material=material)
    return Recommendation(material, (row,), row, {winner: fitted}, {}, None)


@pytest.fixture
def no_picture(monkeypatch):
    """Recommendations without renders."""
    monkeypatch.setattr(
        Recommendation, "picture", lambda self, path: path.write_bytes(b"\x89PNG tEXtSoftware\0brdfatlas")
    )


def test_a_folder_holds_the_files_of_one_recommendation(inputs, tmp_path, no_picture):
    """Of the earlier winner goes what is as it was written; what a person changed or put there stays."""
    first = recommendation(inputs, "lambert").save(tmp_path / "out")
    (tmp_path / "out" / "felt-lambert.mtlx").write_text("mine")
    (tmp_path / "out" / "felt-lambert.txt").write_text("mine")
    (tmp_path / "felt-lambert.npz").write_bytes(first[0].read_bytes())
    second = recommendation(inputs, "ggx").save(tmp_path / "out")
    found = {path.name for path in (tmp_path / "out").iterdir()}
    assert found == {path.name for path in second} | {"felt-lambert.mtlx", "felt-lambert.txt"}
    record = json.loads(second[-1].read_text())
    (tmp_path / "felt-ggx.npz").write_bytes(second[0].read_bytes())
    for files_stated in ({f"../{name}": digest for name, digest in record["files"].items()}, ["felt-ggx.npz"], None):
        second[-1].write_text(json.dumps(record | {"files": files_stated}, indent=1))
        recommendation(inputs, "ward").save(tmp_path / "out")
        assert (tmp_path / "felt-ggx.npz").exists()
        assert (tmp_path / "out" / "felt-ggx.npz").exists()


def test_what_a_person_changed_in_a_recommendation_is_not_replaced(inputs, tmp_path, no_picture):
    made = recommendation(inputs, "lambert").save(tmp_path / "out")
    for path in made[:-1]:
        whole = path.read_bytes()
        path.write_bytes(whole + b" ")
        before = state(tmp_path)
        with pytest.raises(files.FileFault, match=rf"{path.name}: was changed since .*; name a new folder"):
            recommendation(inputs, "lambert").save(tmp_path / "out")
        assert state(tmp_path) == before
        path.write_bytes(whole)
    recommendation(inputs, "lambert").save(tmp_path / "out")


def test_the_recommendation_for_another_material_is_not_replaced(inputs, tmp_path, no_picture):
    recommendation(inputs, "lambert").save(tmp_path / "out")
    before = state(tmp_path)
    with pytest.raises(files.FileFault, match=r"out: holds the recommendation for felt; name a new folder"):
        recommendation(inputs, "lambert", "chrome").save(tmp_path / "out")
    assert state(tmp_path) == before


@pytest.mark.parametrize("folder", ["", "measured.binary", "measured.binary/sub", "dangling"])
def test_a_folder_that_cannot_be(refused, linked, folder):
    linked("measured.binary")
    (refused.folder / "dangling").symlink_to("nowhere")
    refused(["recommend", "measured.binary", "--models", "lambert", "-o", folder], "name another")


def test_a_scene_file_that_mitsuba_could_not_load_is_not_written(refused, linked):
    """``$`` names a parameter in any attribute of a scene, and nothing escapes it."""
    linked("ward.npz")
    refused(["export", "ward.npz", "--to", "mitsuba", "-o", "$a.xml"], "$a.npz: Mitsuba takes $", "another output")
    assert "$" not in stem_of("$a", "ward")
