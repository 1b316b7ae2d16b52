"""The plugin: the values of the table, a density that is what is sampled, in every variant."""

import threading

import numpy as np
import pytest
from rendering_materials import material, variant

from brdfatlas.fits import fit
from brdfatlas.formats.merl import write_merl
from brdfatlas.measured import MeasuredError, extend, look_up
from brdfatlas.rendering import register
from brdfatlas.rendering.density import LIST_LENGTH, sampling_density


def pairs(count, seed=0):
    """Directions above the surface, half of them near the mirror direction; float32 as the renderer sees them."""
    rng = np.random.default_rng(seed)
    wi = rng.normal(size=(count, 3))
    wo = rng.normal(size=(count, 3))
    wo[::2] = wi[::2] * [-1, -1, 1] + 0.03 * rng.normal(size=(len(wo[::2]), 3))
    for d in (wi, wo):
        d[:, 2] = np.abs(d[:, 2]) + 1e-3
        d /= np.linalg.norm(d, axis=1, keepdims=True)
    return wi.astype(np.float32), wo.astype(np.float32)


@pytest.fixture(scope="module")
def binary(tmp_path_factory):
    path = tmp_path_factory.mktemp("plugin") / "shiny.binary"
    write_merl(path, material(0.1).table)
    return path


def test_values_are_those_of_look_up(binary):
    """The plugin times nothing but the cosine equals the library's look-up. float32 angles are good to a few 1e-7, a
    theta_h cell near the normal is 1e-4 wide: 1e-3 of the local contrast."""
    mi = variant()
    import drjit as dr

    bsdf = mi.load_dict({"type": "brdfatlas", "filename": str(binary)})
    wi, wo = pairs(40_000)
    si = dr.zeros(mi.SurfaceInteraction3f, len(wi))
    si.wi = mi.Vector3f(wi.T)
    got = np.array(bsdf.eval(mi.BSDFContext(), si, mi.Vector3f(wo.T))).T
    m = material(0.1)
    expected = look_up(extend(m.table, m.valid), wi.astype(float), wo.astype(float)) * wo[:, 2:]
    np.testing.assert_allclose(got, expected, rtol=1e-3, atol=1e-6)
    both, pdf = bsdf.eval_pdf(mi.BSDFContext(), si, mi.Vector3f(wo.T))
    np.testing.assert_allclose(np.array(both).T, got, rtol=1e-6)
    np.testing.assert_allclose(np.array(pdf), np.array(bsdf.pdf(mi.BSDFContext(), si, mi.Vector3f(wo.T))), rtol=1e-5)


