"""Every reader checks for a regular file first: nothing hangs, nothing is misread, each fault is one line."""

import os
import socket

import pytest

import brdfatlas
from brdfatlas import files
from brdfatlas.export.fit_json import import_json
from brdfatlas.models import load_model_file

READERS = {
    "info": ["info", "{x}"],
    "fit": ["fit", "ggx", "{x}", "-o", "out.npz"],
    "fit --source": ["fit", "mine", "measured.binary", "--source", "{x}", "-o", "out.npz"],
    "table": ["table", "{x}", "-o", "out.binary"],
    "table --source": ["table", "ggx.npz", "--source", "{x}", "-o", "out.binary"],
    "export": ["export", "{x}", "-o", "out.json"],
    "uber-texture": ["uber-texture", "{x}", "-o", "out.exr"],
    "uber-texture, second": ["uber-texture", "g_from_d.npz", "{x}", "-o", "out.exr"],
    "compare, first": ["compare", "{x}", "measured.binary"],
    "compare, second": ["compare", "measured.binary", "{x}"],
    "render": ["render", "{x}", "--size", "8", "-o", "out.exr"],
    "render --scenes": ["render", "measured.binary", "--scenes", "{x}", "-o", "out.exr"],
    "render --reference": ["render", "ggx.npz", "--reference", "{x}", "-o", "out.exr"],
    "image-errors, reference": ["image-errors", "{x}", "picture.exr"],
    "image-errors, image": ["image-errors", "picture.exr", "{x}"],
}

NEEDED = {"measured.binary", "ggx.npz", "g_from_d.npz", "picture.exr"}


def a_fifo(path):
    os.mkfifo(path)


def a_folder(path):
    path.mkdir()


def a_socket(path):
    with socket.socket(socket.AF_UNIX) as unix:
        unix.bind(path.name)


def a_link_to_itself(path):
    path.symlink_to(path.name)


def a_dangling_link(path):
    path.symlink_to("nothing")


def nothing(path):
    pass


def an_empty_file(path):
    path.touch()


def zeros(path):
    path.write_bytes(bytes(5000))


def text(path):
    path.write_text("not what you think\n" * 50)


def bytes_that_are_no_text(path):
    path.write_bytes(bytes(range(256)) * 20)


KINDS = (
    *(a_fifo, a_folder, a_socket, a_link_to_itself, a_dangling_link, nothing),
    *(an_empty_file, zeros, text, bytes_that_are_no_text),
)


@pytest.mark.parametrize("make", KINDS)
@pytest.mark.parametrize("reader", READERS)
def test_a_reader_names_what_it_cannot_read(refused, linked, reader, make):
    for name in NEEDED & set(READERS[reader]):
        linked(name)
    ending = {"--source": ".py", "--scenes": ".yaml"}.get(reader.split()[-1], "")
    path = refused.folder / f"strange{ending}"
    make(path)
    refused([item.replace("{x}", path.name) for item in READERS[reader]], path.name)


@pytest.mark.parametrize("make", [a_fifo, a_folder, a_socket])
@pytest.mark.parametrize(
    "read", [brdfatlas.load_fit, brdfatlas.read_merl, import_json, files.read_json, files.read_npz, load_model_file]
)
def test_readers_of_the_package_do_so_too(tmp_path, monkeypatch, read, make):
    monkeypatch.chdir(tmp_path)
    make(tmp_path / "strange")
    with pytest.raises((ValueError, ImportError), match="strange: ") as caught:
        read(tmp_path / "strange")
    assert "\n" not in str(caught.value)


NAMES = ["two\nlines", "tab\tbed", "bell\a", "esc\x1b[31mred", "line\u2028separator", "no\udcfftext"]


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("reader", ["info", "fit", "compare, first", "table", "render", "image-errors, image"])
def test_a_name_cannot_split_a_message(refused, linked, reader, name):
    for needed in ("measured.binary", "picture.exr"):
        linked(needed)
    err = refused([item.replace("{x}", name) for item in READERS[reader]])
    assert len(err.splitlines()) == 1
    assert "\x1b" not in err
