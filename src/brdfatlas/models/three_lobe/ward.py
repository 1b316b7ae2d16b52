"""Ward, three lobes: Ward 1992 as fitted by Bilgili et al. 2011 (supplement, Eqs. 3, 14, 15).

rho_s = D / sqrt((n·wo) (n·wi)),  D = exp(-(tan theta_h / alpha)^2) / (4 pi alpha^2). No Fresnel term.
"""

import numpy as np

from brdfatlas.models.base import Parameter, Parameters
from brdfatlas.models.three_lobe.base import KD, KS, Amplitude, LobeModel, Unknown, beckmann_exponential
from brdfatlas.sampling import Lobe, WardLobe


class Ward(LobeModel):
    """Diffuse term plus three Ward lobes.

    The authors kept alpha <= 0.5; ours may use 0.0003 .. 10.
    """

    name = "ward"
    title = "Ward, 3 lobes"
    equations = "Eqs. 3, 14, 15"
    formula = "rho = kd/pi + ks sum_j D_j / sqrt((n·wo)(n·wi)); D = exp(-(tan theta_h/alpha)^2) / (4 pi alpha^2)"
    parameters = (KD, KS, Parameter("alpha", (3,), "roughness of each lobe", low=3e-4, high=10.0))
    unknowns = (Unknown("alpha", 3e-4, 10.0, (0.005, 1.0), logarithmic=True),)

    def amplitudes(self, shape, cos_h, sin_h, cos_d) -> list[Amplitude]:
        """D."""
        alpha = shape["alpha"]
        exponential, exponent = beckmann_exponential(alpha, cos_h, sin_h)
        D = exponential / (4 * np.pi * alpha**2)
        return [(D, {"alpha": D * 2 * (exponent - 1) / alpha})]

    def direction_factors(self, cos_i, cos_o, cos_h, cos_d) -> list[np.ndarray]:
        """1 / sqrt((n·wo) (n·wi))."""
        return [1 / np.sqrt(cos_o * cos_i)]

    def lobes(self, parameters: Parameters) -> list[Lobe]:
        return [WardLobe(float(alpha)) for alpha in parameters["alpha"]]
