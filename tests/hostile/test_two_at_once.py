"""Two commands at once in one folder."""

import os
import shutil
import subprocess
from contextlib import ExitStack
from pathlib import Path

import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from brdfatlas.fits import _one_blas_thread

ROOT = Path(__file__).resolve().parents[2]
#: Stands in for the Python of the virtual environment: notes when each of its steps begins and ends, and whose it is.
STEP = """#!/bin/sh
echo "$SETUP begins" >> steps
sleep 0.1
echo "$SETUP ends" >> steps
"""


@pytest.mark.skipif(shutil.which("flock") is None, reason="this system has no flock")
def test_a_second_set_up_waits_for_the_first(tmp_path):
    """`make report` beside `make test` in a fresh checkout: one removed the environment that the other was making."""
    (tmp_path / "scripts").mkdir()
    shutil.copy2(ROOT / "scripts" / "setup", tmp_path / "scripts" / "setup")
    (tmp_path / ".venv" / "bin").mkdir(parents=True)
    for name in ("python", "pip"):
        step = tmp_path / ".venv" / "bin" / name
        step.write_text(STEP + "echo found\n")
        step.chmod(0o755)
    running = [
        subprocess.Popen(["scripts/setup", "venv"], cwd=tmp_path, env=os.environ | {"SETUP": name})
        for name in ("first", "second")
    ]
    assert [process.wait(60) for process in running] == [0, 0]
    steps = (tmp_path / "steps").read_text().split("\n")[:-1]
    whose = [step.split()[0] for step in steps]
    assert whose in (sorted(whose), sorted(whose, reverse=True)), "not in turns"


def test_fits_at_once_leave_the_threads_of_linear_algebra_as_they_were():
    """The number of its threads is the process's: the first of two that restores it must not do so under the other,
    nor the other restore what the first had set."""
    with threadpool_limits(3, user_api="blas"):
        first, second = ExitStack(), ExitStack()
        first.enter_context(_one_blas_thread())
        second.enter_context(_one_blas_thread())
        first.close()
        assert blas_threads() == {1}
        second.close()
        assert blas_threads() == {3}


def blas_threads():
    return {library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"}
