"""One Cook–Torrance lobe, as Ngan, Durand and Matusik (2005) fitted it to the measured materials.

rho = kd/pi + ks D F G / (pi cos theta_i cos theta_o); Beckmann D = exp(-(tan theta_h / m)^2) / (m^2 cos^4 theta_h),
Schlick's F of (wo·h) with a scalar f0, V-groove G.
"""

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np

from brdfatlas.angles import theta_d_centres, theta_h_centres
from brdfatlas.formats.merl import SCALE
from brdfatlas.microfacet import schlick, schlick_weight
from brdfatlas.models.base import Function, Option, Paper, Parameter, Parameters, objective_option
from brdfatlas.models.single_lobe.base import MAX_ANGLE_OPTION, SingleLobeModel
from brdfatlas.sampling import Mixture, WardLobe, mixture


class Ngan(SingleLobeModel):
    """Their metric: squared differences of rho cos theta_i in the measure of direction pairs (equal-sized cells would
    over-count highlights)."""

    name = "ngan"
    title = "Cook–Torrance, 1 lobe"
    paper = Paper(
        "Addy Ngan, Frédo Durand, Wojciech Matusik",
        "Experimental Analysis of BRDF Models",
        "Eurographics Symposium on Rendering",
        2005,
        "10.2312/EGWR/EGSR05/117-126",
    )
    equations = "Section 2.1 and supplemental; Cook and Torrance 1981"
    formula = (
        "rho = kd/pi + ks D F G / (pi cos theta_i cos theta_o); D = exp(-(tan theta_h/m)^2) / (m^2 cos^4 theta_h); "
        "F = f0 + (1 - f0)(1 - cos theta_d)^5; G = min(1, 2 (n·h)(n·wo)/(wo·h), 2 (n·h)(n·wi)/(wo·h))"
    )
    parameters = (
        Parameter("kd", (3,), "diffuse albedo, rgb", "", 0.0),
        Parameter("ks", (3,), "specular reflectivity, rgb", "", 0.0),
        Parameter("f0", (1,), "Fresnel reflectance at normal incidence", "", 0.0, 1.0),
        Parameter("m", (1,), "root mean square slope", "", 3e-4, 10.0),
    )
    #: their albedos belong to the stored numbers of MERL files, before the scale factors of the channels
    public_names: ClassVar[Mapping[str, tuple[str, Any]]] = {
        "kd": ("Lambertian.albedo", SCALE / SCALE[0]),
        "ks": ("NganCookTorrance.albedo", SCALE / SCALE[0]),
        "f0": ("NganCookTorrance.eta", 1.0),
        "m": ("NganCookTorrance.roughness", 1.0),
    }
    options: ClassVar[Mapping[str, Option]] = {
        "objective": objective_option("cosine"),
        "max_angle": MAX_ANGLE_OPTION,
    }
    scale = "ks"
    logarithmic: ClassVar[Mapping[str, float]] = {"m": 0.0}
    start_ranges: ClassVar[Mapping[str, tuple[float, float]]] = {"f0": (0.0, 0.9), "m": (0.003, 1.0)}

    def amplitude(self, shape, theta_h, cos_d):
        """D F."""
        m, f0 = shape["m"], shape["f0"]
        d, exponent = distribution(theta_h, m)
        grazing = schlick_weight(cos_d)
        f = f0 + (1 - f0) * grazing
        return d * f, {"f0": d * (1 - grazing), "m": d * f * 2 * (exponent - 1) / m}

    def sampler(self, parameters: Parameters) -> Mixture:
        kd, ks = (np.asarray(parameters[name], float).sum() for name in ("kd", "ks"))
        return mixture(kd, [WardLobe(float(parameters["m"][0]))], [ks])

    def functions(self, parameters: Parameters) -> tuple[Function, ...]:
        """D, with int D cos = pi, and F."""
        theta_h, theta_d = theta_h_centres(), theta_d_centres()
        m, f0 = float(parameters["m"][0]), float(parameters["f0"][0])
        return (
            Function("D", "theta_h", theta_h, distribution(theta_h, m)[0]),
            Function("F", "theta_d", theta_d, schlick(np.cos(theta_d), f0)),
        )


def distribution(theta_h, m: float) -> tuple[np.ndarray, np.ndarray]:
    """D, and its exponent (tan theta_h / m)^2."""
    exponent = (np.tan(theta_h) / m) ** 2
    return np.exp(-exponent) / (m**2 * np.cos(theta_h) ** 4), exponent
