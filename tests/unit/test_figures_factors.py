"""Figures of the factor models: they are drawn, equal data give equal pictures, and models without factors say so."""

import numpy as np
import pytest
from PIL import Image

from brdfatlas.angles import GRID_SHAPE, above_horizon
from brdfatlas.figures.factors import compressed, plot_convergence, plot_slices, plot_weights, slice_of
from brdfatlas.figures.functions import plot_functions
from brdfatlas.fits import Fit
from brdfatlas.measured import Measured
from brdfatlas.models import MODELS


def random_fit(model: str) -> Fit:
    random = np.random.default_rng(1)
    return Fit(model, "m", {p.name: random.uniform(0.1, 1, p.shape).astype(p.dtype) for p in MODELS[model].parameters})


@pytest.fixture(scope="module")
def measured() -> Measured:
    table = np.full((*GRID_SHAPE, 3), 0.1, np.float32)
    table[:10] = 5.0
    table[~above_horizon()] = np.nan
    return Measured("m", table)


def test_tone_map():
    """0 stays 0, the median becomes 1/2, nothing reaches 1 (Eq. 12 with alpha = log 2)."""
    assert compressed(np.array([0.0, 3.0, 6.0]), 3.0) == pytest.approx([0, 0.5, 0.75])
    assert compressed(np.array([-1.0]), 3.0) == pytest.approx([0.0])


def test_factor_curves(tmp_path):
    for name in ("independent_g", "naive", "bivariate_g", "low_rank_2"):
        path, again = tmp_path / f"{name}.svg", tmp_path / "again.svg"
        assert plot_functions(random_fit(name), path)
        assert plot_functions(random_fit(name), again)
        assert path.read_bytes() == again.read_bytes()
    assert not plot_functions(random_fit("bivariate"), tmp_path / "none.svg")
    assert not (tmp_path / "none.svg").exists()


@pytest.mark.parametrize("ending", ["svg", "png", "webp"])
def test_slices_and_weights(ending, measured, tmp_path):
    plot_slices(measured, {"naive": slice_of(random_fit("naive").table())}, tmp_path / f"slices.{ending}", title="m")
    plot_weights(measured, tmp_path / f"weights.{ending}")
    assert all((tmp_path / f"{name}.{ending}").stat().st_size > 2000 for name in ("slices", "weights"))


def test_any_number_of_slices_makes_a_picture(measured, tmp_path):
    cells = slice_of(measured.table)
    plot_slices(measured, {f"model {number}": cells for number in range(70)}, tmp_path / "slices.webp")
    with Image.open(tmp_path / "slices.webp") as image:
        assert max(image.size) < 16384
        assert image.height > 4 * 300  # in rows


def test_convergence(tmp_path):
    starts = [{"name": name, "history": [1.0, 0.1, 0.01], "iterations": 2} for name in ("ones", "slices")]
    assert plot_convergence([{"starts": starts}, {"history": [1.0, 0.5]}, {"starts": []}], tmp_path / "curves.svg")
    assert not plot_convergence([{"starts": []}], tmp_path / "none.svg")
