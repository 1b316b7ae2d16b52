"""What the three models of Dupuy et al. 2015 share: the citation, the options and the Fresnel table."""

from abc import abstractmethod
from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np

from brdfatlas import microfacet
from brdfatlas.angles import theta_d_centres, theta_h_centres
from brdfatlas.measured import Measured
from brdfatlas.models.base import FitError, Function, Model, Option, Paper, Parameter, Parameters, Result
from brdfatlas.models.dupuy2015 import power_iteration
from brdfatlas.sampling import Lobe, Mixture, mixture

#: How F is found, by the option's value.
FRESNEL = {"corrected": power_iteration.fresnel_corrected, "egsr2015": power_iteration.fresnel_egsr2015}


class PowerIterationModel(Model):
    """F D G / (4 cos cos) with D from power iterations and F from mean ratios (supplemental, Eqs. 1-39)."""

    paper = Paper(
        "Jonathan Dupuy, Eric Heitz, Jean-Claude Iehl, Pierre Poulin, Victor Ostromoukhov",
        "Extracting Microfacet-based BRDF Parameters from Arbitrary Materials with Power Iterations",
        "Computer Graphics Forum (Proc. EGSR) 34(4)",
        2015,
        "10.1111/cgf.12675",
    )
    formula = "F(theta_d) D(theta_h) G(theta_i, theta_o) / (4 cos theta_i cos theta_o)"
    options: ClassVar[Mapping[str, Option]] = {
        "fresnel": Option(
            "corrected",
            "corrected: the mean ratio as the paper states it; egsr2015: as the authors' program of 2015 computed it, "
            "with the light held at the normal (their printed figures carry that)",
            tuple(FRESNEL),
        ),
        "backscatter": Option(
            "published",
            "what the inversion takes G(o, o) for; published: G1(o), which underestimates rough surfaces that obey the "
            "model's own G; forward (ours): G1 / (2 - G1), as the model evaluates it",
            ("published", "forward"),
        ),
        "iterations": Option(
            power_iteration.ITERATIONS,
            "power iterations (Eq. 25), 4 in the paper; backscatter = forward runs to a fixed point instead",
            low=1,
        ),
    }
    FRESNEL = Parameter("fresnel", (90, 3), "reflectance at the centres of the 90 theta_d cells, R G B", "", 0.0, 1.0)

    @abstractmethod
    def shape(self, ndf: np.ndarray) -> dict[str, np.ndarray]:
        """The model's parameters of D, from the tabulated NDF (90,)."""

    @abstractmethod
    def lobe(self, parameters: Parameters) -> Lobe:
        """D cos theta_h as a density of half vectors."""

    @abstractmethod
    def distribution(self, parameters: Parameters, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """D (90,) at the theta_h cells, and G1 at angles ``theta`` (n,) of a direction, radians."""

    def sampler(self, parameters: Parameters) -> Mixture:
        """The density of half vectors alone: the model has no diffuse term."""
        return mixture(0.0, [self.lobe(parameters)], [1.0])

    def functions(self, parameters: Parameters) -> tuple[Function, ...]:
        theta = np.linspace(0, np.deg2rad(89.5), 90)
        ndf, g1 = self.distribution(parameters, theta)
        return (
            Function("F", "theta_d", theta_d_centres(), np.asarray(parameters["fresnel"], float)),
            Function("D", "theta_h", theta_h_centres(), ndf, "1/sr"),
            Function("G1", "theta", theta, g1),
        )

    def fit(self, measured: Measured, *, seed: int = 0, **options: Any) -> Result:
        """Closed procedure without random numbers. FitError if there is no retro-reflection to start from."""
        chosen = self.check_options(options)
        try:
            retro, filled = power_iteration.retro_slice(measured.table)
            ndf, eigenvalue, changes = power_iteration.distribution(
                retro, backscatter=chosen["backscatter"], iterations=chosen["iterations"]
            )
            fresnel = FRESNEL[chosen["fresnel"]](measured.table, ndf)
        except power_iteration.NoDistribution as reason:
            raise FitError(f"{self.name} on {measured.name}: {reason}") from None
        clamped = int((fresnel >= 1).any(1).sum())
        message = f"Fresnel reaches 1 at {clamped} of 90 angles (the model has no diffuse term)" if clamped else ""
        details = {"history": changes, "eigenvalue": eigenvalue, "filled_retro_rows": filled, "clamped": clamped}
        return Result(
            self.shape(ndf) | {"fresnel": fresnel},
            changes[-1],
            "relative change of D in the last power iteration",
            len(changes),
            changes[-1] < 0.01,
            message,
            details,
        )


class OneRoughness(PowerIterationModel):
    """An analytic D with its Smith G1, both of one roughness alpha, which a moment of the tabulated D gives."""

    @staticmethod
    @abstractmethod
    def ndf(cosine: np.ndarray, alpha: float) -> np.ndarray:
        """D in 1/sr at cos theta_h."""

    @staticmethod
    @abstractmethod
    def g1(cosine: np.ndarray, alpha: float) -> np.ndarray:
        """Smith's G1 at the cosine of a direction."""

    @staticmethod
    @abstractmethod
    def alpha_of(ndf: np.ndarray) -> float:
        """alpha from the tabulated D (90,)."""

    def shape(self, ndf: np.ndarray) -> dict[str, np.ndarray]:
        return {"alpha": np.array([self.alpha_of(ndf)])}

    def distribution(self, parameters: Parameters, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        alpha = float(parameters["alpha"][0])
        return self.ndf(np.cos(theta_h_centres()), alpha), self.g1(np.cos(theta), alpha)

    def evaluate(self, parameters: Parameters, wi: np.ndarray, wo: np.ndarray) -> np.ndarray:
        alpha = float(parameters["alpha"][0])
        return microfacet.torrance_sparrow(
            wi,
            wo,
            lambda theta_h: self.ndf(np.cos(theta_h), alpha),
            parameters["fresnel"],
            lambda cosine: self.g1(cosine, alpha),
        )

    def evaluate_grid(self, parameters: Parameters) -> np.ndarray:
        alpha = float(parameters["alpha"][0])
        ndf = self.ndf(np.cos(theta_h_centres()), alpha)
        return microfacet.torrance_sparrow_grid(ndf, parameters["fresnel"], lambda cosine: self.g1(cosine, alpha))
