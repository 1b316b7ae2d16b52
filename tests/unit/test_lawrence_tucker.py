"""The factorizations: recovery of what they can represent, monotone solvers, bad input."""

from pathlib import Path

import numpy as np
import pytest

from brdfatlas.angles import GRID_SHAPE, above_horizon, directions, grid_axes, grid_cosines
from brdfatlas.fits import fit, load_fit
from brdfatlas.measured import Measured, fold
from brdfatlas.models import MODELS
from brdfatlas.models.base import FitError
from brdfatlas.models.factorised.half_outgoing import (
    grid_coordinates,
    half_outgoing,
    node_directions,
    parse_resolution,
)
from brdfatlas.models.factorised.lawrence import highlight_class
from brdfatlas.objectives import log_deviation
from brdfatlas.solvers.nmf import Factors, Samples, factorize
from brdfatlas.solvers.tensor import bilinear_rows, residual_terms, sum_terms

NAMES = ("lawrence", "tucker")
#: small fits, for laws that hold at any size
SMALL = {"lawrence": {"resolution": "40x8x8"}, "tucker": {"terms": 8, "resolution": "45x16x16"}}


def material(values: np.ndarray, name: str = "made", keep: np.ndarray | None = None) -> Measured:
    table = np.array(np.broadcast_to(values, (*GRID_SHAPE, 3)), np.float32, copy=True)
    table[~above_horizon()] = np.nan
    if keep is not None:
        table[~keep] = np.nan
    return Measured(name, table, standin=True)


def plastic(alpha: float = 0.1) -> np.ndarray:
    """A coloured diffuse base and a white Beckmann lobe, 1/sr; below the horizon 0."""
    theta_h, theta_d, _ = grid_axes()
    cos_i, cos_o = grid_cosines()
    d = np.exp(-((np.tan(theta_h) / alpha) ** 2)) / (np.pi * alpha**2 * np.cos(theta_h) ** 4)
    schlick = 0.05 + 0.95 * (1 - np.cos(theta_d)) ** 5
    with np.errstate(all="ignore"):
        lobe = d * schlick / (4 * np.maximum(cos_i, cos_o) * np.cos(theta_d))
    return np.array([0.15, 0.05, 0.02]) + np.where(above_horizon(), lobe, 0)[..., None]


def evaluate_samples(factors: Factors, samples: Samples) -> np.ndarray:
    """The factorization at the samples, (rows, samples, 3)."""
    inner = factors.u.shape[1] // factors.f.shape[2]

    def blend(array: np.ndarray, position: np.ndarray) -> np.ndarray:
        low = np.minimum(position.astype(int), len(array) - 2)
        t = (position - low).reshape(position.shape + (1,) * (array.ndim - 1))
        return (1 - t) * array[low] + t * array[low + 1]

    terms = factors.u[:, None, :] * blend(factors.v, samples.v_position)
    terms = terms.reshape(*terms.shape[:2], -1, inner).sum(-1)
    return np.einsum("hsj,hscj->hsc", terms, blend(factors.f, samples.f_position))


@pytest.fixture(scope="module")
def plastic_fits():
    measured = material(plastic())
    return measured, {name: fit(name, measured) for name in NAMES}


# coordinates


def test_coordinates_come_back_from_directions():
    rng = np.random.default_rng(1)
    theta_h, phi, theta_o = rng.uniform(0.01, 0.7, 500), rng.uniform(0.01, 3.1, 500), rng.uniform(0.01, 0.7, 500)
    wi, wo = node_directions(theta_h, phi, theta_o)
    seen = wi[:, 2] > 0
    assert seen.sum() > 100
    for found, expected in zip(half_outgoing(wi[seen], wo[seen]), (theta_h, phi, theta_o)):
        np.testing.assert_allclose(found, expected[seen], atol=1e-9)


def test_coordinates_do_not_change_when_the_pair_turns_or_mirrors():
    rng = np.random.default_rng(2)
    wi, wo = (v / np.linalg.norm(v, axis=-1, keepdims=True) for v in rng.normal(size=(2, 300, 3)) + [0, 0, 3])
    turn = np.array([[0.6, -0.8, 0], [0.8, 0.6, 0], [0, 0, 1]])
    for other in (turn, np.diag([1, -1, 1])):
        for a, b in zip(half_outgoing(wi, wo), half_outgoing(wi @ other.T, wo @ other.T)):
            np.testing.assert_allclose(a, b, atol=1e-12)


def test_grid_coordinates_are_those_of_the_grids_directions():
    theta_h, theta_d, phi_d = grid_axes()
    wi, wo = directions(theta_h[::7, ::1], theta_d[:, ::5], phi_d[..., ::9])
    above = np.minimum(wi[..., 2], wo[..., 2]) > 0
    phi, theta_o = grid_coordinates()
    _, expected_phi, expected_theta_o = half_outgoing(wi, wo)
    # float32 storage
    np.testing.assert_allclose(phi[::7, ::5, ::9][above], expected_phi[above], atol=1e-5)
    np.testing.assert_allclose(theta_o[::7, ::5, ::9][above], expected_theta_o[above], atol=1e-6)