def test_a_random_neighbour_has_the_mean_of_the_interpolation():
    """Over 64 x 64 chances each probability is right to 1/128, so the mean is within 1/64 of the values' spread; and
    there is a spread: not every chance has the same value."""
    mi = variant()
    import drjit as dr

    from brdfatlas.rendering.bsdf import reflectance_of

    reflectance, side, (wi, wo) = reflectance_of(material(0.1)), 64, pairs(500)
    angles = reflectance.angles(mi.Vector3f(wi.T), mi.Vector3f(wo.T))
    exact = np.array(reflectance.values(angles, True)[0]).T

    def values(of_theta_d, of_phi_d):
        chances = (of_theta_d[:, None] << 16 | of_phi_d).ravel().astype(np.uint32)
        repeated = [dr.repeat(angle, len(chances)) for angle in angles]
        found = reflectance.values(repeated, True, dr.tile(mi.UInt32(chances), len(wi)))[0]
        return np.array(found).T.reshape(len(wi), len(chances), 3).astype(float)

    middles = (2 * np.arange(side) + 1) * (2**15 // side)
    corners = values(*2 * [np.array([0, 2**16 - 1])])
    spread = corners.max(1) - corners.min(1)
    assert np.median(spread / exact) > 1e-3
    assert (np.abs(values(middles, middles).mean(1) - exact) <= spread / side + 1e-5 * exact).all()


def test_scalar_and_llvm_agree(binary):
    wi, wo = pairs(40, seed=3)
    rng = np.random.default_rng(5)
    numbers = rng.random((40, 3)).astype(np.float32)
    mi = variant("scalar_rgb")
    bsdf = mi.load_dict({"type": "brdfatlas", "filename": str(binary)})
    scalar = []
    for a, b, n in zip(wi.tolist(), wo.tolist(), numbers.tolist()):
        si = mi.SurfaceInteraction3f()
        si.wi = mi.Vector3f(*a)
        value, pdf = bsdf.eval_pdf(mi.BSDFContext(), si, mi.Vector3f(*b))
        sample, weight = bsdf.sample(mi.BSDFContext(), si, n[0], mi.Point2f(n[1], n[2]))
        scalar.append([*value, pdf, *sample.wo, sample.pdf, *weight])
    mi = variant()
    import drjit as dr

    bsdf = mi.load_dict({"type": "brdfatlas", "filename": str(binary)})
    si = dr.zeros(mi.SurfaceInteraction3f, len(wi))
    si.wi = mi.Vector3f(wi.T)
    value, pdf = bsdf.eval_pdf(mi.BSDFContext(), si, mi.Vector3f(wo.T))
    sample, weight = bsdf.sample(mi.BSDFContext(), si, mi.Float(numbers[:, 0]), mi.Point2f(numbers[:, 1:].T))
    jit = [*np.array(value), np.array(pdf), *np.array(sample.wo), np.array(sample.pdf), *np.array(weight)]
    # Same formulas, other rounding: near a cell's edge one of the two may choose the neighbour.
    close = np.isclose(np.array(scalar), np.array(jit).T, rtol=2e-3, atol=1e-5).all(1)
    assert close.mean() >= 0.95


@pytest.mark.parametrize(
    ("alpha", "degrees"), [(0.05, 35), (0.05, 70), (0.2, 5), (0.2, 60), (0.5, 0), (0.5, 45), (0.5, 82)]
)
def test_chi_square(alpha, degrees):
    """Mitsuba's own test: samples are distributed as the density says. The horizon lies on a cell's edge (even
    resolution); the density has bends at every theta_h cell, so it is integrated on 32 x 32 points a cell."""
    mi = variant()
    import drjit as dr
    from mitsuba.chi2 import ChiSquareTest, SphericalDomain

    from brdfatlas.rendering.bsdf import bsdf_of, reflectance_of

    bsdf, context = bsdf_of(reflectance_of(material(alpha))), mi.BSDFContext()
    wi = mi.Vector3f(float(np.sin(np.radians(degrees))), 0, float(np.cos(np.radians(degrees))))

    def interaction(count):
        si = dr.zeros(mi.SurfaceInteraction3f, count)
        si.wi = wi
        return si

    def sample(numbers):
        drawn, _ = bsdf.sample(context, interaction(dr.width(numbers)), numbers[0], mi.Point2f(numbers[1], numbers[2]))
        return drawn.wo, dr.select(drawn.pdf > 0, 1.0, 0.0)

    test = ChiSquareTest(
        domain=SphericalDomain(),
        sample_func=sample,
        pdf_func=lambda wo: bsdf.pdf(context, interaction(dr.width(wo)), wo),
        sample_dim=3,
        sample_count=400_000,
        res=120,
        ires=32,
    )
    assert test.run(significance_level=0.01, test_count=7, quiet=True), f"p = {test.p_value}"


def test_sampling_weight_is_value_over_density(binary):
    mi = variant()
    import drjit as dr

    bsdf, context = mi.load_dict({"type": "brdfatlas", "filename": str(binary)}), mi.BSDFContext()
    wi, _ = pairs(20_000)
    numbers = np.random.default_rng(2).random((3, len(wi))).astype(np.float32)
    si = dr.zeros(mi.SurfaceInteraction3f, len(wi))
    si.wi = mi.Vector3f(wi.T)
    sample, weight = bsdf.sample(context, si, mi.Float(numbers[0]), mi.Point2f(numbers[1:]))
    value, pdf = bsdf.eval_pdf(context, si, sample.wo)
    good = np.array(sample.pdf) > 0
    ratio = np.array(value)[:, good] / np.array(pdf)[good]
    np.testing.assert_allclose(np.array(weight)[:, good], ratio, rtol=1e-4, atol=1e-6)
    assert np.array(sample.wo)[2, good].min() > 0
    assert not np.array(weight)[:, ~good].any()


def test_white_furnace():
    """A Lambertian table reflects exactly its albedo: the mean sampling weight."""
    from brdfatlas.angles import GRID_SHAPE, above_horizon
    from brdfatlas.measured import Measured

    mi = variant()
    import drjit as dr

    from brdfatlas.rendering.bsdf import bsdf_of, reflectance_of

    table = np.full((*GRID_SHAPE, 3), 0.8 / np.pi, np.float32)
    table[~above_horizon()] = np.nan
    bsdf = bsdf_of(reflectance_of(Measured("white", table)))
    n = 1 << 18
    rng = np.random.default_rng(0)
    si = dr.zeros(mi.SurfaceInteraction3f, n)
    si.wi = mi.Vector3f(float(np.sin(0.9)), 0, float(np.cos(0.9)))
    _, weight = bsdf.sample(
        mi.BSDFContext(), si, mi.Float(rng.random(n, np.float32)), mi.Point2f(rng.random((2, n), np.float32))
    )
    weight = np.array(weight)[0]
    assert weight.mean() == pytest.approx(0.8, abs=5 * weight.std() / np.sqrt(n))
    assert weight.max() <= 0.8 / 0.1 + 1e-3  # the cosine lobe's weight never falls below 0.1


def test_density_tables_are_consistent():
    m = material(0.05)
    density = sampling_density(extend(m.table, m.valid))
    for row in (0, 17, 31):
        first, index = np.unique(density.entries[row], return_index=True)
        counts = np.bincount(density.entries[row], minlength=90)[first]
        low, width, pdf, slope = density.cells[row].astype(float)[first].T
        np.testing.assert_allclose(pdf * 2 * np.pi * width, counts / LIST_LENGTH, rtol=1e-4)
        np.testing.assert_allclose(low[1:], (low + width)[:-1], atol=1e-6)
        assert (low[0], low[-1] + width[-1]) == (0, pytest.approx(1, abs=1e-6))
        assert (abs(slope) < 1).all()
        np.testing.assert_allclose(density.runs[row][first] * LIST_LENGTH, np.stack([index, counts], -1), atol=1e-3)
        # Every cell of the MERL grid holds the numbers of the joined cell that it belongs to.
        owner = np.searchsorted(first, np.arange(90), side="right") - 1
        np.testing.assert_array_equal(density.cells[row], density.cells[row][first][owner])


def test_a_fit_renders_with_the_mask_and_density_of_its_reference(binary, tmp_path):
    mi = variant()
    fitted = fit("ggx", material(0.1))
    fitted.save(tmp_path / "fit.npz")
    plain = mi.load_dict({"type": "brdfatlas", "filename": str(tmp_path / "fit.npz")})
    paired = mi.load_dict({"type": "brdfatlas", "filename": str(tmp_path / "fit.npz"), "reference": str(binary)})
    reference = mi.load_dict({"type": "brdfatlas", "filename": str(binary)})
    same = [np.array_equal(b.reflectance.density.cells, reference.reflectance.density.cells) for b in (paired, plain)]
    assert same == [True, False]
    expected = extend(fitted.table(), material(0.1).valid)
    got = np.array(paired.reflectance._table).reshape(-1, 4)[:, :3]
    np.testing.assert_array_equal(got, expected.reshape(-1, 3))


def test_faults_are_one_line_that_names_the_file(tmp_path):
    mi = variant()
    (tmp_path / "short.binary").write_bytes(b"abc")
    for entry, word in (({"filename": str(tmp_path / "short.binary")}, "short.binary"), ({}, "filename")):
        with pytest.raises(Exception, match=word):
            mi.load_dict({"type": "brdfatlas"} | entry)


@pytest.mark.parametrize("shape", [(3, 90, 180, 3), (90, 90, 180, 1), (90, 90, 180), (90, 90, 200, 3)])
def test_a_table_of_another_shape_is_refused(shape):
    from brdfatlas.rendering.bsdf import interleave

    with pytest.raises(MeasuredError, match=r"a table of shape .* is needed"):
        interleave([np.zeros(shape, np.float32)], material(0.1).valid)


def test_a_mask_on_the_full_circle_takes_tables_of_either_kind():
    from brdfatlas.rendering.bsdf import interleave

    m = material(0.1)
    twice = np.concatenate([m.valid, m.valid], 2)
    table = m.extended.astype(np.float32)
    packed, stride, n_phi = interleave([table, np.concatenate([table, table], 2)], twice)
    assert n_phi == twice.shape[2]
    alone, its_stride, its_n_phi = interleave([table], twice)
    assert its_n_phi == n_phi
    cells = packed.reshape(-1, stride)
    np.testing.assert_array_equal(cells[:, :3], cells[:, 3:6])
    np.testing.assert_array_equal(alone.reshape(-1, its_stride)[:, :3], cells[:, :3])


def test_a_fit_that_is_not_finite_is_refused():
    variant()
    from brdfatlas.rendering.bsdf import reflectance_of

    m = material(0.1)
    table = m.table.copy()
    table[3, 4, 100] = np.inf
    assert m.valid[3, 4, 100]
    with pytest.raises(MeasuredError, match="NaN or Inf"):
        reflectance_of(m, table)


@pytest.mark.parametrize("name", ["llvm_ad_spectral", "llvm_mono", "scalar_spectral", "llvm_ad_rgb_polarized"])
def test_variants_without_rgb_are_refused_in_one_line(name):
    import mitsuba as mi

    from brdfatlas.rendering import use_variant

    with pytest.raises(ValueError, match=f"render.variant: {name}: brdfatlas renders in rgb") as caught:
        use_variant(name)
    assert "\n" not in str(caught.value)
    if name in mi.variants():
        variant()
        mi.set_variant(name)
        try:
            with pytest.raises(ValueError, match="renders in rgb"):
                register()
        finally:
            variant()


def test_threads_may_use_the_plugin_in_turns(binary):
    """Each thread has its own variant and may register; a scene is loaded, rendered and dropped while no other thread
    renders: Mitsuba's own shapes are called while another thread frees them, too."""
    mi = variant()
    turn, found, faults = threading.Lock(), [], []

    def work():
        try:
            mi.set_variant("llvm_ad_rgb")
            register()
            for _ in range(3):
                bsdf = {"type": "brdfatlas", "filename": str(binary)}
                with turn:
                    loaded = mi.load_dict(plain | {"ball": {"type": "sphere", "bsdf": bsdf}})
                    found.append(np.array(mi.render(loaded, spp=4, seed=1)))
                    del loaded
        except Exception as fault:
            faults.append(fault)

    film = {"type": "hdrfilm", "width": 8, "height": 8}
    plain = {
        "type": "scene",
        "integrator": {"type": "direct"},
        "light": {"type": "constant"},
        "sensor": {"type": "perspective", "film": film},
    }
    threads = [threading.Thread(target=work) for _ in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert faults == []
    assert len(found) == 9
    for picture in found:
        np.testing.assert_array_equal(picture, found[0])


def test_a_direction_that_is_not_a_number_reads_nothing_outside_the_table(binary):
    mi = variant()
    import drjit as dr

    bsdf = mi.load_dict({"type": "brdfatlas", "filename": str(binary)})
    si = dr.zeros(mi.SurfaceInteraction3f, 3)
    si.wi = mi.Vector3f([0, float("nan"), 0.6], [0, 0, 0], [1, float("nan"), 0.8])
    value = np.array(bsdf.eval(mi.BSDFContext(), si, mi.Vector3f([float("nan"), 0, 0.6], [0, 0, 0], [1, 1, 0.8])))
    assert np.isfinite(value[:, 2]).all()
