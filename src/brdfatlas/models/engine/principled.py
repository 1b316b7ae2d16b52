"""The reflection part of Mitsuba 3's ``principled`` plugin, after Burley's Disney BRDF of 2012 and 2015."""

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from brdfatlas.angles import theta_d_centres
from brdfatlas.compiled import njit
from brdfatlas.constants import LUMINANCE
from brdfatlas.models.base import Paper, Parameter
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
from brdfatlas.sampling import Diffuse, GgxLobe, Gtr1Lobe, Mixture

RED, GREEN, BLUE = (float(v) for v in LUMINANCE)
#: The plugin bounds alpha from below.
MIN_ALPHA = 1e-3
#: Roughness of the clearcoat: from 0.1 at gloss 0 to 0.001 at gloss 1; its shadowing is that of alpha 0.25.
CLEARCOAT_ALPHA, CLEARCOAT_SHADOWING = (0.1, 0.001), 0.25


@njit(cache=True, nogil=True, error_model="numpy")
def diffuse(cos_i, cos_o, cos_d, roughness, flatness):
    """Diffuse and retro-reflection, blended with the flat approximation of subsurface scattering; times pi / base."""
    at_i, at_o = fifth(cos_i), fifth(cos_o)
    retro = 2 * roughness * cos_d * cos_d
    plain = (1 - 0.5 * at_i) * (1 - 0.5 * at_o) + retro * (at_o + at_i + at_o * at_i * (retro - 1))
    half = 0.5 * retro - 1
    under = (1 + at_o * half) * (1 + at_i * half)
    flat = 1.25 * (under * (1 / (cos_i + cos_o) - 0.5) + 0.5)
    return plain + flatness * (flat - plain)


@njit(cache=True, nogil=True, error_model="numpy")
def principled(p, samples, out):
    """p = base colour rgb, metallic, specular, roughness, spec_tint, sheen, sheen_tint, flatness, clearcoat, gloss."""
    metallic, roughness, spec_tint, sheen, flatness = p[3], p[5], p[6], p[7], p[9]
    alpha = roughness * roughness
    if alpha.real < MIN_ALPHA:
        alpha = MIN_ALPHA + 0 * alpha
    eta = 2 / (1 - np.sqrt(0.08 * p[4])) - 1
    at_normal = ((eta - 1) / (eta + 1)) ** 2
    luminance = RED * p[0] + GREEN * p[1] + BLUE * p[2]
    # Burley's GTR of exponent 1 (Burley 2012, appendix B.2, Eq. 4): clear_scale / (clear + (1 - clear) sin^2 theta_h)
    clear = (CLEARCOAT_ALPHA[0] + (CLEARCOAT_ALPHA[1] - CLEARCOAT_ALPHA[0]) * p[11]) ** 2
    clear_scale = p[10] * (clear - 1) / (np.pi * np.log(clear))
    # of each channel: base colour, F0 of tinted reflection, sheen
    colours = np.empty((3, 3), p.dtype)
    for c in range(3):
        tint = p[c] / luminance if luminance.real > 0 else 1 + 0 * luminance
        colours[0, c], colours[1, c] = p[c], tint * at_normal
        colours[2, c] = sheen * (1 - metallic) * (1 + p[8] * (tint - 1))
    matte, plain = (1 - metallic) / np.pi, (1 - metallic) * (1 - spec_tint)
    tinted = (1 - metallic) * spec_tint
    schlick = metallic + tinted
    upward = metallic * colours[0] + tinted * colours[1]
    for n in range(samples.shape[0]):
        cos_i, cos_o, sin2_h, cos_d = samples[n]
        grazing = fifth(cos_d)
        dielectric = fresnel(cos_d, eta)
        lobe = ggx(sin2_h, alpha) * visible_separable(cos_i, cos_o, alpha)
        if dielectric.real <= 0:  # the plugin's lobe is off then, metallic or not
            lobe = 0 * lobe
        shadowed = cos_i * cos_o * visible_separable(cos_i, cos_o, CLEARCOAT_SHADOWING)  # G1 G1 / 4
        coat = clear_scale * inverse(clear + (1 - clear) * sin2_h) * ((0.04 + 0.96 * grazing) * shadowed)
        base = matte * diffuse(cos_i, cos_o, cos_d, roughness, flatness)
        common = lobe * (schlick * grazing + plain * dielectric) + coat
        rising = lobe * (1 - grazing)
        for c in range(3):
            out[n, c] = base * colours[0, c] + grazing * colours[2, c] + rising * upward[c] + common


