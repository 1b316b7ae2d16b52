"""Cook–Torrance, three lobes: Cook and Torrance 1981 as fitted by Bilgili et al. 2011 (supplement, Eqs. 3, 7–10).

rho_s = D G F / (pi (n·wo) (n·wi)),  D = exp(-(tan theta_h / m)^2) / (m^2 cos^4 theta_h),  G the V-groove of Eq. 9.
Eq. 10 prints the Fresnel exponent 2. The published parameters were made with 5: over the 100 materials the mean
|log| deviation from the other four published fits is half as large with 5. So F is Schlick's, of (wo·h).
"""

import numpy as np

from brdfatlas.microfacet import schlick_weight, v_groove
from brdfatlas.models.base import Parameter, Parameters
from brdfatlas.models.three_lobe.base import F0, KD, KS, UNKNOWN_F0, Amplitude, LobeModel, Unknown, beckmann_exponential
from brdfatlas.sampling import Lobe, WardLobe


class CookTorrance(LobeModel):
    """Diffuse term plus three Cook–Torrance lobes.

    The authors kept m < 1; ours may use 0.0003 .. 10.
    """

    name = "cook_torrance"
    title = "Cook–Torrance, 3 lobes"
    equations = "Eqs. 3, 7–10"
    formula = (
        "rho = kd/pi + ks sum_j D_j F_j G / (pi (n·wo)(n·wi)); D = exp(-(tan theta_h/m)^2) / (m^2 cos^4 theta_h); "
        "F = f0 + (1 - f0)(1 - wo·h)^5; G = min(1, 2 (n·h)(n·wo)/(wo·h), 2 (n·h)(n·wi)/(wo·h))"
    )
    parameters = (KD, KS, F0, Parameter("m", (3,), "root mean square slope of each lobe", low=3e-4, high=10.0))
    unknowns = (UNKNOWN_F0, Unknown("m", 3e-4, 10.0, (0.005, 1.0), logarithmic=True))
    #: 2 in print; see above.
    fresnel_exponent = 5

    def amplitudes(self, shape, cos_h, sin_h, cos_d) -> list[Amplitude]:
        """D F."""
        m, f0 = shape["m"], shape["f0"]
        exponential, exponent = beckmann_exponential(m, cos_h, sin_h)
        D = exponential / (m**2 * cos_h**4)
        grazing = schlick_weight(cos_d, self.fresnel_exponent)
        F = f0 + (1 - f0) * grazing
        return [(D * F, {"f0": D * (1 - grazing), "m": D * F * 2 * (exponent - 1) / m})]

    def direction_factors(self, cos_i, cos_o, cos_h, cos_d) -> list[np.ndarray]:
        """G / (pi (n·wo) (n·wi)), Eq. 9."""
        return [v_groove(cos_h, cos_i, cos_o, np.maximum(cos_d, 1e-12)) / (np.pi * cos_o * cos_i)]

    def lobes(self, parameters: Parameters) -> list[Lobe]:
        """By Ward's procedure, as the supplement does."""
        return [WardLobe(float(m)) for m in parameters["m"]]
