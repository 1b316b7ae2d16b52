"""Ward–Duer, three lobes: Duer 2005 as fitted by Bilgili et al. 2011 (supplement, Eqs. 3, 16, 17).

rho_s = D / ((n·wo) (n·wi)),  D = exp(-(tan theta_h / alpha)^2) / (4 pi alpha^2). No Fresnel term.
"""

import numpy as np

from brdfatlas.models.three_lobe.ward import Ward


class WardDuer(Ward):
    """Ward's lobes, differently normalised."""

    name = "ward_duer"
    title = "Ward–Duer, 3 lobes"
    equations = "Eqs. 3, 16, 17"
    formula = "rho = kd/pi + ks sum_j D_j / ((n·wo)(n·wi)); D = exp(-(tan theta_h/alpha)^2) / (4 pi alpha^2)"

    def direction_factors(self, cos_i, cos_o, cos_h, cos_d) -> list[np.ndarray]:
        """1 / ((n·wo) (n·wi))."""
        return [1 / (cos_o * cos_i)]
