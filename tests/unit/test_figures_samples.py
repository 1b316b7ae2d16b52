"""The figure of scattered samples: drawn where there are any, and nowhere else."""

import numpy as np

from brdfatlas.angles import GRID_SHAPE
from brdfatlas.figures.samples import plot_samples
from brdfatlas.measured import Measured


def test_samples_are_drawn_where_there_are_any(tmp_path):
    table = np.full((*GRID_SHAPE, 3), 0.1, np.float32)
    assert not plot_samples(Measured("m", table), tmp_path / "none.svg")
    assert not (tmp_path / "none.svg").exists()
    distance = np.full(GRID_SHAPE, np.nan, np.float32)
    distance[20:60] = 3
    samples = np.random.default_rng(0).random((40, 3))
    for name in ("a.svg", "b.svg"):
        assert plot_samples(Measured("m", table, distance=distance, samples=samples), tmp_path / name)
    assert (tmp_path / "a.svg").read_bytes() == (tmp_path / "b.svg").read_bytes()
