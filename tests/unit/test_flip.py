"""FLIP against its authors' own program, and its laws."""

import numpy as np
import pytest
from flip_evaluator import evaluate
from scipy.ndimage import gaussian_filter

from brdfatlas.measures.flip import SCALE, flip, see


def pictures(kind):
    """Two display images (60, 90, 3) of structures from a pixel up, an odd one among them."""
    rng = np.random.default_rng(1)
    a = gaussian_filter(rng.random((60, 90, 3)), (4, 4, 0), mode="wrap")
    a = (a - a.min()) / np.ptp(a)
    y, x = np.mgrid[:60, :90]
    a[(x - 30) ** 2 + (y - 30) ** 2 < 150] = (0.9, 0.6, 0.1)
    changed = {
        "darker": 0.8 * a,
        "noisy": a + rng.normal(0, 0.1, a.shape),
        "redder": a * (1, 0.9, 0.7),
        "moved": np.roll(a, 2, 1),
        "another": a[::-1, ::-1, ::-1],
    }
    return a, np.clip(changed[kind], 0, 1)


@pytest.mark.parametrize("scale", [SCALE, SCALE / 2, 40.0])
@pytest.mark.parametrize("kind", ["darker", "noisy", "redder", "moved", "another"])
def test_flip_is_that_of_its_authors(kind, scale):
    a, b = (np.ascontiguousarray(x, np.float32) for x in pictures(kind))
    settings = {"applyMagma": False, "computeMeanError": False, "parameters": {"ppd": scale}}
    expected = np.asarray(evaluate(a, b, "LDR", **settings)[0]).reshape(a.shape[:2])
    found = flip(see(a, scale), see(b, scale))
    # Both calculate in single precision, and features enter by a square root: 1e-7 becomes 3e-4 of a pixel's value.
    assert found.mean() == pytest.approx(expected.mean(), rel=1e-5)
    np.testing.assert_allclose(found, expected, atol=3e-4)


def test_equal_pictures_do_not_differ_and_black_and_white_do():
    a, _ = pictures("darker")
    assert (flip(see(a), see(a)) == 0).all()
    black, white = see(np.zeros((20, 20, 3))), see(np.ones((20, 20, 3)))
    assert flip(black, white).min() > 0.9


def test_flip_is_symmetric_and_refuses_two_scales():
    a, b = (see(x) for x in pictures("moved"))
    np.testing.assert_array_equal(flip(a, b), flip(b, a))
    with pytest.raises(ValueError, match="67 and 33"):
        flip(a, see(pictures("moved")[1], 33.0))
