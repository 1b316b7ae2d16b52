"""A model from outside the package: the Lambertian surface. docs/add-a-model.md explains each part."""

from typing import Any, ClassVar

import numpy as np

from brdfatlas.angles import N_THETA_D, N_THETA_H
from brdfatlas.measured import Measured
from brdfatlas.models.base import Factors, FitError, Function, Model, Option, Paper, Parameter, Parameters, Result
from brdfatlas.objectives import importance_weight
from brdfatlas.sampling import Mixture, mixture


class Lambertian(Model):
    """The same radiance in all directions. Its fit is a weighted mean, the exact least-squares solution."""

    name = "lambertian"
    title = "Lambertian"
    paper = Paper(
        authors="Johann Heinrich Lambert",
        title="Photometria sive de mensura et gradibus luminis, colorum et umbrae",
        venue="Klett, Augsburg",
        year=1760,
    )
    equations = "the cosine law"
    formula = "rho = albedo / pi"
    status = "ours: an example of docs/add-a-model.md"
    parameters = (Parameter("albedo", (3,), "diffuse albedo, rgb", "", 0.0, dtype="float64"),)
    options: ClassVar = {
        "measure": Option("pairs", "weight of a cell: its measure of direction pairs or its slice", ("pairs", "slice"))
    }

    def fit(self, measured: Measured, *, seed: int = 0, **options: Any) -> Result:
        options = self.check_options(options)
        weight = importance_weight(measured.valid, measure=options["measure"])
        if not weight.any():
            raise FitError(f"{self.name} on {measured.name}: no valid cell")
        rho = np.nan_to_num(measured.table).astype(float)
        mean = np.einsum("hdp,hdpc->c", weight, rho) / weight.sum()
        error = np.einsum("hdp,hdpc->", weight, (rho - mean) ** 2) / (3 * weight.sum())
        return Result(
            {"albedo": np.pi * mean},
            objective=float(error),
            objective_name="weighted mean square of rho",
            iterations=1,
            converged=True,
        )

    def evaluate(self, parameters: Parameters, wi: np.ndarray, wo: np.ndarray) -> np.ndarray:
        shape = np.broadcast_shapes(np.shape(wi), np.shape(wo))
        return np.broadcast_to(parameters["albedo"] / np.pi, shape)

    # What the model may say of itself beside its values: how it is sampled, what of it is drawn, its factors.

    def sampler(self, parameters: Parameters) -> Mixture:
        """The cosine; there is no other lobe."""
        return mixture(float(parameters["albedo"].sum()), [], [])

    def functions(self, parameters: Parameters) -> tuple[Function, ...]:
        """The radiant exitance of a surface lit from one direction falls as the cosine of its angle."""
        theta = np.linspace(0, np.pi / 2, 91)
        return (Function("M", "theta", theta, np.outer(np.cos(theta), parameters["albedo"])),)

    def factors(self, parameters: Parameters) -> Factors:
        """A constant, and one product that is 0."""
        nothing = np.zeros((3, 1, N_THETA_H)), np.zeros((3, 1, N_THETA_D))
        return Factors(np.asarray(parameters["albedo"]) / np.pi, *nothing)