@pytest.mark.parametrize("text", ["90x36", "90x36x1", "axbxc", "90x36x-4", ""])
def test_a_wrong_resolution_names_model_and_key(text):
    with pytest.raises(ValueError, match=r"model tucker: resolution"):
        parse_resolution(text, "tucker")


# solvers


def test_residual_terms_recover_a_rank_one_tensor_with_missing_entries():
    rng = np.random.default_rng(3)
    a, b, c = (rng.uniform(0.5, 2, n) for n in (12, 9, 7))
    tensor = np.einsum("i,j,k->ijk", a, b, c)
    weight = rng.uniform(0.2, 1, tensor.shape) * (rng.random(tensor.shape) > 0.6)
    scale, fa, fb, fc, history = residual_terms(np.where(weight > 0, tensor, 1e9), weight, 3, tolerance=1e-12)
    # the entries that were missing come back too
    np.testing.assert_allclose(np.einsum("t,ti,tj,tk->ijk", scale, fa, fb, fc), tensor, rtol=1e-5)
    assert history[1] < 1e-9 * history[0]


def test_every_term_lowers_the_residual_by_its_gain():
    rng = np.random.default_rng(4)
    tensor, weight = rng.normal(size=(10, 8, 6)), rng.random((10, 8, 6))
    scale, a, b, c, history = residual_terms(tensor, weight, 12)
    assert np.all(np.diff(history) < 0)
    left = tensor - np.einsum("t,ti,tj,tk->ijk", scale, a, b, c)
    assert (weight * left**2).sum() == pytest.approx(history[-1], rel=1e-9)


def test_the_first_term_is_the_best_rank_one_matrix():
    # with two entries equal along the third axis the tensor is a matrix, where the best rank-one term is known: the SVD
    rng = np.random.default_rng(5)
    matrix = rng.normal(size=(9, 7)) + 1
    tensor = np.repeat(matrix[..., None], 2, axis=2)
    _, *_, history = residual_terms(tensor, np.ones(tensor.shape), 1, tolerance=1e-12, max_iterations=500)
    singular = np.linalg.svd(matrix, compute_uv=False)
    assert history[1] == pytest.approx(2 * (singular[1:] ** 2).sum(), rel=1e-6)


def test_a_tensor_of_zeros_has_terms_of_zero():
    scale, *factors, history = residual_terms(np.zeros((4, 5, 6)), np.ones((4, 5, 6)), 3)
    assert np.all(scale == 0)
    assert history == [0, 0, 0, 0]
    assert all(np.isfinite(factor).all() for factor in factors)


def made_samples(outer: int, inner: int, seed: int = 6) -> tuple[Samples, Factors]:
    rng = np.random.default_rng(seed)
    rows, count, n_v, n_f = 20, 150, 6, 5
    truth = Factors(
        rng.uniform(0, 1, (rows, outer * inner)),
        rng.uniform(0, 1, (n_v, outer * inner)),
        rng.uniform(0, 1, (n_f, 3, outer)),
    )
    shape = (rows, count)
    empty = Samples(
        np.zeros((*shape, 3)),
        rng.uniform(0.1, 1, (*shape, 3)) * (rng.random(shape) > 0.3)[..., None],
        rng.uniform(0, n_v - 1, shape),
        rng.uniform(0, n_f - 1, shape),
        n_v,
        n_f,
    )
    value = evaluate_samples(truth, empty)
    return Samples(value, empty.weight, empty.v_position, empty.f_position, n_v, n_f), truth


@pytest.mark.parametrize(("outer", "inner"), [(1, 1), (3, 1), (2, 2)])
def test_multiplicative_updates_never_raise_the_error_and_keep_the_signs(outer, inner):
    samples, truth = made_samples(outer, inner)
    rng = np.random.default_rng(7)
    start = Factors(*(rng.uniform(0.5, 1, a.shape) for a in (truth.u, truth.v, truth.f)))
    factors, history, _ = factorize(samples, start, max_iterations=60, tolerance=0)
    # rounding of the normal equations
    assert np.all(np.diff(history) <= 1e-9 * history[0])
    assert min(factors.u.min(), factors.v.min(), factors.f.min()) >= 0
    left = (samples.weight * (samples.value - evaluate_samples(factors, samples)) ** 2).sum()
    assert left == pytest.approx(history[-1], rel=1e-6, abs=1e-9 * history[0])
    assert history[-1] < 0.1 * history[0] or outer == 1


