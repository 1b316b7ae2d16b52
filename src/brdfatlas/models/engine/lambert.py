"""Lambert's law: the floor of every table."""

import numpy as np

from brdfatlas.compiled import njit
from brdfatlas.models.base import Function, Paper, Parameter
from brdfatlas.models.engine.base import EngineModel, shortest
from brdfatlas.sampling import Diffuse, Mixture


@njit(cache=True, nogil=True, error_model="numpy")
def lambert(p, samples, out):
    """kd / pi."""
    for n in range(samples.shape[0]):
        for c in range(3):
            out[n, c] = p[c] / np.pi


class Lambert(EngineModel):
    """A constant. Its fit is the weighted mean of the material, by the same means as the other models'."""

    name = "lambert"
    title = "Lambert"
    paper = Paper("Johann Heinrich Lambert", "Photometria", "Eberhard Klett, Augsburg", 1760)
    equations = "Lambert's cosine law"
    formula = "rho = kd/pi"
    parameters = (Parameter("kd", (3,), "albedo, rgb", "", 0.0, 1.0),)
    kernel = lambert
    targets = ("mitsuba", "materialx", "gltf")

    def sampler(self, parameters):
        return Mixture([Diffuse()], np.ones(1))

    def functions(self, parameters) -> tuple[Function, ...]:
        return ()

    def material(self, parameters, target):
        colour = shortest(parameters["kd"])
        if target == "mitsuba":
            return {"type": "diffuse", "reflectance": {"type": "rgb", "value": colour}}
        if target == "materialx":
            return _openpbr_diffuse(colour)
        if target == "gltf":  # KHR_materials_specular: without specular reflection base / pi is left
            off = {"KHR_materials_specular": {"specularFactor": 0.0}}
            factors = {"baseColorFactor": [*colour, 1.0], "metallicFactor": 0.0, "roughnessFactor": 1.0}
            return {**factors, "extensions": off}
        return None


def _openpbr_diffuse(colour):
    """open_pbr_surface without specular reflection: EON of roughness 0 is Lambert's law."""
    return {
        "node": "open_pbr_surface",
        "inputs": {
            "base_weight": 1.0,
            "base_color": colour,
            "base_diffuse_roughness": 0.0,
            "base_metalness": 0.0,
            "specular_weight": 0.0,
        },
    }
