"""Ashikhmin–Shirley, three lobes: Ashikhmin and Shirley 2000 as fitted by Bilgili et al. 2011 (supplement, Eqs. 3–6).

rho_s = D F / (4 (wo·h) max(n·wi, n·wo)),  D = (n + 1) / (2 pi) (n·h)^n,  F = Schlick's, exponent 5, of (wo·h).
"""

import numpy as np

from brdfatlas.microfacet import schlick, schlick_weight
from brdfatlas.models.base import Parameter, Parameters
from brdfatlas.models.three_lobe.base import F0, KD, KS, UNKNOWN_F0, Amplitude, LobeModel, Unknown
from brdfatlas.sampling import AshikhminShirleyLobe, Lobe


class AshikhminShirley(LobeModel):
    """Diffuse term plus three Ashikhmin–Shirley lobes.

    Authors' fits have n = 0 .. 5e6; ours may use 0.01 .. 1e7.
    """

    name = "ashikhmin_shirley"
    title = "Ashikhmin–Shirley, 3 lobes"
    equations = "Eqs. 3–6"
    formula = (
        "rho = kd/pi + ks sum_j D_j F_j / (4 (wo·h) max(n·wi, n·wo)); "
        "D = (n+1)/(2 pi) (n·h)^n; F = f0 + (1 - f0)(1 - wo·h)^5"
    )
    parameters = (KD, KS, F0, Parameter("n", (3,), "exponent of each lobe", low=0.01, high=1e7))
    unknowns = (UNKNOWN_F0, Unknown("n", 0.01, 1e7, (1.0, 3e4), logarithmic=True))

    def amplitudes(self, shape, cos_h, sin_h, cos_d) -> list[Amplitude]:
        """D F / (4 cos theta_d)."""
        n, f0 = shape["n"], shape["f0"]
        log_cos = 0.5 * np.log1p(-np.minimum(sin_h**2, 1 - 1e-16))  # cos alone rounds to 1 where highlights live
        D = (n + 1) / (2 * np.pi) * np.exp(n * log_cos)
        F = schlick(cos_d, f0)
        spread = 4 * np.maximum(cos_d, 1e-12)
        value = D * F / spread
        return [(value, {"f0": D * (1 - schlick_weight(cos_d)) / spread, "n": value * (1 / (n + 1) + log_cos)})]

    def direction_factors(self, cos_i, cos_o, cos_h, cos_d) -> list[np.ndarray]:
        """1 / max(n·wi, n·wo)."""
        return [1 / np.maximum(cos_i, cos_o)]

    def lobes(self, parameters: Parameters) -> list[Lobe]:
        return [AshikhminShirleyLobe(float(n)) for n in parameters["n"]]