class Principled(EngineModel):
    """Twelve numbers, without anisotropy and transmission. A test compares it with the plugin."""

    name = "principled"
    title = "Disney principled (Mitsuba)"
    paper = Paper(
        "Brent Burley",
        "Physically Based Shading at Disney",
        "ACM SIGGRAPH Courses: Practical Physically Based Shading in Film and Game Production",
        2012,
    )
    equations = "section 5 and appendix B; Burley 2015 (flatness); as in Mitsuba 3's plugin principled"
    formula = (
        "rho = (1 - metallic) (base f_diffuse/pi + sheen) + F D G / (4 cos theta_i cos theta_o) "
        "+ clearcoat/4 F_c D_c G_c; D of GGX, alpha = max(0.001, roughness^2); D_c of GTR1; G separable Smith; "
        "F = metallic Schlick(base) + (1 - metallic) mix(Fresnel(eta), Schlick(tinted), spec_tint)"
    )
    parameters = (
        Parameter("base_color", (3,), "base colour, linear Rec. 709 rgb", "", 0.0, 1.0),
        Parameter("metallic", (1,), "0 dielectric, 1 metal", "", 0.0, 1.0),
        Parameter("specular", (1,), "strength of dielectric reflection; 0.5 is an index of 1.5", "", 1e-3, 1.0),
        Parameter("roughness", (1,), "perceptual roughness; alpha is its square", "", 0.03, 1.0),
        Parameter("spec_tint", (1,), "tint of dielectric reflection towards the base colour", "", 0.0, 1.0),
        Parameter("sheen", (1,), "grazing reflection of cloth", "", 0.0, 1.0),
        Parameter("sheen_tint", (1,), "tint of the sheen towards the base colour", "", 0.0, 1.0),
        Parameter("flatness", (1,), "blend from diffuse to an approximation of subsurface scattering", "", 0.0, 1.0),
        Parameter("clearcoat", (1,), "strength of a second, sharp lobe", "", 0.0, 1.0),
        Parameter("clearcoat_gloss", (1,), "gloss of that lobe: its alpha runs from 0.1 to 0.001", "", 0.0, 1.0),
    )
    kernel = principled
    logarithmic = ("roughness", "specular")
    coupled = ("base_color",)
    start_ranges: ClassVar[Mapping[str, tuple[float, float]]] = {
        "base_color": (0.02, 1.0),
        "specular": (0.02, 1.0),
        "roughness": (0.05, 0.95),
        "sheen": (0.0, 0.3),
        "clearcoat": (0.0, 0.5),
    }
    follow = (5, 2)
    targets = ("mitsuba",)

    def sampler(self, parameters):
        p = {name: np.asarray(value, float) for name, value in parameters.items()}
        metallic, base = p["metallic"][0], p["base_color"]
        f0 = metallic * base + (1 - metallic) * 0.08 * p["specular"][0]
        matte = (1 - metallic) * (base.sum() + 3 * p["sheen"][0] * np.pi / 21)
        coat = 3 * 0.25 * p["clearcoat"][0] * (0.04 + 0.96 / 21)
        weights = np.array([matte, np.sum(f0 + (1 - f0) / 21), coat])
        gloss = CLEARCOAT_ALPHA[0] + (CLEARCOAT_ALPHA[1] - CLEARCOAT_ALPHA[0]) * p["clearcoat_gloss"][0]
        lobes = [Diffuse(), GgxLobe(max(MIN_ALPHA, float(p["roughness"][0]) ** 2)), Gtr1Lobe(float(gloss))]
        return Mixture(lobes, weights / weights.sum())

    def functions(self, parameters):
        p = {name: np.asarray(value, float) for name, value in parameters.items()}
        cosine, metallic, tinting = np.cos(theta_d_centres())[:, None], p["metallic"][0], p["spec_tint"][0]
        eta = 2 / (1 - np.sqrt(0.08 * p["specular"][0])) - 1
        grazing = (1 - cosine) ** 5
        luminance = p["base_color"] @ LUMINANCE
        tint = p["base_color"] / luminance if luminance > 0 else np.ones(3)
        f0 = tint * ((eta - 1) / (eta + 1)) ** 2
        metal = p["base_color"] + (1 - p["base_color"]) * grazing
        dielectric = tinting * (f0 + (1 - f0) * grazing) + (1 - tinting) * fresnel(cosine, eta)
        f = metallic * metal + (1 - metallic) * dielectric
        return microfacet_functions({"": max(MIN_ALPHA, float(p["roughness"][0]) ** 2)}, f)

    def material(self, parameters, target):
        if target != "mitsuba":
            return None
        plugin = {"type": "principled"}
        for p in self.parameters:
            values = shortest(parameters[p.name])
            plugin[p.name] = {"type": "rgb", "value": values} if p.count == 3 else values[0]
        return plugin
