"""OpenPBR 1.1, opaque base and coat, as the public reference implementation computes it.

What the reference implementation does beyond the text of the specification is followed: separable Smith shadowing, the
approximate directional albedo of EON, multiple scattering between facets for metals only, a coat that roughens and
darkens what lies beneath. Its coat's albedo scaling looks at the outgoing direction alone: without a coat the model is
reciprocal, with one it is not.

What differs here: the directional albedos are tabulated on its nodes (32 cosines, 32 roughnesses, 16 indices of
refraction up to 2.5) and rounded to 16 bits like its own, but integrated anew; and the factor of the metal's multiple
scattering is clamped by the larger cosine, so that swapping the directions changes nothing. Left out: transmission,
subsurface scattering, fuzz, thin film, anisotropy.
"""

from collections.abc import Mapping
from functools import cache
from typing import Any, ClassVar

import numpy as np

from brdfatlas.angles import theta_d_centres
from brdfatlas.compiled import njit
from brdfatlas.models.base import Option, Paper, Parameter
from brdfatlas.models.engine.base import (
    EngineModel,
    fifth,
    fresnel,
    ggx,
    inverse,
    microfacet_functions,
    shortest,
    visible_separable,
)
from brdfatlas.sampling import Diffuse, GgxLobe, Mixture

#: Nodes of the tables: cosine and roughness from 0 to 1, index of refraction from 1 to MAX_IOR.
NODES, IOR_NODES, MAX_IOR = 32, 16, 2.5
MIN_ALPHA = 1e-6
#: Below this alpha the light that is scattered between facets cannot be seen.
MIN_SCATTERING_ALPHA = 0.04**2
#: Where F82 metals are tinted, and Schlick's weight there (Kutz et al. 2021).
F82_COSINE = 1 / 7
F82_SCALE = 1 / (F82_COSINE * (1 - F82_COSINE) ** 6)


# Directional albedo ----------------------------------------------------------------------------------------------


