"""Tabulated D and F with Smith shadowing, found by power iterations (Dupuy et al. 2015)."""

import numpy as np

from brdfatlas import microfacet
from brdfatlas.models.base import Parameter, Parameters
from brdfatlas.models.dupuy2015.base import PowerIterationModel
from brdfatlas.sampling import TabulatedLobe


class Tabulated(PowerIterationModel):
    """90 values of D, 90 x 3 of F; G1 follows from D by the Smith integral (Eq. 4) and is not stored."""

    name = "tabulated"
    title = "Tabulated microfacet"
    equations = "Supplemental, Eqs. 1-4 (model), 10-26 (D), 35-39 (F)"
    parameters = (
        Parameter("ndf", (90,), "D at the centres of the 90 theta_h cells, int D cos = 1", "1/sr", 0.0),
        PowerIterationModel.FRESNEL,
    )

    def shape(self, ndf: np.ndarray) -> dict[str, np.ndarray]:
        return {"ndf": ndf}

    def lobe(self, parameters: Parameters) -> TabulatedLobe:
        theta_h, solid_angle = microfacet.theta_h_quadrature()
        shares = np.asarray(parameters["ndf"], float) * np.cos(theta_h) * solid_angle
        return TabulatedLobe(tuple(shares.tolist()))

    def distribution(self, parameters: Parameters, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        ndf = np.asarray(parameters["ndf"], float)
        return ndf, microfacet.smith_g1(microfacet.smith_sigma(ndf), np.cos(theta))

    def evaluate(self, parameters: Parameters, wi: np.ndarray, wo: np.ndarray) -> np.ndarray:
        ndf = parameters["ndf"].astype(float)
        sigma = microfacet.smith_sigma(ndf)
        return microfacet.torrance_sparrow(
            wi,
            wo,
            lambda theta_h: microfacet.interpolate_ndf(ndf, theta_h),
            parameters["fresnel"],
            lambda cosine: microfacet.smith_g1(sigma, cosine),
        )

    def evaluate_grid(self, parameters: Parameters) -> np.ndarray:
        ndf = parameters["ndf"].astype(float)
        sigma = microfacet.smith_sigma(ndf)
        return microfacet.torrance_sparrow_grid(
            ndf, parameters["fresnel"], lambda cosine: microfacet.smith_g1(sigma, cosine)
        )
