"""Gaussian (Beckmann) microfacets with the moments of the tabulated distribution (Dupuy et al. 2015)."""

from brdfatlas import microfacet
from brdfatlas.models.base import Parameter, Parameters
from brdfatlas.models.dupuy2015 import power_iteration
from brdfatlas.models.dupuy2015.base import OneRoughness
from brdfatlas.sampling import WardLobe


class Gaussian(OneRoughness):
    """Beckmann D with exact Smith G1; alpha from the second moment of the slopes.

    Long tails have no second moment: for such materials alpha depends on where the grid ends (89 degrees).

    F is that of the tabulated model, as in the authors' program.
    """

    name = "gaussian"
    title = "Gaussian (Beckmann) microfacet"
    equations = "Supplemental, Eqs. 1-4; alpha sqrt(2 E[x^2])"
    parameters = (
        Parameter("alpha", (1,), "roughness: sqrt(2 E[x^2]) of the slope distribution", "", 0.0),
        OneRoughness.FRESNEL,
    )
    ndf = staticmethod(microfacet.beckmann_ndf)
    g1 = staticmethod(microfacet.beckmann_g1)
    alpha_of = staticmethod(power_iteration.beckmann_alpha)

    def lobe(self, parameters: Parameters) -> WardLobe:
        return WardLobe(float(parameters["alpha"][0]))