def test_one_term_is_recovered():
    samples, truth = made_samples(1, 1)
    start = Factors(np.ones_like(truth.u), np.ones_like(truth.v), np.ones_like(truth.f))
    factors, history, converged = factorize(samples, start, max_iterations=400, tolerance=1e-9)
    assert converged
    assert history[-1] < 1e-6 * (samples.weight * samples.value**2).sum()
    np.testing.assert_allclose(evaluate_samples(factors, samples), samples.value, atol=1e-2)


def test_updates_agree_with_dense_least_squares():
    """The normal equations of v, written out densely with numpy, have the solver's fixed point."""
    samples, truth = made_samples(2, 1)
    factors, _, _ = factorize(samples, truth, max_iterations=1)
    # the truth solves the problem, so the updates must leave it where it is
    np.testing.assert_allclose(evaluate_samples(factors, samples), samples.value, atol=1e-9)


def test_the_two_evaluations_of_a_sum_of_terms_agree():
    rng = np.random.default_rng(8)
    scale, a, b, c = (rng.normal(size=s) for s in ((3, 4), (3, 4, 6), (3, 4, 5), (3, 4, 7)))
    x, y, z = np.repeat(np.arange(6.0), 10), rng.uniform(0, 4, 60), rng.uniform(0, 6, 60)
    out = np.empty((60, 3))
    sum_terms(scale, a, b, c, x, y, z, out)
    tensor = np.einsum("ct,cth,ctp,cto->hpoc", scale, a, b, c)
    rows = np.empty((6, 10, 3))
    bilinear_rows(tensor, y.reshape(6, 10), z.reshape(6, 10), rows)
    np.testing.assert_allclose(out.reshape(rows.shape), rows, atol=1e-12)


# models


@pytest.mark.parametrize("name", NAMES)
def test_the_table_is_the_evaluation_at_cell_centres(name, plastic_fits):
    fitted = plastic_fits[1][name]
    table = fitted.table()[:, :, :180]  # the half of the full circle that the grid has
    theta_h, theta_d, phi_d = grid_axes()
    wi, wo = directions(theta_h[::6], theta_d[:, ::6], phi_d[..., ::11])
    above = above_horizon()[::6, ::6, ::11]
    # float32 positions of the grid against float64
    np.testing.assert_allclose(fitted.evaluate(wi, wo)[above], table[::6, ::6, ::11][above], rtol=2e-3, atol=1e-5)


@pytest.mark.parametrize("name", NAMES)
def test_a_fit_is_close_finite_and_never_negative(name, plastic_fits):
    measured, fits = plastic_fits
    table = fold(fits[name].table())[above_horizon()]
    assert np.isfinite(table).all()
    assert table.min() >= 0
    # published three-lobe fits of measured materials reach 0.06
    assert log_deviation(measured.table, fold(fits[name].table())) < {"lawrence": 0.02, "tucker": 0.004}[name]


@pytest.mark.parametrize("name", NAMES)
def test_histories_never_rise(name, plastic_fits):
    history = np.array(plastic_fits[1][name].report["details"]["history"])
    assert np.all(np.diff(history) <= 1e-9 * history[0])


def test_tucker_beats_lawrence(plastic_fits):
    measured, fits = plastic_fits
    deviation = {name: log_deviation(measured.table, fold(fits[name].table())) for name in NAMES}
    assert deviation["tucker"] < deviation["lawrence"]


@pytest.mark.parametrize("name", NAMES)
def test_the_same_seed_gives_the_same_file(name, plastic_fits, tmp_path):
    measured, _ = plastic_fits
    first, again = (fit(name, measured, **SMALL[name]) for _ in range(2))
    for number, fitted in enumerate((first, again)):
        fitted.save(tmp_path / f"{number}.npz")
    assert (tmp_path / "0.npz").read_bytes() == (tmp_path / "1.npz").read_bytes()
    loaded = load_fit(tmp_path / "0.npz")
    assert loaded.options == dict(first.options)
    np.testing.assert_array_equal(loaded.table(), again.table())


def test_a_fit_of_tucker_has_the_published_size(plastic_fits):
    # 77 KB in double precision: 3 channels x 20 terms x sum(n) x 8 bytes
    fitted = plastic_fits[1]["tucker"]
    assert fitted.bytes == MODELS["tucker"].bytes == 3 * 20 * 164 * 8
    assert sum(array.shape[1] for array in fitted.parameters.values()) == 80


def test_size_follows_the_options():
    measured = material(np.array([0.2, 0.1, 0.05]))
    tucker = fit("tucker", measured, terms=2, resolution="30x10x12")
    assert tucker.bytes == tucker.report["bytes"] == 3 * 2 * (30 + 10 + 12 + 1) * 8
    lawrence = fit("lawrence", measured, terms=2, inner_terms=2, resolution="40x8x10")
    assert lawrence.bytes == 4 * (10 * 3 * 2 + 40 * 4 + 8 * 4)
    assert log_deviation(measured.table, fold(lawrence.table())) < 0.01


