"""`make bench` runs: each benchmark on one stand-in. What it measures is for a person to read."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest

from brdfatlas.pipeline.standins import write_standin

#: What would take half a minute more.
SMALL = {"bench_factors": {"models": ("naive", "bivariate")}}
BENCHMARKS = sorted((Path(__file__).parents[2] / "benchmarks").glob("bench_*.py"))


@pytest.fixture(scope="module")
def standin(tmp_path_factory):
    path = tmp_path_factory.mktemp("bench") / "pink-felt.binary"
    write_standin(path.stem, path)
    return path


@pytest.mark.parametrize("path", BENCHMARKS, ids=lambda path: path.stem)
def test_every_benchmark_runs(path, standin, capsys):
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    if path.stem == "bench_rendering":
        module.SIZE = 16  # of a picture; at its own size it takes two minutes
    ratios = module.main([standin], **SMALL.get(path.stem, {}))
    assert capsys.readouterr().out
    assert ratios is None or np.isfinite(ratios).all()
