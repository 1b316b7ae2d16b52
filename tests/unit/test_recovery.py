"""What a run mends before it begins: dead locks, damaged files, time stamps of the future."""

import json
import os
import subprocess
import sys
import time
from base64 import urlsafe_b64encode

import pytest

from brdfatlas.files import atomic_path
from brdfatlas.pipeline import recovery
from brdfatlas.pipeline.download import checksum_of

HOUR = 3600.0


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "results").mkdir()
    yield tmp_path
    while recovery._held:
        recovery._held.pop().close()


@pytest.fixture
def said():
    return []


HOLDER = """
import sys, time
from pathlib import Path
from brdfatlas.pipeline.recovery import take_over_lock
take_over_lock(Path(".snakemake"))
locks = Path(".snakemake/locks")
locks.mkdir(exist_ok=True)
(locks / "0.output.lock").write_text("results/a\\n")
print("held", flush=True)
time.sleep(60)
"""


@pytest.fixture
def holder():
    process = subprocess.Popen([sys.executable, "-c", HOLDER], stdout=subprocess.PIPE, text=True)
    assert process.stdout.readline() == "held\n"
    yield process
    process.kill()
    process.wait()


def test_the_lock_of_a_killed_run_is_removed(folder, holder, said):
    holder.kill()
    holder.wait()
    recovery.take_over_lock(say=said.append)
    assert list((folder / ".snakemake" / "locks").iterdir()) == []
    assert said == ["an earlier run was killed; going on where it stopped"]


def test_the_lock_of_a_living_run_is_respected(folder, holder):
    with pytest.raises(ValueError, match="another run is at work here"):
        recovery.take_over_lock(patience=0.3)
    assert (folder / ".snakemake" / "locks" / "0.output.lock").exists()


def test_what_a_killed_writer_left_is_removed_and_nothing_else(folder):
    with atomic_path(folder / "results" / "fit.npz") as temporary:
        left = temporary.name
    (folder / "results" / left).touch()  # a killed writer would not have removed it
    (folder / "results" / ".hidden").touch()
    (folder / "results" / "a.longname.npz").touch()
    recovery.remove_unfinished("results")
    assert {path.name for path in (folder / "results").iterdir()} == {"fit.npz", ".hidden", "a.longname.npz"}


def test_a_truncated_file_is_removed_and_a_whole_one_stays(folder, said):
    good, bad = folder / "results" / "good.npz", folder / "results" / "bad.npz"
    good.write_bytes(b"good" * 100)
    bad.write_bytes(b"bad" * 100)
    recovery.record_outputs(["results/good.npz", "results/bad.npz", "results/never-made.npz"])
    bad.write_bytes(b"bad" * 50)
    assert recovery.remove_damaged(say=said.append) == ["results/bad.npz"]
    assert good.exists()
    assert not bad.exists()
    assert said == ["results/bad.npz: damaged since it was made (150 of 300 bytes); made again now"]
    assert set(recovery.read_ledger()) == {"results/good.npz"}


def test_a_file_of_the_same_size_is_judged_by_its_checksum(folder, said):
    touched, changed = folder / "results" / "touched", folder / "results" / "changed"
    touched.write_bytes(b"same")
    changed.write_bytes(b"this")
    recovery.record_outputs(["results/touched", "results/changed"])
    os.utime(touched, (1, 1))
    changed.write_bytes(b"that")
    os.utime(changed, (1, 1))
    assert recovery.remove_damaged(say=said.append) == ["results/changed"]
    assert recovery.read_ledger()["results/touched"][1] == 10**9, "the new time stamp spares the next check its work"


def test_a_ledger_cut_short_by_a_kill_is_read_as_far_as_it_goes(folder):
    (folder / "results" / "a").write_bytes(b"a")
    recovery.record_outputs(["results/a"])
    with open("results/ledger.tsv", "a") as handle:
        handle.write("results/b\t12\t34")
    assert set(recovery.read_ledger()) == {"results/a"}
    recovery.record_outputs(["results/a"])
    assert "results/a" in recovery.read_ledger()


def recorded_output(folder, source_checksum):
    """An output from the future with Snakemake's record of its input."""
    output = folder / "results" / "fit.npz"
    output.write_bytes(b"fit")
    future = time.time() + HOUR
    os.utime(output, (future, future))
    recovery.record_outputs(["results/fit.npz"])
    metadata = folder / ".snakemake" / "metadata"
    metadata.mkdir(parents=True)
    name = urlsafe_b64encode(b"results/fit.npz").decode()
    (metadata / name).write_text(json.dumps({"input_checksums": {"model.py": source_checksum}}))
    return output


def test_an_output_from_the_future_stays_if_its_inputs_are_the_same(folder, said):
    (folder / "model.py").write_text("same")
    output = recorded_output(folder, checksum_of(folder / "model.py"))
    recovery.mend_time_stamps(["model.py"], say=said.append)
    assert output.stat().st_mtime <= time.time()
    assert recovery.remove_damaged(say=said.append) == []


def test_an_output_from_the_future_goes_if_an_input_changed(folder, said):
    (folder / "model.py").write_text("before")
    output = recorded_output(folder, checksum_of(folder / "model.py"))
    (folder / "model.py").write_text("after")
    recovery.mend_time_stamps(["model.py"], say=said.append)
    assert not output.exists()
    assert said == ["results/fit.npz: from the future, and its inputs changed; made again now"]


def test_an_input_from_the_future_becomes_one_of_now(folder, said):
    source = folder / "src" / "deep" / "model.py"
    source.parent.mkdir(parents=True)
    source.write_text("x")
    os.utime(source, (time.time() + HOUR,) * 2)
    recovery.mend_time_stamps(["src", "missing"], say=said.append)
    assert source.stat().st_mtime <= time.time()
    assert len(said) == 1


def test_a_folder_that_cannot_be_written_is_named(folder):
    (folder / "results").rmdir()
    (folder / "results").write_text("a file in its place")
    with pytest.raises(ValueError, match=r"results: cannot be written .*; make it writable") as fault:
        recovery.check_writable("results")
    assert "\n" not in str(fault.value)