@pytest.mark.parametrize(
    ("name", "key", "value"),
    [("tucker", "terms", 0), ("tucker", "terms", "many"), ("lawrence", "terms", 99), ("lawrence", "inner_terms", 0)],
)
def test_a_wrong_option_names_model_and_key(name, key, value):
    with pytest.raises(ValueError, match=f"model {name}: {key}"):
        fit(name, material(np.array([0.2, 0.1, 0.05])), **{key: value})


def test_classes_follow_height_and_width_of_the_highlight():
    assert highlight_class(np.nan_to_num(plastic()) * 0 + 0.1) == "diffuse"
    base = np.array([0.01, 0.01, 0.01]) - np.array([0.15, 0.05, 0.02])
    # a Beckmann lobe halves at tan(theta_h) = 0.83 alpha
    for alpha, kind in ((0.006, "highly specular"), (0.02, "specular"), (0.1, "glossy")):
        assert highlight_class((plastic(alpha) + base).astype(np.float32)) == kind


@pytest.mark.parametrize("name", NAMES)
def test_a_constant_material_comes_back(name):
    measured = material(np.array([0.3, 0.1, 0.02]))
    # lawrence: cos theta_i is not a sum of four products, so it stays approximate
    score = log_deviation(measured.table, fold(fit(name, measured, **SMALL[name]).table()))
    assert score < {"lawrence": 0.005, "tucker": 1e-6}[name]


def bad_materials():
    rng = np.random.default_rng(9)
    base = plastic(0.05)
    dark = base.copy()
    dark[..., 1] = 0
    bright = np.zeros((*GRID_SHAPE, 3))
    bright[0, 30, 90] = 1000
    outlier = base.copy()
    outlier[20, 40, 90] = 1e6
    yield "a dark channel", material(dark)
    yield "all dark", material(np.zeros(3))
    yield "a single bright cell", material(bright)
    yield "nine cells of ten missing", material(base, keep=rng.random(GRID_SHAPE) < 0.1)
    yield "half of theta_h missing", material(base, keep=np.arange(90)[:, None, None] + np.zeros(GRID_SHAPE) < 45)
    yield "an outlier of a million", material(outlier)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize(
    ("_case", "measured"), [*bad_materials()], ids=lambda value: value if isinstance(value, str) else ""
)
def test_bad_input_gives_a_finite_fit(name, _case, measured):
    fitted = fit(name, measured, **SMALL[name])
    table = fold(fitted.table())[above_horizon()]
    assert np.isfinite(table).all()
    assert table.min() >= 0
    dark = np.nanmax(measured.table, axis=(0, 1, 2)) == 0
    assert np.all(table[:, dark] == 0)
    # the fit of a damaged material is not worse than half of what a black surface would score
    black = np.where(np.isnan(measured.table), np.nan, 0).astype(np.float32)
    score = log_deviation(measured.table, fold(fitted.table()))
    assert score <= 0.5 * log_deviation(measured.table, black) or score < 1e-3


@pytest.mark.parametrize("name", NAMES)
def test_no_valid_cell_is_a_fit_error(name):
    with pytest.raises(FitError, match=f"{name} on made: no valid cell"):
        fit(name, material(np.ones(3), keep=np.zeros(GRID_SHAPE, bool)))


@pytest.mark.parametrize("name", NAMES)
def test_missing_cells_do_not_change_the_rest_much(name, plastic_fits):
    measured, fits = plastic_fits
    holes = material(plastic(), keep=np.random.default_rng(10).random(GRID_SHAPE) < 0.5)
    score = log_deviation(measured.table, fold(fit(name, holes).table()))
    assert score < 2 * log_deviation(measured.table, fold(fits[name].table())) + 1e-3


@pytest.mark.slow
def test_measured_like_materials_in_the_order_of_the_papers():
    """Two materials of ../shared made by its tool, if they are there. Seconds: `make bench`."""
    tool = Path(__file__).resolve().parents[2].parent / "shared" / "tools" / "make_measured.py"
    if not tool.is_file():
        pytest.skip("needs make_measured.py of ../shared")
    import subprocess
    import sys
    import tempfile

    from brdfatlas import read_merl

    with tempfile.TemporaryDirectory() as folder:
        subprocess.run([sys.executable, tool, folder, "chrome", "alum-bronze"], check=True, capture_output=True)
        for path in sorted(Path(folder).glob("*.binary")):
            measured = read_merl(path)
            scores = {}
            for name in NAMES:
                fitted = fit(name, measured)
                scores[name] = log_deviation(measured.table, fold(fitted.table()))
            assert scores["tucker"] < scores["lawrence"] < 0.03