@njit(cache=True, nogil=True, error_model="numpy")
def _missing(alpha, mu, eta, radial, angular, missing):
    """Fill missing (eta,) with the share of light at cosine mu that one bounce on GGX facets does not reflect; an eta
    of 0 stands for a white metal. A stratified sum over visible normals (Heitz 2018)."""
    missing[:] = 1.0
    sine = np.sqrt(1 - mu * mu)
    stretched = np.sqrt(alpha * alpha * (1 - mu * mu) + mu * mu)
    x, z = alpha * sine / stretched, mu / stretched
    for b in range(angular // 2):  # the other half is its mirror image in the plane of incidence
        angle = np.pi * (2 * b + 1) / angular - 0.5 * np.pi
        across, along = np.cos(angle), np.sin(angle)
        for a in range(radial):
            radius = np.sqrt((a + 0.5) / radial)
            t1 = radius * across
            share = 0.5 * (1 + z)
            t2 = (1 - share) * np.sqrt(1 - t1 * t1) + share * radius * along
            up = np.sqrt(max(1 - t1 * t1 - t2 * t2, 0.0))
            # tangents of the stretched view (x, 0, z): (0, 1, 0) and (-z, 0, x)
            hx, hy, hz = alpha * (up * x - t2 * z), alpha * t1, max(up * z + t2 * x, 0.0)
            length = np.sqrt(hx * hx + hy * hy + hz * hz)
            cos_d = min(max((hx * sine + hz * mu) / length, 0.0), 1.0)
            out = 2 * cos_d * hz / length - mu
            if out > 0:
                passed = (
                    2 * out / (out + np.sqrt(alpha * alpha * (1 - out * out) + out * out)) / (radial * (angular // 2))
                )
                for e in range(eta.size):
                    missing[e] -= passed if eta[e] == 0 else passed * fresnel(cos_d, eta[e])


@njit(cache=True, nogil=True, error_model="numpy")
def _albedos(roughness, cosine, eta, radial, angular):
    """:func:`_missing` at all (eta, roughness, cosine)."""
    table, missing = np.empty((eta.size, roughness.size, cosine.size)), np.empty(eta.size)
    for r in range(roughness.size):
        for k in range(cosine.size):
            _missing(max(roughness[r] ** 2, MIN_ALPHA), max(cosine[k], 1e-4), eta, radial, angular, missing)
            table[:, r, k] = missing
    return table


@cache
def albedo_tables() -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Light that one bounce does not reflect: of a white metal (roughness, cosine) and its cosine-weighted mean
    (roughness); of a dielectric (index, roughness, cosine) and its mean (index, roughness).

    Rounded to 16 bits, and no finer in the metal's strata, as the reference implementation's: what a smooth metal
    scatters far from its highlight hangs on that, about 1e-5 of its albedo."""
    nodes, eta = np.linspace(0, 1, NODES), np.linspace(1, MAX_IOR, IOR_NODES)
    point, weight = np.polynomial.legendre.leggauss(24)
    between = 0.5 * (point + 1)
    weight = weight * between  # 2 mu dmu over [0, 1]
    cosines = np.concatenate([nodes, between])
    metal = np.maximum(_albedos(nodes, cosines, np.zeros(1), 128, 128)[0], 0)
    dielectric = _albedos(nodes, cosines, eta, 32, 32)
    means = (np.ascontiguousarray(table[..., NODES:]) @ weight for table in (metal, dielectric))
    tables = (np.ascontiguousarray(table[..., :NODES]) for table in (metal, dielectric))
    (metal, dielectric), (metal_mean, dielectric_mean) = tables, means
    rounded = (np.round(table * 65535) / 65535 for table in (metal, metal_mean, dielectric, dielectric_mean))
    return tuple(rounded)  # type: ignore[return-value]


@njit(cache=True, nogil=True, error_model="numpy")
def _cell(position, count):
    """The node below a position among ``count`` nodes, and the way from it to the next, which may be complex."""
    index = min(max(int(np.floor(position.real)), 0), count - 2)
    way = position - index
    if way.real > 1:
        way = 1 + 0 * way
    if way.real < 0:
        way = 0 * way
    return index, way


@njit(cache=True, nogil=True, error_model="numpy")
def _row(table, eta, roughness):
    """A dielectric's table at an index and a roughness: over the cosine, complex where they are."""
    i, u = _cell((eta - 1) / (MAX_IOR - 1) * (IOR_NODES - 1), IOR_NODES)
    j, v = _cell(roughness * (NODES - 1), NODES)
    row = (1 - u) * ((1 - v) * table[i, j] + v * table[i, j + 1])
    row = row + u * ((1 - v) * table[i + 1, j] + v * table[i + 1, j + 1])
    if eta.real > MAX_IOR:  # beyond the table: in proportion to what is left of F0
        most = ((MAX_IOR - 1) / (MAX_IOR + 1)) ** 2
        row = row * (1 - (((eta - 1) / (eta + 1)) ** 2 - most) / (1 - most))
    return row


@njit(cache=True, nogil=True, error_model="numpy")
def _at(row, cosine):
    k = min(int(cosine * (NODES - 1)), NODES - 2)
    way = cosine * (NODES - 1) - k
    return (1 - way) * row[k] + way * row[k + 1]


# Lobes -----------------------------------------------------------------------------------------------------------


@njit(cache=True, nogil=True, error_model="numpy")
def eon_albedo(cosine, roughness):
    """Directional albedo of the white Fujii–Oren–Nayar lobe, their fit (Portsmouth et al. 2025, listing 1)."""
    m = 1 - cosine
    g = m * (0.0571085289 + m * (0.491881867 + m * (-0.332181442 + m * 0.0714429953)))
    return (1 + roughness * g) * inverse(1 + (0.5 - 2 / (3 * np.pi)) * roughness)


@njit(cache=True, nogil=True, error_model="numpy")
def average_fresnel(eta):
    """Cosine-weighted mean of the Fresnel reflectance, eta >= 1 (Kulla and Conty 2017, slide 18)."""
    return (eta - 1) / (4.08567 + 1.00071 * eta)


@njit(cache=True, nogil=True, error_model="numpy")
def f82_slope(base, tint):
    """b of F = base + (1 - base - b cos (1 - cos)) (1 - cos)^5, white tint: 0."""
    return (base + (1 - base) * (1 - F82_COSINE) ** 5) * (1 - tint) * F82_SCALE


@njit(cache=True, nogil=True, error_model="numpy")
def _clamped(value):
    if value.real < 0:
        return 0 * value
    if value.real > 1:
        return 1 + 0 * value
    return value


@njit(cache=True, nogil=True, error_model="numpy")
def _ior(eta, weight):
    """specular_weight scales F0 (specification, Eq. 22): the index that has it."""
    scaled = weight * ((eta - 1) / (eta + 1)) ** 2
    if scaled.real > 0.9999:
        scaled = 0.9999 + 0 * scaled
    if scaled.real < 1e-12:
        return 1 + 0 * scaled
    r = np.sqrt(scaled)
    return (1 + r) / (1 - r)


@njit(cache=True, nogil=True, error_model="numpy")
def _colours(p, eta, roughness):
    """(7, 3) what is the same for all directions: base, slope of F82, multiple scattering of the metal, darkening under
    the coat, albedo, multiple scattering of the diffuse part, dielectric tint; and the scale of Fujii-Oren-Nayar."""
    rough, metalness, weight, coat, coat_ior = p[4], p[5], p[6], p[12], p[14]
    # light that returns from the underside of the coat (specification, Eqs. 65-71)
    outside = average_fresnel(coat_ior)
    inside = 1 - (1 - outside) / (coat_ior * coat_ior)
    reflected = average_fresnel(eta)
    smooth = (1 - metalness) * reflected + metalness
    returned = outside + (inside - outside) * (1 + smooth * (roughness - 1))
    eon_scale = 1 / (1 + (0.5 - 2 / (3 * np.pi)) * rough)
    eon_mean = eon_scale * (1 + (2 / 3 - 28 / (15 * np.pi)) * rough)
    colours = np.empty((7, 3), p.dtype)
    for c in range(3):
        base, tint = p[0] * p[1 + c], p[7 + c]
        slope = f82_slope(base, tint)
        average = _clamped(base + (1 - base) / 21 - slope / 126)
        beneath = metalness * weight * average + (1 - metalness) * (base + reflected * (1 - base))
        dark = 1 + coat * ((1 - returned) / (1 - beneath * returned) - 1)
        albedo = base * (1 - metalness)
        colours[0, c], colours[1, c], colours[2, c] = base, slope, average * average * metalness * weight
        colours[3, c] = dark
        colours[4, c] = albedo
        colours[5, c] = albedo * albedo * eon_mean / (1 - albedo * (1 - eon_mean)) / (1 - eon_mean + 1e-7)
        colours[6, c] = tint * (1 - metalness)
    return colours, eon_scale


@njit(cache=True, nogil=True, error_model="numpy")
def openpbr(p, samples, out, metal_table, metal_mean, table, table_mean):
    """p = base_weight, base_color rgb, base_diffuse_roughness, base_metalness, specular_weight, specular_color rgb,
    specular_roughness, specular_ior, coat_weight, coat_roughness, coat_ior."""
    rough, metalness, weight = p[4], p[5], p[6]
    coat, coat_roughness, coat_ior = p[12], p[13], p[14]
    index = _ior(p[11], weight)
    under = 1 + coat * (coat_ior - 1)
    eta = under / index if under.real > index.real else index / under
    # a rough coat spreads what passes it
    spread = p[10] ** 4 + (1 - 1 / coat_ior) * coat_roughness**4
    spread = 1 + 0 * spread if spread.real > 1 else spread
    roughness = p[10] + coat * (spread**0.25 - p[10])
    alpha = roughness * roughness
    alpha = MIN_ALPHA + 0 * alpha if alpha.real < MIN_ALPHA else alpha
    coat_alpha = coat_roughness * coat_roughness
    coat_alpha = MIN_ALPHA + 0 * coat_alpha if coat_alpha.real < MIN_ALPHA else coat_alpha
    row, coat_row = _row(table, eta, roughness), _row(table, coat_ior, coat_roughness)
    j, v = _cell(roughness * (NODES - 1), NODES)
    metal_row = (1 - v) * metal_table[j] + v * metal_table[j + 1]
    scattered = (1 - v) * metal_mean[j] + v * metal_mean[j + 1]
    i, u = _cell((eta - 1) / (MAX_IOR - 1) * (IOR_NODES - 1), IOR_NODES)
    mean = (1 - u) * ((1 - v) * table_mean[i, j] + v * table_mean[i, j + 1])
    mean = mean + u * ((1 - v) * table_mean[i + 1, j] + v * table_mean[i + 1, j + 1])
    if eta.real > MAX_IOR:
        most = ((MAX_IOR - 1) / (MAX_IOR + 1)) ** 2
        mean = mean * (1 - (((eta - 1) / (eta + 1)) ** 2 - most) / (1 - most))
    colours, eon_scale = _colours(p, eta, roughness)
    per_mean, per_scattered = 1 / (np.pi * mean), 1 / (np.pi * scattered)
    for n in range(samples.shape[0]):
        cos_i, cos_o, sin2_h, cos_d = samples[n]
        lobe = ggx(sin2_h, alpha) * visible_separable(cos_i, cos_o, alpha)
        dielectric = fresnel(cos_d, eta)
        grazing = fifth(cos_d)
        # Fujii–Oren–Nayar with its multiple scattering, under what the facets let through
        s = 2 * cos_d * cos_d - 1 - cos_i * cos_o
        s = s / max(cos_i, cos_o) if s > 0 else s
        single = eon_scale * (1 + rough * s)
        multiple = (1 - eon_albedo(cos_i, rough)) * (1 - eon_albedo(cos_o, rough))
        through = _at(row, cos_i) * _at(row, cos_o) * per_mean
        between = 0 * alpha
        if alpha.real >= MIN_SCATTERING_ALPHA:
            between = _at(metal_row, cos_i) * _at(metal_row, cos_o) * per_scattered
            most = 1 / (np.pi * max(cos_i, cos_o))
            between = most + 0 * between if between.real > most else between
        kept, gloss = 1 + 0 * coat, 0 * coat
        if coat.real > 0 or coat.imag > 0:
            kept = 1 - coat * (1 - _at(coat_row, cos_o))
            gloss = coat * ggx(sin2_h, coat_alpha) * visible_separable(cos_i, cos_o, coat_alpha)
            gloss = gloss * fresnel(cos_d, coat_ior)
        for c in range(3):
            base = colours[0, c]
            metal = _clamped(base + (1 - base - colours[1, c] * cos_d * (1 - cos_d)) * grazing)
            value = lobe * (colours[6, c] * dielectric + metalness * weight * metal)
            value += colours[2, c] * between
            value += (colours[4, c] * single + colours[5, c] * multiple) * through
            out[n, c] = gloss + kept * colours[3, c] * value


def kernel(p: np.ndarray, samples: np.ndarray, out: np.ndarray) -> None:
    """:func:`openpbr` with its tables."""
    openpbr(p, samples, out, *albedo_tables())


class OpenPBR(EngineModel):
    """Twelve free numbers, fifteen with a coat."""

    name = "openpbr"
    title = "OpenPBR 1.1"
    paper = Paper(
        "Zap Andersson, Paul Edmondson, Julien Guertault, Adrien Herubel, Alan King, Peter Kutz, Andréa Machizaud, "
        "Jamie Portsmouth, Frédéric Servant, Jonathan Stone",
        "OpenPBR Surface Specification",
        "Academy Software Foundation",
        2024,
    )
    equations = "version 1.1, base substrate and coat; EON: Portsmouth, Kutz, Hill 2025; F82-tint: Kutz et al. 2021"
    formula = (
        "rho = coat + T_c(theta_o) dark [(1 - m) (specular_color F_eta D G / (4 cos cos) + EON T T / <T>) "
        "+ m (F_82 D G / (4 cos cos) + multiple scattering)]; T = 1 - directional albedo (tabulated), D, G of GGX, "
        "alpha = roughness^2"
    )
    parameters = (
        Parameter("base_weight", (1,), "scale of the base colour; a fit holds it at 1", "", 0.0, 1.0),
        Parameter("base_color", (3,), "base colour, linear Rec. 709 rgb", "", 0.0, 1.0),
        Parameter("base_diffuse_roughness", (1,), "roughness of the diffuse lobe (EON)", "", 0.0, 1.0),
        Parameter("base_metalness", (1,), "0 dielectric, 1 metal", "", 0.0, 1.0),
        Parameter(
            "specular_weight", (1,), "scale of the reflectance at normal incidence; a fit holds it at 1", "", 0.0, 1.0
        ),
        Parameter("specular_color", (3,), "tint of dielectric reflection, of metals at 82 degrees, rgb", "", 0.0, 1.0),
        Parameter("specular_roughness", (1,), "perceptual roughness; alpha is its square", "", 0.03, 1.0),
        Parameter("specular_ior", (1,), "index of refraction", "", 1.0, 3.0),
        Parameter("coat_weight", (1,), "share of the surface that is coated", "", 0.0, 1.0),
        Parameter("coat_roughness", (1,), "perceptual roughness of the coat", "", 0.0, 1.0),
        Parameter("coat_ior", (1,), "index of refraction of the coat", "", 1.0, 3.0),
    )
    options: ClassVar[Mapping[str, Option]] = {
        **EngineModel.options,
        "coat": Option(False, "whether a coat is fitted as well"),
    }
    kernel = kernel
    logarithmic = ("specular_roughness",)
    start_ranges: ClassVar[Mapping[str, tuple[float, float]]] = {
        "base_color": (0.02, 1.0),
        "specular_color": (0.2, 1.0),
        "specular_roughness": (0.05, 0.95),
        "specular_ior": (1.2, 2.0),
        "coat_weight": (0.0, 1.0),
        "coat_roughness": (0.05, 0.5),
        "coat_ior": (1.3, 1.8),
    }
    follow = (6, 2)
    targets = ("materialx",)

    def fixed(self, options: Mapping[str, Any]) -> Mapping[str, float]:
        """base_weight scales base_color, and specular_weight says what specular_ior says: held. No coat by default."""
        held = {"base_weight": 1.0, "specular_weight": 1.0}
        return held if options["coat"] else held | {"coat_weight": 0.0, "coat_roughness": 0.0, "coat_ior": 1.6}

    def folded(self, p, samples, out):
        """With a coat the mean of both orders of directions, as the grid can hold it."""
        self.values(p, samples, out)
        if p[12] != 0:
            other = np.empty_like(out)
            self.values(p, np.ascontiguousarray(samples[:, [1, 0, 2, 3]]), other)
            out += other
            out *= 0.5

    def warnings(self, parameters, options):
        said = super().warnings(parameters, options)
        coated = options["coat"] and parameters["coat_weight"][0] > 0
        return [*said, "with a coat this model is not reciprocal"] if coated else said

    def _specular(self, p: Mapping[str, np.ndarray], cosine: np.ndarray) -> np.ndarray:
        """F of the base without coat, (n, 3)."""
        metalness, weight = p["base_metalness"][0], p["specular_weight"][0]
        base = p["base_weight"][0] * p["base_color"]
        slope = f82_slope(base, p["specular_color"])
        cosine = cosine[:, None]
        metal = np.clip(base + (1 - base - slope * cosine * (1 - cosine)) * (1 - cosine) ** 5, 0, 1)
        f0 = weight * ((p["specular_ior"][0] - 1) / (p["specular_ior"][0] + 1)) ** 2
        eta = (1 + np.sqrt(f0)) / (1 - np.sqrt(f0))
        return (1 - metalness) * p["specular_color"] * fresnel(cosine, eta) + metalness * weight * metal

    def sampler(self, parameters):
        p = {name: np.asarray(value, float) for name, value in parameters.items()}
        coat = p["coat_weight"][0]
        diffuse = (1 - p["base_metalness"][0]) * p["base_weight"][0] * p["base_color"].sum()
        specular = self._specular(p, np.linspace(0.05, 1, 20)).mean(0).sum()
        weights = np.array([diffuse, specular, coat * 3 * float(average_fresnel(p["coat_ior"][0]))]) + 1e-6
        alphas = [max(float(p[name][0]) ** 2, 1e-4) for name in ("specular_roughness", "coat_roughness")]
        return Mixture([Diffuse(), *(GgxLobe(alpha) for alpha in alphas)], weights / weights.sum())

    def functions(self, parameters):
        p = {name: np.asarray(value, float) for name, value in parameters.items()}
        f = self._specular(p, np.cos(theta_d_centres()))
        return microfacet_functions({"": max(MIN_ALPHA, p["specular_roughness"][0] ** 2)}, f)

    def material(self, parameters, target):
        if target != "materialx":
            return None
        inputs: dict[str, Any] = {}
        for p in self.parameters:
            values = shortest(parameters[p.name])
            inputs[p.name] = values if p.count == 3 else values[0]
        return {"node": "open_pbr_surface", "inputs": inputs}
