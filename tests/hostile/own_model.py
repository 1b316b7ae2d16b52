"""The text of a model of one's own, which tests change."""

OWN_MODEL = """
import sys
import numpy as np
from brdfatlas.models.base import Model, Paper, Parameter, Result


class Mine(Model):
    name = "mine"
    title = "Mine"
    paper = Paper("A. Author", "Mine", "Home", 2020)
    equations = "none"
    formula = "a"
    parameters = (Parameter("a", (3,), "albedo", "", 0.0),)

    def fit(self, measured, *, seed=0, **options):
        return Result({"a": np.ones(3)}, 0.0, "none", 1, True)

    def evaluate(self, parameters, wi, wo):
        return np.broadcast_to(parameters["a"], np.shape(wi))
"""
