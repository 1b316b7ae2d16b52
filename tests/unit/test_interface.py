"""What a caller may get wrong at the public entrance is one line that says what is wanted."""

import numpy as np
import pytest

import brdfatlas
from brdfatlas.angles import GRID_SHAPE
from brdfatlas.fits import Fit
from brdfatlas.models import MODELS
from brdfatlas.models.base import Factors, Function, Result
from brdfatlas.recommend import Recommendation
from brdfatlas.rendering.images import Render
from brdfatlas.rendering.scenes import PreparedScene, SceneError
from brdfatlas.sampling import Mixture

UP = np.array([0.0, 0.0, 1.0])
LAMBERT = MODELS["lambert"]
FIT = Fit("lambert", "felt", {p.name: np.full(p.shape, 0.5, p.dtype) for p in LAMBERT.parameters})
MEASURED = brdfatlas.Measured("felt", np.full((*GRID_SHAPE, 3), 0.1, np.float32))
PATHS = [b"felt.binary", 3, None]
DIRECTIONS = {
    "two components": UP[:2],
    "one component each": np.ones((5, 1)),
    "a number": 1.0,
    "nothing": None,
    "a text": "up",
    "complex": UP + 0j,
    "rows of two lengths": [[0, 0, 1], [0, 1]],
    "no broadcast": np.tile(UP, (2, 1)),
}


def one_line(kind, words, call, *arguments, **options):
    with pytest.raises(kind, match=words) as caught:
        call(*arguments, **options)
    assert type(caught.value) is kind
    assert len(str(caught.value).splitlines()) == 1


@pytest.mark.parametrize("path", PATHS)
def test_paths(path):
    for read in (brdfatlas.read, brdfatlas.read_merl, brdfatlas.load_fit, brdfatlas.recommend):
        one_line(TypeError, "is no path; give a str or a pathlib.Path", read, path)
    one_line(TypeError, "is no path", FIT.save, path)
    one_line(TypeError, "is no path", brdfatlas.write_merl, path, MEASURED.table)


@pytest.mark.parametrize("model", [5, None, b"lambert", type(LAMBERT)])
def test_models(model):
    one_line(TypeError, "is no model; give a name", brdfatlas.fit, model, MEASURED)


@pytest.mark.parametrize("wrong", DIRECTIONS.values(), ids=DIRECTIONS)
def test_directions(wrong):
    other = np.tile(UP, (3, 1))
    for evaluate in (FIT.evaluate, MEASURED.evaluate, MEASURED.evaluate_measured):
        for pair in ((wrong, other), (other, wrong)):
            one_line(ValueError, "^directions ", evaluate, *pair)


@pytest.mark.filterwarnings("error")
def test_a_direction_that_is_not_finite_has_no_value_and_one_that_is_too_long_is_refused():
    for evaluate in (FIT.evaluate, MEASURED.evaluate, MEASURED.evaluate_measured):
        for value in (np.nan, np.inf, -np.inf):
            for wrong in ([0.0, value, 1.0], [value, value, value]):
                assert np.isnan(evaluate(wrong, UP)).all()
                assert np.isnan(evaluate(UP, wrong)).all()
        for length in (1e200, 1e308):
            one_line(ValueError, "^a direction of length inf", evaluate, [length, 0.0, 0.0], UP)


def test_directions_of_any_numbers_that_broadcast():
    for evaluate in (FIT.evaluate, MEASURED.evaluate, MEASURED.evaluate_measured):
        assert evaluate([0, 0, 1], np.tile(UP, (4, 2, 1)).astype(np.float32)).shape == (4, 2, 3)
        assert evaluate(np.zeros((0, 3)), UP).shape == (0, 3)


@pytest.mark.parametrize(
    ("options", "kind", "words"),
    [
        ({"processes": 1.5}, ValueError, "processes 1.5: a whole number from 1"),
        ({"processes": None}, ValueError, "processes None"),
        ({"size": "96"}, SceneError, "^size: '96': .* a whole number from 1$"),
        ({"samples": 0}, SceneError, "^samples: 0: .* a whole number from 8$"),
        ({"samples": 7}, SceneError, "^samples: 7: .* a whole number from 8$"),
        ({"budget": "64"}, ValueError, "budget '64': a number of bytes"),
        ({"budget": float("nan")}, ValueError, "budget nan"),
        ({"models": 5}, TypeError, "models 5: names"),
        ({"models": b"ggx"}, TypeError, "models b'ggx': names"),
    ],
)
def test_numbers_of_a_recommendation(options, kind, words):
    one_line(kind, words, brdfatlas.recommend, MEASURED, **options)


@pytest.mark.parametrize(
    "kind", [Fit, brdfatlas.Measured, Render, Recommendation, Function, Factors, Result, PreparedScene, Mixture]
)
def test_what_holds_arrays_is_not_compared_by_its_fields(kind):
    """NumPy would say that the truth value of an array is ambiguous."""
    assert not kind.__dataclass_params__.eq
