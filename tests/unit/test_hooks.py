"""What models say of themselves: samplers follow their pdf, functions are finite, factors give back the table."""

import numpy as np
import pytest
from test_sampling import chi_square, outgoing

from brdfatlas.angles import N_PHI_D, above_horizon, grid_cosines, phi_d_centres, theta_d_centres, theta_h_centres
from brdfatlas.constants import MAX_ANGLE
from brdfatlas.figures.curves import SHOWN
from brdfatlas.fits import Fit
from brdfatlas.models import MODELS
from brdfatlas.models.base import Factors, Model
from brdfatlas.models.published import THREE_LOBE, published_parameters

AXES = {"theta_h": np.pi / 2, "theta_d": np.pi / 2, "theta": np.pi / 2, "phi_d": np.pi}
#: Broad enough for the midpoint rule of the chi-square test, where the middle of the range is not.
BROAD = {"B": 50.0, "C": 1.7, "eta": 1.5, "alpha": 0.3, "m": 0.3, "A": 0.2, "p": 0.8, "F0": 0.4, "F1": 0.1}


def example(model: Model) -> dict[str, np.ndarray]:
    """Parameters within their ranges, different in each channel and smooth along their tables."""
    if model.name in THREE_LOBE:
        return published_parameters(model.name, "pink-felt")
    found = {}
    for number, p in enumerate(model.parameters):
        low, high = max(p.low, -1.0), min(p.high, 1.0)
        wave = np.cos(np.linspace(0, 1 + number, p.count)).reshape(p.shape)
        values = BROAD.get(p.name, low + (high - low) * (0.5 + 0.4 * wave))
        found[p.name] = np.broadcast_to(np.asarray(values, p.dtype), p.shape).copy()
    return found


def fit_of(name: str) -> Fit:
    return Fit(name, "made", example(MODELS[name]))


@pytest.mark.parametrize("name", list(MODELS))
@pytest.mark.parametrize("degrees", [10, 60])
def test_a_sampler_follows_its_pdf(name, degrees):
    sampler = fit_of(name).sampler()
    if sampler is None:
        pytest.skip("no sampling procedure")
    p_value, missing, rejected = chi_square(sampler, outgoing(degrees))
    # some forty tests with a fixed seed: their least honest p-value is below 1e-4 once in 250
    assert p_value > 1e-4
    assert missing == pytest.approx(rejected, abs=4 * np.sqrt(rejected / 100_000) + 2e-3)


@pytest.mark.parametrize("name", list(MODELS))
def test_functions_are_finite_over_rising_angles(name):
    for function in fit_of(name).functions():
        angle, values = np.asarray(function.angle), np.asarray(function.values)
        assert values.shape in ((angle.size,), (angle.size, 3)), function.symbol
        assert np.isfinite(values).all(), function.symbol
        assert np.all(np.diff(angle) > 0)
        assert angle[0] >= 0
        assert angle[-1] <= AXES[function.axis] + 1e-12
        if function.symbol in SHOWN:
            assert values.min() >= 0, f"{function.symbol}: pages call it {SHOWN[function.symbol][0]}"


def from_factors(factors: Factors) -> np.ndarray:
    """The sum of products at the cells of the MERL grid, by its formula."""
    m = np.einsum("ckh,ckd->hdc", factors.d, factors.f)[:, :, None]
    if factors.rho_s is not None:
        m = m * factors.rho_s
    table = np.broadcast_to(m, (90, 90, N_PHI_D, 3)).copy()
    if factors.h is not None:
        table *= factors.h.T
    if factors.g is not None:
        nodes = np.linspace(0, np.pi / 2, 90)
        for cosine in grid_cosines():
            theta = np.arccos(np.clip(cosine.astype(float), 0, 1))
            below = np.interp(theta, nodes, np.cos(nodes))
            g = np.stack([np.interp(theta, nodes, row) for row in factors.g], -1)
            table *= g / np.maximum(below, 1e-9)[..., None]
    return np.maximum(table + factors.rho_d, 0)


@pytest.mark.parametrize("name", list(MODELS))
def test_factors_give_back_the_table(name):
    fit = fit_of(name)
    factors = fit.factors()
    if factors is None:
        pytest.skip("no sum of products")
    cells = {"d": theta_h_centres().size, "f": theta_d_centres().size, "g": 90, "h": phi_d_centres().size}
    for key, size in cells.items():
        values = getattr(factors, key)
        assert values is None or values.shape[-1] == size
    seen = above_horizon() & (np.minimum(*grid_cosines()) > np.cos(MAX_ANGLE - 1e-3))
    # the grid's cosines are float32: at 89 degrees an error of 6e-8 in them moves a place among the nodes by 4e-4
    np.testing.assert_allclose(fit.table()[seen], from_factors(factors)[seen], rtol=2e-3, atol=1e-6)


def test_hooks_are_where_they_are_expected():
    """The microfacet models have functions and samplers, the factor models functions and factors."""
    analytic = ("tabulated", "gaussian", "ggx", "sgd", "abc", "ngan")
    assert all(fit_of(name).functions() and fit_of(name).sampler() for name in analytic)
    assert all(fit_of(name).sampler() for name in THREE_LOBE)
    factored = ("naive", "g_from_d", "independent_g", "bivariate_g", "low_rank_2", "low_rank_4")
    assert all(fit_of(name).functions() and fit_of(name).factors() for name in factored)
    assert fit_of("bivariate").factors() is not None
    assert fit_of("tucker").factors() is None
