"""GGX microfacets with the moments of the tabulated distribution (Dupuy et al. 2015)."""

import numpy as np

from brdfatlas import microfacet
from brdfatlas.angles import theta_h_centres
from brdfatlas.models.base import Parameter, Parameters
from brdfatlas.models.dupuy2015 import PowerIterationModel
from brdfatlas.solvers import power_iteration


class GGX(PowerIterationModel):
    """GGX D with its Smith G1; alpha from the first absolute moment of the slopes.

    F is that of the tabulated model, as in the authors' program.
    """

    name = "ggx"
    title = "GGX microfacet"
    equations = "Supplemental, Eqs. 1-4; alpha E|x|"
    parameters = (
        Parameter("alpha", (1,), "roughness: E|x| of the slope distribution", "", 0.0),
        PowerIterationModel.FRESNEL,
    )

    def shape(self, ndf: np.ndarray) -> dict[str, np.ndarray]:
        return {"alpha": np.array([power_iteration.ggx_alpha(ndf)])}

    def evaluate(self, parameters: Parameters, wi: np.ndarray, wo: np.ndarray) -> np.ndarray:
        alpha = float(parameters["alpha"][0])
        return microfacet.torrance_sparrow(
            wi,
            wo,
            lambda theta_h: microfacet.ggx_ndf(np.cos(theta_h), alpha),
            parameters["fresnel"],
            lambda cosine: microfacet.ggx_g1(cosine, alpha),
        )

    def evaluate_grid(self, parameters: Parameters) -> np.ndarray:
        alpha = float(parameters["alpha"][0])
        ndf = microfacet.ggx_ndf(np.cos(theta_h_centres()), alpha)
        return microfacet.torrance_sparrow_grid(
            ndf, parameters["fresnel"], lambda cosine: microfacet.ggx_g1(cosine, alpha)
        )
