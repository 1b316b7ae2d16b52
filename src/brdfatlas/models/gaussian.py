"""Gaussian (Beckmann) microfacets with the moments of the tabulated distribution (Dupuy et al. 2015)."""

import numpy as np

from brdfatlas import microfacet
from brdfatlas.angles import theta_h_centres
from brdfatlas.models.base import Parameter, Parameters
from brdfatlas.models.dupuy2015 import PowerIterationModel
from brdfatlas.solvers import power_iteration


class Gaussian(PowerIterationModel):
    """Beckmann D with exact Smith G1; alpha from the second moment of the slopes.

    Long tails have no second moment: for such materials alpha depends on where the grid ends (89 degrees).

    F is that of the tabulated model, as in the authors' program.
    """

    name = "gaussian"
    title = "Gaussian (Beckmann) microfacet"
    equations = "Supplemental, Eqs. 1-4; alpha sqrt(2 E[x^2])"
    parameters = (
        Parameter("alpha", (1,), "roughness: sqrt(2 E[x^2]) of the slope distribution", "", 0.0),
        PowerIterationModel.FRESNEL,
    )

    def shape(self, ndf: np.ndarray) -> dict[str, np.ndarray]:
        return {"alpha": np.array([power_iteration.beckmann_alpha(ndf)])}

    def evaluate(self, parameters: Parameters, wi: np.ndarray, wo: np.ndarray) -> np.ndarray:
        alpha = float(parameters["alpha"][0])
        return microfacet.torrance_sparrow(
            wi,
            wo,
            lambda theta_h: microfacet.beckmann_ndf(np.cos(theta_h), alpha),
            parameters["fresnel"],
            lambda cosine: microfacet.beckmann_g1(cosine, alpha),
        )

    def evaluate_grid(self, parameters: Parameters) -> np.ndarray:
        alpha = float(parameters["alpha"][0])
        ndf = microfacet.beckmann_ndf(np.cos(theta_h_centres()), alpha)
        return microfacet.torrance_sparrow_grid(
            ndf, parameters["fresnel"], lambda cosine: microfacet.beckmann_g1(cosine, alpha)
        )
