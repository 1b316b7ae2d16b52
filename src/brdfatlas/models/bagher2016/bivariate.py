"""The bivariate model (Romeiro et al. 2008) as Bagher et al. 2016 fit it: one weighted mean a cell, no iteration."""

import numpy as np

from brdfatlas.angles import GRID_SHAPE, half_difference
from brdfatlas.compiled import njit
from brdfatlas.models.bagher2016.factors import (
    AT_D,
    AT_H,
    OBJECTIVE,
    OPTIONS,
    FactorModel,
    bilinear,
    cell_position,
    nearest_filled,
    table_factors,
)
from brdfatlas.models.base import Factors, FitError, Parameter, Parameters, Result


@njit(cache=True, nogil=True)
def _means(weights, table):
    """sum w and sum w rho over phi_d, each (3, 90, 90), and sum w rho^2 (3,)."""
    n_h, n_d, n_p, _ = weights.shape
    total, mean, power = np.zeros((3, n_h, n_d)), np.zeros((3, n_h, n_d)), np.zeros(3)
    for h in range(n_h):
        for d in range(n_d):
            for p in range(n_p):
                for c in range(3):
                    w = weights[h, d, p, c]
                    if w > 0.0:
                        rho = float(table[h, d, p, c])
                        total[c, h, d] += w
                        mean[c, h, d] += w * rho
                        power[c] += w * rho * rho
    return total, mean, power


class Bivariate(FactorModel):
    """B(theta_h, theta_d). Cells without samples take the value of the nearest cell that has some."""

    name = "bivariate"
    title = "Bivariate table"
    equations = "Eqs. 5, 7-14"
    formula = r"B(\theta_h, \theta_d)"
    parameters = (Parameter("b", (3, 90, 90), f"weighted mean of the BRDF over phi_d, {AT_H} and {AT_D}", "1/sr", 0.0),)
    options = OPTIONS

    def fit(self, measured, *, seed: int = 0, **options) -> Result:
        options = self.check_options(options)
        weights = self.weights(measured, options)
        total, mean, power = _means(weights, measured.table)
        known = total[0] > 0
        mean = np.where(known, mean / np.where(known, total, 1.0), 0.0)
        stored = mean.astype(np.float32).astype(float)
        # sum w (b - rho)^2 = sum w rho^2 - sum w mean^2 + sum w (b - mean)^2
        left = np.maximum(power - (total * mean**2).sum((1, 2)), 0) + (total * (stored - mean) ** 2).sum((1, 2))
        objectives = left / np.where(power > 0, power, 1.0)
        tables = [nearest_filled(table, known) for table in mean]
        empty = 3 * int((~known).sum())
        objective = float(np.mean(objectives))
        if not np.isfinite(objective):
            raise FitError(f"{self.name} on {measured.name}: the objective is not finite")
        details = {"channels": [{"objective": value} for value in objectives], "empty_components": empty}
        return Result({"b": np.stack(tables).astype(np.float32)}, objective, OBJECTIVE, 1, True, details=details)

    def factors(self, parameters: Parameters) -> Factors:
        d, f = table_factors(parameters["b"])
        return Factors(np.zeros(3), d, f)

    def evaluate(self, parameters: Parameters, wi, wo) -> np.ndarray:
        wi, wo = np.broadcast_arrays(np.asarray(wi, float), np.asarray(wo, float))
        theta_h, theta_d, _ = (a.ravel() for a in half_difference(wi, wo))
        values = bilinear(np.asarray(parameters["b"], float), *cell_position(theta_h, theta_d))
        return np.moveaxis(values, 0, -1).reshape(*wi.shape[:-1], 3)

    def evaluate_grid(self, parameters: Parameters) -> np.ndarray:
        table = np.moveaxis(np.asarray(parameters["b"], np.float32), 0, -1)
        return np.array(np.broadcast_to(table[:, :, None], (*GRID_SHAPE, 3)))
