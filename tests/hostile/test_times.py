"""Inputs with a time stamp in the future, a camera's, another machine's, or of before a clock was set back; and inputs
that change while a run is at work."""

import os
import time
from pathlib import Path

import numpy as np
import pytest

from brdfatlas.angles import GRID_SHAPE
from brdfatlas.files import stamps, write_json
from brdfatlas.formats import merl
from brdfatlas.formats.merl import write_merl
from brdfatlas.formats.reader import read
from brdfatlas.measured import MeasuredError
from brdfatlas.pipeline.configuration import files_of_scene
from brdfatlas.pipeline.logs import logged
from brdfatlas.pipeline.materials import find_materials
from brdfatlas.settings import ConfigError

CONFIG = {"measured_folder": "data", "merl_folder": "data/merl", "materials": "all", "strict": False, "standins": []}


@pytest.mark.parametrize("ahead", [3600, 20 * 365 * 86400])
def test_a_file_of_the_future_is_left_out_until_it_is_touched(tmp_path, monkeypatch, ahead):
    """Snakemake would fail every job of it, after the work."""
    monkeypatch.chdir(tmp_path)
    table = np.full((*GRID_SHAPE, 3), 0.1, np.float32)
    for name in ("now", "later"):
        write_merl(Path("data") / f"{name}.binary", table)
    os.utime("data/later.binary", times=(time.time() + ahead,) * 2)
    for _ in range(2):  # the second time with the verdicts of the first
        found, left_out, verdicts = find_materials(CONFIG, "standins", "checks.json")
        assert [material.name for material in found] == ["now"]
        assert [item.name for item in left_out] == ["later"]
        assert left_out[0].reason.startswith("data/later.binary: ")
        assert "`touch`" in left_out[0].reason
        write_json("checks.json", verdicts)
    os.utime("data/later.binary")
    found, left_out, _ = find_materials(CONFIG, "standins", "checks.json")
    assert ([material.name for material in found], left_out) == (["later", "now"], [])


def test_a_file_that_changes_while_it_is_read_is_no_measurement(tmp_path, monkeypatch):
    """A copy that is written over it: the values read are of both."""
    path = tmp_path / "a.binary"
    write_merl(path, np.full((*GRID_SHAPE, 3), 0.1, np.float32))
    assert read(path).name == "a"

    def copy_over(table):
        os.utime(path, ns=(0, 0))
        return ()

    monkeypatch.setattr(merl, "suspicions", copy_over)
    with pytest.raises(MeasuredError, match=r"a\.binary: has changed while it was read; see that it is whole"):
        read(path)


def test_a_scenes_file_of_the_future_is_named(tmp_path):
    probe = tmp_path / "probe.exr"
    probe.touch()
    scene = {"geometry": [], "environment": {"file": str(probe)}}
    assert files_of_scene("mine", scene, "scenes.yaml", []) == [str(probe)]
    os.utime(probe, times=(time.time() + 3600,) * 2)
    with pytest.raises(ConfigError, match=r"^scenes\.yaml: mine\.environment\.file: .*probe\.exr: .*`touch`"):
        files_of_scene("mine", scene, "scenes.yaml", [])


def test_files_of_one_size_and_time_are_told_apart(tmp_path):
    """All files of a format may have one size, and all of an archive one time: swapped names are another input."""
    one, other = tmp_path / "one", tmp_path / "other"
    for path, place in ((one, 0), (other, -1)):
        content = bytearray(1_000_000)
        content[place] = 1
        path.write_bytes(content)
        os.utime(path, ns=(0, 0))
    before = stamps([one, other])
    one.rename(tmp_path / "aside")
    other.rename(one)
    (tmp_path / "aside").rename(other)
    after = stamps([one, other])
    assert [after[str(one)], after[str(other)]] == [before[str(other)], before[str(one)]]
    assert before[str(one)] != before[str(other)]


def test_a_file_that_changes_during_a_run_fails_the_jobs_that_read_it(tmp_path, monkeypatch, capsys):
    """Else a fit of the old file would stand beside renders of the new one."""
    monkeypatch.chdir(tmp_path)
    path, done = Path("a.binary"), []
    path.write_text("old")
    planned = stamps([path])

    def job(text: str) -> None:
        with logged("log", planned):
            path.write_text(text)
            os.utime(path, ns=(0, 0))
            done.append(text)

    with logged("log", planned):
        done.append("as planned")
    for text in ("new", "begun with another file"):
        with pytest.raises(SystemExit):
            job(text)
    path.unlink()
    with pytest.raises(SystemExit):
        job("begun without a file")
    assert done == ["as planned", "new"]
    lines = capsys.readouterr().err.splitlines()
    remedy = "during the run; see that it is whole and start the run again"
    assert lines == [f"a.binary: {what} {remedy}" for what in ("has changed", "has changed", "is gone")]
