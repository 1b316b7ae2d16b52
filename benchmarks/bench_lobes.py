"""The five 3-lobe fits, warm, one core: CPU seconds, and the ratio to plain scipy on the same data.

    python benchmarks/bench_lobes.py [FILE.binary ...]

Asked: <= 10 s a model with all its starts, and ten times faster than scipy.optimize.least_squares with finite
differences. That yardstick gets one start only (the best of our own), all numbers at once and the same weighted
samples; it is run for one model and at most 4 iterations, so the ratio is a lower bound where it says "stopped".
"""

import statistics
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares

from brdfatlas import read_merl
from brdfatlas.fits import fit
from brdfatlas.measured import Measured
from brdfatlas.models import MODELS
from brdfatlas.models.three_lobe.base import LobeModel, LobeProblem, grid_factors, lobe_columns
from brdfatlas.objectives import graded_weights
from brdfatlas.pipeline.standins import write_standin
from brdfatlas.solvers.least_squares import fit_separable, latin_starts

NAMES = ("ashikhmin_shirley", "cook_torrance", "edwards", "ward", "ward_duer")
YARDSTICK = "cook_torrance"


def plain(model: LobeModel, measured: Measured) -> tuple[float, float, bool]:
    """CPU seconds, objective and whether it converged: scipy, finite differences, every sample a residual."""
    weights = graded_weights(measured.table, "compressive", np.deg2rad(80.0), 0.02)
    lower, upper = model.box("low"), model.box("high")
    starts = latin_starts(192, model.box("first"), model.box("last"), 0)
    begun = fit_separable(LobeProblem(model, measured.table, weights), starts, lower, upper, follow=1, max_iterations=0)
    keep = (weights[..., 0] > 0).ravel()
    root = np.sqrt(weights.reshape(-1, 3)[keep])
    target = root * measured.table.reshape(-1, 3)[keep]
    factors = [g.reshape(8100, 180) for g in grid_factors(type(model))]

    def residual(p: np.ndarray) -> np.ndarray:
        amplitudes = lobe_columns(model, p[6:], False)[0].reshape(len(factors), 8100, 1)
        specular = sum(a * g for a, g in zip(amplitudes, factors)).ravel()[keep]
        return (root * (p[:3] + specular[:, None] * p[3:6]) - target).ravel()

    start = np.concatenate([begun.linear[:, 0], begun.linear[:, 1], begun.x])
    low, high = np.concatenate([np.zeros(6), lower]), np.concatenate([np.full(6, np.inf), upper])
    start = np.clip(start, low + 1e-9, np.where(np.isfinite(high), high - 1e-9, np.inf))
    clock = time.thread_time()
    found = least_squares(residual, start, bounds=(low, high), x_scale="jac", max_nfev=4)
    return time.thread_time() - clock, 2 * found.cost, found.status > 0


def main(paths: list[Path]) -> None:
    seconds: dict[str, list[float]] = {name: [] for name in NAMES}
    reached = 0.0
    for path in paths:
        measured = read_merl(path)
        for name in NAMES:
            if not seconds[name]:
                fit(name, measured, starts=2, follow=1)  # compile
            clock = time.thread_time()
            found = fit(name, measured)
            seconds[name].append(time.thread_time() - clock)
            if name == YARDSTICK and path == paths[0]:
                reached = found.report["objective"]
        print(f"lobes {path.stem}: " + ", ".join(f"{name} {seconds[name][-1]:.2f} s" for name in NAMES), flush=True)
    for name, times in seconds.items():
        print(f"lobes {name}: median {statistics.median(times):.2f} s CPU, most {max(times):.2f} s (asked 10)")
    model = MODELS[YARDSTICK]
    assert isinstance(model, LobeModel)
    slow, objective, converged = plain(model, read_merl(paths[0]))
    print(
        f"lobes {YARDSTICK} on {paths[0].stem}: plain scipy from one start {slow:.1f} s CPU to {objective:.5f}"
        f"{'' if converged else ' (stopped)'}; ours from 192 starts {seconds[YARDSTICK][0]:.2f} s to {reached:.5f}; "
        f"ratio {slow / seconds[YARDSTICK][0]:.0f}"
    )


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        chosen = [Path(p) for p in sys.argv[1:]]
        if not chosen:
            chosen = [Path(folder) / "alum-bronze.binary"]
            write_standin("alum-bronze", chosen[0])
        main(chosen)
