"""One GGX lobe over a Lambertian base: what most renderers' "rough plastic or metal" comes down to."""

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from brdfatlas.angles import theta_d_centres
from brdfatlas.compiled import njit
from brdfatlas.microfacet import schlick
from brdfatlas.models.base import Option, Paper, Parameter, objective_option
from brdfatlas.models.engine.base import EngineModel, fifth, ggx, microfacet_functions, visible_correlated
from brdfatlas.sampling import Diffuse, GgxLobe, Mixture

WALTER2007 = Paper(
    "Bruce Walter, Stephen Marschner, Hongsong Li, Kenneth Torrance",
    "Microfacet Models for Refraction through Rough Surfaces",
    "Eurographics Symposium on Rendering",
    2007,
    "10.2312/EGWR/EGSR07/195-206",
)
KD = Parameter("kd", (3,), "diffuse albedo, rgb", "", 0.0, 1.0)
F0 = Parameter("F0", (3,), "reflectance at normal incidence, rgb; 1 at grazing incidence", "", 0.0, 1.0)


@njit(cache=True, nogil=True, error_model="numpy")
def ggx_diffuse(p, samples, out):
    """p = kd rgb, F0 rgb, alpha."""
    matte, alpha = p[:3] / np.pi, p[6]
    for n in range(samples.shape[0]):
        cos_i, cos_o, sin2_h, cos_d = samples[n]
        lobe = ggx(sin2_h, alpha) * visible_correlated(cos_i, cos_o, alpha)
        grazing = fifth(cos_d)
        for c in range(3):
            out[n, c] = matte[c] + lobe * (p[3 + c] + (1 - p[3 + c]) * grazing)


class GgxDiffuse(EngineModel):
    """Seven numbers. No multiple scattering."""

    name = "ggx_diffuse"
    title = "GGX, 1 lobe, and diffuse"
    paper = WALTER2007
    equations = "Walter et al. 2007, Eqs. 20, 33; Heitz 2014, Eq. 99 (height-correlated G); Schlick 1994, Eq. 15"
    formula = (
        "rho = kd/pi + D F G / (4 cos theta_i cos theta_o); D = alpha^2 / (pi (cos^2 theta_h (alpha^2 - 1) + 1)^2); "
        "F = F0 + (1 - F0)(1 - cos theta_d)^5; G = 1 / (1 + L(theta_i) + L(theta_o)), "
        "L = (-1 + sqrt(1 + alpha^2 tan^2)) / 2"
    )
    parameters = (
        KD,
        F0,
        Parameter("alpha", (1,), "width of the lobe, the square of an artist's roughness", "", 1e-3, 1.0),
    )
    kernel = ggx_diffuse
    options: ClassVar[Mapping[str, Option]] = EngineModel.options | {"objective": objective_option("e2")}
    logarithmic = ("alpha",)
    start_ranges: ClassVar[Mapping[str, tuple[float, float]]] = {"alpha": (2e-3, 0.8)}

    def sampler(self, parameters):
        specular = float(np.sum(parameters["F0"] + (1 - parameters["F0"]) / 21))
        weights = np.array([float(np.sum(parameters["kd"])), specular])
        return Mixture([Diffuse(), GgxLobe(float(parameters["alpha"][0]))], weights / weights.sum())

    def functions(self, parameters):
        f = schlick(np.cos(theta_d_centres())[:, None], np.asarray(parameters["F0"], float))
        return microfacet_functions({"": float(parameters["alpha"][0])}, f)
