"""The metallic-roughness material of glTF 2.0 (specification, appendix B)."""

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from brdfatlas.angles import theta_d_centres
from brdfatlas.compiled import njit
from brdfatlas.microfacet import schlick
from brdfatlas.models.base import Paper, Parameter
from brdfatlas.models.engine.base import EngineModel, fifth, ggx, microfacet_functions, shortest, visible_correlated
from brdfatlas.sampling import Diffuse, GgxLobe, Mixture

#: Reflectance of every dielectric at normal incidence: an index of 1.5.
DIELECTRIC_F0 = 0.04


@njit(cache=True, nogil=True, error_model="numpy")
def gltf(p, samples, out):
    """p = base colour rgb, metallic, roughness."""
    matte, metallic, alpha = p[:3] / np.pi, p[3], p[4] * p[4]
    for n in range(samples.shape[0]):
        cos_i, cos_o, sin2_h, cos_d = samples[n]
        lobe = ggx(sin2_h, alpha) * visible_correlated(cos_i, cos_o, alpha)
        grazing = fifth(cos_d)
        dielectric = DIELECTRIC_F0 + (1 - DIELECTRIC_F0) * grazing
        for c in range(3):
            base = p[c]
            metal = lobe * (base + (1 - base) * grazing)
            plastic = (1 - dielectric) * matte[c] + dielectric * lobe
            out[n, c] = plastic + metallic * (metal - plastic)


class Gltf(EngineModel):
    """Five numbers, the smallest material that every engine loads. Its objective has flat valleys, metallic against
    base colour: hence many starts, and a message where the best of them is an edge case."""

    name = "gltf"
    title = "glTF 2.0 metallic-roughness"
    paper = Paper("Khronos\xa0Group", "glTF 2.0 Specification, appendix B: BRDF Implementation", "ISO/IEC 12113", 2022)
    equations = "appendix B.2, B.3"
    formula = (
        "rho = mix(fresnel_mix(0.04, base/pi, V D), conductor_fresnel(base, V D), metallic); "
        "fresnel_mix(f0, a, b) = (1 - F) a + F b; D, V of GGX (height-correlated), alpha = roughness^2; F by Schlick"
    )
    parameters = (
        Parameter("base_color", (3,), "base colour, linear Rec. 709 rgb", "", 0.0, 1.0),
        Parameter("metallic", (1,), "0 dielectric, 1 metal", "", 0.0, 1.0),
        Parameter("roughness", (1,), "perceptual roughness; alpha is its square", "", 0.03, 1.0),
    )
    kernel = gltf
    logarithmic = ("roughness",)
    start_ranges: ClassVar[Mapping[str, tuple[float, float]]] = {"roughness": (0.05, 0.95), "base_color": (0.02, 1.0)}
    targets = ("gltf", "materialx")

    def warnings(self, parameters, options):
        said = super().warnings(parameters, options)
        if parameters["metallic"][0] > 0.99 and parameters["base_color"].max() < 0.01:
            said.insert(0, "degenerate: a black base with metallic 1, only the grazing reflection is left")
        return said

    def sampler(self, parameters):
        base, metallic = np.asarray(parameters["base_color"], float), float(parameters["metallic"][0])
        f0 = DIELECTRIC_F0 + metallic * (base - DIELECTRIC_F0)
        weights = np.array([(1 - metallic) * (1 - DIELECTRIC_F0) * base.sum(), np.sum(f0 + (1 - f0) / 21)])
        return Mixture([Diffuse(), GgxLobe(float(parameters["roughness"][0]) ** 2)], weights / weights.sum())

    def functions(self, parameters):
        metallic = float(parameters["metallic"][0])
        f0 = DIELECTRIC_F0 + metallic * (np.asarray(parameters["base_color"], float) - DIELECTRIC_F0)
        f = schlick(np.cos(theta_d_centres())[:, None], f0)
        return microfacet_functions({"": float(parameters["roughness"][0]) ** 2}, f)

    def material(self, parameters, target):
        colour = shortest(parameters["base_color"])
        (metallic,), (roughness,) = shortest(parameters["metallic"]), shortest(parameters["roughness"])
        if target == "gltf":
            return {
                "baseColorFactor": [*colour, 1.0],
                "metallicFactor": metallic,
                "roughnessFactor": roughness,
            }
        if target == "materialx":
            inputs = {"base_color": colour, "metallic": metallic, "roughness": roughness, "ior": 1.5}
            return {"node": "gltf_pbr", "inputs": inputs}
        return None
