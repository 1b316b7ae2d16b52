"""What the log of a job says about an error."""

from pathlib import Path

import pytest

from brdfatlas.files import check_regular, write_npz
from brdfatlas.measures.tables import write_tables
from brdfatlas.measures.tsv import read_tsv
from brdfatlas.pipeline.leftovers import record_reports_job
from brdfatlas.pipeline.logs import fault
from brdfatlas.pipeline.records import failures, manifest
from brdfatlas.rendering.scenes import load_scene
from brdfatlas.reports.data import read_material


@pytest.fixture
def results(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "results/fits/nickel").mkdir(parents=True)
    return tmp_path / "results/fits/nickel"


def test_a_folder_in_place_of_a_result_is_named_with_the_remedy(results):
    (results / "ggx.npz").mkdir()
    for read in (check_regular, lambda path: Path(path).read_bytes()):
        with pytest.raises(Exception, match=r"a folder|a directory") as caught:
            read("results/fits/nickel/ggx.npz")
        assert fault(caught.value).endswith("delete it: the next run makes it again")


def test_no_file_is_blamed_for_what_it_has_no_part_in(results):
    (results / "ggx.npz").write_bytes(b"")
    assert "delete it" in fault(ValueError("results/fits/nickel/ggx.npz: no zip file"))
    told = "results/fits/nickel/ggx.npz: of another; delete it, the next run makes it again"
    assert fault(ValueError(told)) == f"ValueError: {told}"
    assert "delete" not in fault(OSError(28, "No space left on device", "results/fits/nickel/ggx.npz"))
    assert "delete" not in fault(ValueError("results/fits/nickel: nothing there"))
    assert "delete" not in fault(ValueError("results/fits/nickel/gone.npz: no such file"))


def describe(path):
    manifest({}, {}, {}, [], [path], "", {})


def clear_up(path):
    record_reports_job([], {path: "reports/materials/nickel"}, "results/none.tsv", print)


def tabulate(path):
    write_tables([path], [path], [], [], "results/tables")


def material_with(path):
    Path("results/facts.json").write_text('{"name": "nickel"}')
    read_material("results/facts.json", [path])


@pytest.mark.parametrize(
    ("content", "read"),
    [
        *[("[1]", read) for read in (describe, clear_up, material_with, read_material)],
        *[("{}", read) for read in (describe, material_with, read_material)],
        ("[1]", lambda path: failures([path])),
        ('{"status": "failed"}', lambda path: failures([path])),
        ('{"files": ["a"]}', clear_up),
        *[
            (f'{{"status": "ok", {part}}}', material_with)
            for part in ('"seconds": "abc"', '"bytes": []', '"options": 1')
        ],
        *[(f'{{"status": "ok", "physics": {part}}}', material_with) for part in ("1", '{"bad_cells": "a"}')],
        ("a\tb\n1\t2\n", tabulate),
        ("material\tmodel\tscene\tstatus\tpsnr\nx\ty\tz\tok\tabc\n", tabulate),
        ("material\tmodel\nx\ty\tz\tw\n", tabulate),
        ("\n", tabulate),
        ("model\n\udcff\n", read_tsv),
        ("\udcff\n", lambda path: record_reports_job([], {}, path, print)),
    ],
)
def test_a_file_of_another_kind_is_named_with_the_remedy(results, content, read):
    path = "results/fits/nickel/ggx.json"
    Path(path).write_bytes(content.encode("utf-8", "surrogateescape"))
    with pytest.raises(ValueError, match=path) as caught:
        read(path)
    assert f"; if {path} is damaged, delete it: the next run makes it again" in fault(caught.value)


@pytest.mark.parametrize("arrays", [{}, {"labels": "[1]"}, {"labels": "{"}, {"labels": '{"surfaces": []}'}])
def test_another_npz_in_place_of_a_scene_is_named_with_the_remedy(results, arrays):
    path = "results/scenes/sphere.npz"
    write_npz(path, arrays)
    with pytest.raises(ValueError, match=path) as caught:
        load_scene(path)
    assert f"; if {path} is damaged, delete it: the next run makes it again" in fault(caught.value)
