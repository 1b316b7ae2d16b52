"""The seconds of a fit are those of the fit."""

import time

import numpy as np
from numba import njit
from numba.core.event import TimingListener, install_listener

from brdfatlas.fits import fit
from brdfatlas.measured import Measured
from brdfatlas.models.base import Model, Paper, Parameter, Result


class FreshlyCompiled(Model):
    """A model whose fit compiles a kernel that no cache holds."""

    name = title = equations = formula = "fresh"
    paper = Paper("A Name", "None", "None", 2026)
    parameters = (Parameter("kd", (3,), "albedo"),)

    def fit(self, measured, *, seed=0, **options):
        @njit
        def kernel(x):
            total = 0.0
            for i in range(x.size):
                total += np.sqrt(x[i]) * np.exp(-x[i])
            return total

        return Result({"kd": np.full(3, kernel(np.ones(3)))}, 0.0, "none", 0, True)

    def evaluate(self, parameters, wi, wo):
        return parameters["kd"] / np.pi + 0 * wi


def test_the_clock_of_a_fit_stops_while_kernels_compile():
    """What compiling took is missing from the seconds of the fit, whatever the machine."""
    compiling = TimingListener()
    start = time.perf_counter()
    with install_listener("numba:compile", compiling):
        found = fit(FreshlyCompiled(), Measured("any", np.ones((90, 90, 180, 3), np.float32)))
    elapsed = time.perf_counter() - start
    assert compiling.duration > 0
    assert 0 <= found.report["seconds"] <= elapsed - 0.99 * compiling.duration
