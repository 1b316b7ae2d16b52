"""Running one rule alone: every other file of the small run is there, the rule's outputs are made anew."""

import os
import time
from pathlib import Path

import pytest


@pytest.fixture(scope="module", autouse=True)
def in_order_again(finished_run):
    """A rule that ran alone is newer than what follows from it; the next module finds a finished run again."""
    yield
    now = time.time()
    for path in [file for top in ("results", "reports") for file in (finished_run.root / top).rglob("*")]:
        os.utime(path, (now, now))


@pytest.fixture
def run_rule(finished_run):
    """run_rule(rule, target): remove ``target`` and run the one job that makes it; returns its path."""

    def run(rule: str, target: str) -> Path:
        path = finished_run.root / target
        path.unlink(missing_ok=True)
        done = finished_run.snakemake("--rerun-triggers", "mtime", "--allowed-rules", rule, "--", target)
        ran = finished_run.jobs(done.stdout)
        assert ran == {rule: 1}, f"one job of {rule} makes {target}, but there ran {ran}"
        assert path.exists()
        return path

    return run
