"""Two GGX lobes of one colour over a Lambertian base: a sharp highlight with a wide foot."""

from collections.abc import Mapping
from dataclasses import replace
from typing import ClassVar

import numpy as np

from brdfatlas.angles import theta_d_centres
from brdfatlas.compiled import njit
from brdfatlas.microfacet import schlick
from brdfatlas.models.base import Option, Parameter, objective_option
from brdfatlas.models.engine.base import (
    EngineModel,
    Grid,
    Problem,
    Space,
    fifth,
    ggx,
    microfacet_functions,
    visible_correlated,
)
from brdfatlas.models.engine.ggx_diffuse import F0, KD, WALTER2007, GgxDiffuse
from brdfatlas.sampling import Diffuse, GgxLobe, Mixture


@njit(cache=True, nogil=True, error_model="numpy")
def ggx2_diffuse(p, samples, out):
    """p = kd rgb, F0 rgb, alpha of both lobes, weight of both together, share of the second."""
    matte, first, second = p[:3] / np.pi, p[6], p[7]
    narrow, wide = p[8] * (1 - p[9]), p[8] * p[9]
    for n in range(samples.shape[0]):
        cos_i, cos_o, sin2_h, cos_d = samples[n]
        lobe = narrow * ggx(sin2_h, first) * visible_correlated(cos_i, cos_o, first)
        lobe += wide * ggx(sin2_h, second) * visible_correlated(cos_i, cos_o, second)
        grazing = fifth(cos_d)
        for c in range(3):
            out[n, c] = matte[c] + lobe * (p[3 + c] + (1 - p[3 + c]) * grazing)


class Ggx2Diffuse(EngineModel):
    """Ten numbers. With weight 1 and share 0 it is ``ggx_diffuse``, so it is never a worse fit. A weight below 1 lets
    the surface rise to less than white at grazing incidence."""

    name = "ggx2_diffuse"
    title = "GGX, 2 lobes, and diffuse"
    paper = WALTER2007
    equations = "as ggx_diffuse, for two lobes whose weights w (1 - s), w s sum to at most 1"
    formula = (
        "rho = kd/pi + w F ((1 - s) D1 G1 + s D2 G2) / (4 cos theta_i cos theta_o); "
        "D, F, G as ggx_diffuse, one F0 for both"
    )
    parameters = (
        KD,
        F0,
        Parameter("alpha", (2,), "widths of the lobes, squares of an artist's roughness", "", 1e-3, 1.0),
        Parameter("weight", (1,), "weight w of both lobes together", "", 0.0, 1.0),
        Parameter("share", (1,), "share s of the second lobe", "", 0.0, 1.0),
    )
    kernel = ggx2_diffuse
    options: ClassVar[Mapping[str, Option]] = EngineModel.options | {"objective": objective_option("e2")}
    logarithmic = ("alpha",)
    start_ranges: ClassVar[Mapping[str, tuple[float, float]]] = {
        "alpha": (2e-3, 0.8),
        "weight": (0.2, 1.0),
        "share": (0.05, 0.95),
    }
    follow = (8, 4)

    def best(self, space, grid: Grid, measured, options, seed):
        """Starts also where one lobe fits best, with a second one beside it that weighs nothing yet. What one lobe
        reaches on the full grid is kept where two reach no more."""
        single = GgxDiffuse()
        alone = Space(single, {})
        lower, upper = alone.bounds()
        found, _ = single.best(alone, grid, measured, options, seed)
        beside = [
            np.append(found.x, [np.clip(found.x[6] + np.log(factor), lower[6], upper[6]), 1.0, 0.0])
            for factor in (0.2, 0.5, 2.0, 5.0)
        ]
        starts = self.starts(space, measured, options, seed)
        solution, ends = self._descend(space, grid, np.concatenate([beside, starts]))
        full = Problem(space, grid.samples)
        if full.value(beside[0]) < full.value(solution.x):
            solution = replace(solution, x=beside[0])
        return solution, ends

    def sampler(self, parameters):
        specular = float(parameters["weight"][0] * np.sum(parameters["F0"] + (1 - parameters["F0"]) / 21))
        share = float(parameters["share"][0])
        weights = np.array([float(np.sum(parameters["kd"])), specular * (1 - share), specular * share])
        if not weights.any():  # a black surface
            weights[0] = 1.0
        return Mixture([Diffuse(), *(GgxLobe(float(a)) for a in parameters["alpha"])], weights / weights.sum())

    def functions(self, parameters):
        f = schlick(np.cos(theta_d_centres())[:, None], np.asarray(parameters["F0"], float))
        f = float(parameters["weight"][0]) * f
        return microfacet_functions({" 1": float(parameters["alpha"][0]), " 2": float(parameters["alpha"][1])}, f)
