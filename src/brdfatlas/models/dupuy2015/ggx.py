"""GGX microfacets with the moments of the tabulated distribution (Dupuy et al. 2015)."""

from brdfatlas import microfacet
from brdfatlas.models.base import Parameter, Parameters
from brdfatlas.models.dupuy2015 import power_iteration
from brdfatlas.models.dupuy2015.base import OneRoughness
from brdfatlas.sampling import GgxLobe


class GGX(OneRoughness):
    """GGX D with its Smith G1; alpha from the first absolute moment of the slopes.

    F is that of the tabulated model, as in the authors' program.
    """

    name = "ggx"
    title = "GGX microfacet"
    equations = "Supplemental, Eqs. 1-4; alpha E|x|"
    parameters = (
        Parameter("alpha", (1,), "roughness: E|x| of the slope distribution", "", 0.0),
        OneRoughness.FRESNEL,
    )
    ndf = staticmethod(microfacet.ggx_ndf)
    g1 = staticmethod(microfacet.ggx_g1)
    alpha_of = staticmethod(power_iteration.ggx_alpha)

    def lobe(self, parameters: Parameters) -> GgxLobe:
        return GgxLobe(float(parameters["alpha"][0]))
