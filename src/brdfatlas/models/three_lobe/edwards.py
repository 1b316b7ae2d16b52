"""Edwards, three lobes: the halfway vector disk of Edwards et al. 2006 as fitted by Bilgili et al. 2011 (supplement,
Eqs. 3, 11–13), orthogonal projection.

rho_s = D(H) F(n·wo), because ||wi + wo||^2 = 4 (wi·h)^2 always. H = wi + wo is not normalised, and
|H_uv| = 2 cos theta_d sin theta_h. F depends on wo alone: the model is not reciprocal, as published.
"""

import numpy as np

from brdfatlas.microfacet import schlick_weight
from brdfatlas.models.base import Parameter, Parameters
from brdfatlas.models.three_lobe.base import F0, KD, KS, UNKNOWN_F0, Amplitude, LobeModel, Unknown
from brdfatlas.sampling import EdwardsLobe, Lobe


class Edwards(LobeModel):
    """Diffuse term plus three lobes on the halfway vector disk. Not reciprocal.

    Authors' fits have R = 0.003 .. 37 and n = 0 .. 17,000; ours may use n = 0.001 .. 20,000 and
    R / sqrt(n + 1) = 0.001 .. 10.
    """

    name = "edwards"
    title = "Edwards, 3 lobes"
    equations = "Eqs. 3, 11–13"
    formula = (
        "rho = kd/pi + ks sum_j D_j F_j; D = (n+1)/(pi R^2) (1 - |H_uv|^2/R^2)^n inside the disk, 0 outside; "
        "H = wi + wo; F = f0 + (1 - f0)(1 - n·wo)^5"
    )
    parameters = (
        KD,
        KS,
        F0,
        Parameter("R", (3,), "radius of the disk of each lobe", low=1e-3, high=1500.0),
        Parameter("n", (3,), "exponent of each lobe", low=1e-3, high=2e4),
    )
    #: R and n together make the width of a lobe, R / sqrt(n + 1), and n its form: a cap, or for large n a Gaussian
    unknowns = (
        UNKNOWN_F0,
        Unknown("width", 1e-3, 10.0, (0.01, 1.0), logarithmic=True),
        Unknown("n", 1e-3, 2e4, (0.5, 300.0), logarithmic=True),
    )
    reciprocal = False

    def amplitudes(self, shape, cos_h, sin_h, cos_d) -> list[Amplitude]:
        """D f0 and D (1 - f0): the constant and the grazing part of F."""
        n, R, f0 = shape["n"], shape["R"], shape["f0"]
        squared = (2 * cos_d * sin_h / R) ** 2
        inside = squared < 1
        room = np.where(inside, 1 - squared, 1.0)
        log_room = np.log1p(np.where(inside, -squared, 0.0))
        D = np.where(inside, (n + 1) / (np.pi * R**2) * np.exp(n * log_room), 0.0)
        by_n = D * (1 / (n + 1) + log_room)
        by_R = D * 2 / R * (n * squared / room - 1)
        return [
            (D * f0, {"f0": D, "R": by_R * f0, "n": by_n * f0}),
            (D * (1 - f0), {"f0": -D, "R": by_R * (1 - f0), "n": by_n * (1 - f0)}),
        ]

    def shape(self, values) -> dict[str, float]:
        """R = width sqrt(n + 1)."""
        return {"f0": values["f0"], "R": values["width"] * float(np.sqrt(values["n"] + 1)), "n": values["n"]}

    def slopes(self, shape, slopes) -> dict[str, np.ndarray]:
        """By f0, width and n, with R = width sqrt(n + 1)."""
        R, n = shape["R"], shape["n"]
        return {
            "f0": slopes["f0"],
            "width": slopes["R"] * np.sqrt(n + 1),
            "n": slopes["n"] + slopes["R"] * R / (2 * (n + 1)),
        }

    def direction_factors(self, cos_i, cos_o, cos_h, cos_d) -> list[np.ndarray]:
        """1 and (1 - n·wo)^5."""
        return [np.ones_like(cos_o), schlick_weight(cos_o)]

    def lobes(self, parameters: Parameters) -> list[Lobe]:
        return [EdwardsLobe(float(R), float(n)) for R, n in zip(parameters["R"], parameters["n"])]
