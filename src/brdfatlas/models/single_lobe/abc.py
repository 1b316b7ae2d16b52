"""The ABC microfacet model (Löw, Kronander, Ynnerman, Unger 2012), fitted with their metric E2.

rho = kd/pi + A S(theta_h) F(theta_d) G / (pi cos theta_i cos theta_o), S = (1 + B (1 - cos theta_h))^(-C), F the exact
Fresnel reflectance of a dielectric, G the V-groove. The paper's Eq. 15 has no 1/pi; its published parameters need it.
"""

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from brdfatlas.angles import theta_d_centres, theta_h_centres
from brdfatlas.microfacet import dielectric
from brdfatlas.models.base import Function, Option, Paper, Parameter, Parameters, objective_option
from brdfatlas.models.single_lobe.base import MAX_ANGLE_OPTION, SingleLobeModel
from brdfatlas.sampling import AbcLobe, Mixture, mixture

LOEW2012 = Paper(
    "Joakim Löw, Joel Kronander, Anders Ynnerman, Jonas Unger",
    "BRDF Models for Accurate and Efficient Rendering of Glossy Surfaces",
    "ACM Transactions on Graphics 31 (1)",
    2012,
    "10.1145/2077341.2077350",
)


class ABC(SingleLobeModel):
    """Diffuse term and one lobe with an inverse power for distribution."""

    name = "abc"
    title = "ABC microfacet"
    paper = LOEW2012
    equations = "Eqs. 11, 15 (with 1/pi); metric Eqs. 31, 32"
    formula = (
        "rho = kd/pi + A S F G / (pi cos theta_i cos theta_o); S = (1 + B (1 - cos theta_h))^(-C); "
        "F dielectric of index eta; G = min(1, 2 (n·h)(n·wo)/(wo·h), 2 (n·h)(n·wi)/(wo·h))"
    )
    parameters = (
        Parameter("kd", (3,), "diffuse albedo, rgb", "", 0.0),
        Parameter("A", (3,), "height of the lobe, rgb (published 0.08 .. 5700)", "", 0.0),
        Parameter("B", (1,), "sharpness of the lobe (published 11 .. 8e6)", "", 1e-3, 2e10),
        Parameter("C", (1,), "fall-off of the lobe (published 0.02 .. 2.7)", "", 0.005, 100.0),
        Parameter("eta", (1,), "relative index of refraction (published 1.04 .. 100)", "", 1.005, 200.0),
    )
    public_names: ClassVar[Mapping[str, tuple[str, float]]] = {"kd": ("Lambertian.albedo", 1.0)} | {
        name: (f"LowMicrofacetFit.{name}", 1.0) for name in ("A", "B", "C", "eta")
    }
    options: ClassVar[Mapping[str, Option]] = {
        "objective": objective_option("e2"),
        "max_angle": MAX_ANGLE_OPTION,
    }
    scale = "A"
    logarithmic: ClassVar[Mapping[str, float]] = {"B": 0.0, "C": 0.0, "eta": 1.0}
    products: ClassVar[Mapping[str, str]] = {"B": "C"}
    start_ranges: ClassVar[Mapping[str, tuple[float, float]]] = {
        "B": (3.0, 1e7),  # of B C, the curvature at the peak: for large C the lobe is a Gaussian of B C alone
        "C": (0.1, 4.0),
        "eta": (1.02, 20.0),
    }

    def amplitude(self, shape, theta_h, cos_d):
        """S F. 1 - cos theta_h = 2 sin^2(theta_h / 2) keeps its digits at the highlight."""
        b, c, eta = shape["B"], shape["C"], shape["eta"]
        stretched = b * 2 * np.sin(theta_h / 2) ** 2
        log_base = np.log1p(stretched)
        s = np.exp(-c * log_base)
        f = dielectric(cos_d, eta)
        product = s * f
        slopes = {
            "B": product * (-c / b) * stretched / (1 + stretched),
            "C": -product * log_base,
            "eta": s * dielectric_slope(cos_d, eta),
        }
        return product, slopes

    def sampler(self, parameters: Parameters) -> Mixture:
        """A is no albedo. The lobe weighs as its albedo at normal incidence, 4/pi A F(0) int S dh, shadowing left
        out."""
        B, C, eta = (float(parameters[name][0]) for name in ("B", "C", "eta"))
        lobe = AbcLobe(B, C)
        normal = ((eta - 1) / (eta + 1)) ** 2
        weight = 4 / np.pi * normal * np.asarray(parameters["A"], float).sum() * lobe.integral()
        return mixture(np.asarray(parameters["kd"], float).sum(), [lobe], [weight])

    def functions(self, parameters: Parameters) -> tuple[Function, ...]:
        """S, which is 1 at theta_h = 0, and F."""
        theta_h, theta_d = theta_h_centres(), theta_d_centres()
        b, c, eta = (float(parameters[name][0]) for name in ("B", "C", "eta"))
        s = np.exp(-c * np.log1p(b * 2 * np.sin(theta_h / 2) ** 2))
        return (
            Function("S", "theta_h", theta_h, s),
            Function("F", "theta_d", theta_d, dielectric(np.cos(theta_d), eta)),
        )


def dielectric_slope(cos_d, eta):
    """The derivative of :func:`brdfatlas.microfacet.dielectric` by ``eta`` > 1."""
    g = np.sqrt(eta * eta - 1 + cos_d * cos_d)
    a = (g - cos_d) / (g + cos_d)
    below = cos_d * (g - cos_d) + 1
    b = (cos_d * (g + cos_d) - 1) / below
    by_g = a * (1 + b * b) * 2 * cos_d / (g + cos_d) ** 2 + a * a * b * 2 * cos_d * (1 - cos_d * cos_d) / below**2
    return by_g * eta / g
