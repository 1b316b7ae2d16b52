"""CPU time and memory of the fits of sgd, abc, abc_compressive and ngan, and their ratio to plain least squares.

    python benchmarks/bench_parametric.py FILE.binary ...

Asked: <= 3 s each on one core, warm, the median over the materials; memory <= 1 GB; 10 times faster than
scipy.optimize.least_squares with finite differences on the same samples. The plain fit searches all parameters at once
by whole-array numpy, in the same weights and bounds, from ONE start near the optimum (ours moved by 20 %), where ours
tries dozens: the ratio flatters the plain one. It takes minutes, so it is run on every 16th sample of the first
material, and its time multiplied by 16: it is proportional to the samples, all of which ours uses.
"""

import resource
import statistics
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares

from brdfatlas import read_merl
from brdfatlas.angles import grid_axes, grid_cosines
from brdfatlas.fits import Fit, fit
from brdfatlas.measured import Measured
from brdfatlas.models import MODELS, sgd
from brdfatlas.objectives import least_squares_weights

NAMES = ("sgd", "abc", "abc_compressive", "ngan")
THINNING = 16


def timed(function: Callable):
    """Result and CPU seconds of this thread."""
    start = time.thread_time()
    result = function()
    return result, time.thread_time() - start


def samples(measured: Measured, objective: str):
    """Angles, cosines, root weights (n, 3) and values (n, 3) of the samples that count; roots are None for E2."""
    theta_h, theta_d, _ = np.broadcast_arrays(*grid_axes())
    if objective == "e2":
        keep = (theta_h <= np.deg2rad(80)) & (theta_d <= np.deg2rad(80)) & measured.valid
        roots = None
    else:
        weights = least_squares_weights(measured.table, objective)
        keep = weights.any(-1)
    chosen = np.flatnonzero(keep)[::THINNING]
    keep = np.zeros(keep.size, bool)
    keep[chosen] = True
    keep = keep.reshape(theta_h.shape)
    if objective != "e2":
        roots = np.sqrt(weights[keep] * THINNING)
    cosines = [c[keep].astype(float) for c in grid_cosines()]
    return theta_h[keep], theta_d[keep], *cosines, roots, measured.table[keep].astype(float)


def plain_single_lobe(measured: Measured, found: Fit) -> float:
    """kd, scale and shape of a one-lobe model together; returns the objective reached."""
    model = MODELS[found.model]
    objective = model.options["objective"].default
    theta_h, theta_d, cos_i, cos_o, roots, rho = samples(measured, objective)
    groove = np.minimum(1, 2 * np.cos(theta_h) * np.minimum(cos_i, cos_o) / np.cos(theta_d)) / (np.pi * cos_i * cos_o)
    names = model.shape_names
    log = [name in model.logarithmic for name in names]

    def residuals(x):
        shape = {n: float(np.exp(v) if is_log else v) for n, v, is_log in zip(names, x[6:], log)}
        lobe = model.amplitude(shape, theta_h, np.cos(theta_d))[0] * groove
        f = x[:3] / np.pi + np.exp(x[3:6]) * lobe[:, None]
        if roots is None:
            difference = np.log1p(f * cos_i[:, None]) - np.log1p(rho * cos_i[:, None])
            return (difference / np.sqrt(len(rho))).ravel()
        return ((f - rho) * roots).ravel()

    ranges = {p.name: (p.low, p.high) for p in model.parameters}
    start = [*found.parameters["kd"] * 0.8, *np.log(np.maximum(found.parameters[model.scale], 1e-6)) - 0.2]
    lower, upper = [0.0] * 3 + [-30.0] * 3, [np.inf] * 6
    for name, is_log in zip(names, log):
        low, high = (np.log(v) for v in ranges[name]) if is_log else ranges[name]
        value = float(found.parameters[name][0])
        start.append(np.clip(np.log(value) + 0.2 if is_log else value * 0.8, low, high))
        lower.append(low)
        upper.append(high)
    return 2 * float(least_squares(residuals, np.clip(start, lower, upper), bounds=(lower, upper), x_scale="jac").cost)


def plain_sgd(measured: Measured, found: Fit) -> float:
    """The six numbers of each channel together; returns the objective reached."""
    theta_h, theta_d, cos_i, cos_o, roots, rho = samples(measured, "compressive")
    tan2, cos_d = np.tan(theta_h) ** 2, np.cos(theta_d)
    position_i, position_o = (np.sqrt(c) * sgd.N_AREA for c in (cos_i, cos_o))
    nodes, total = np.arange(sgd.N_AREA + 1), 0.0
    for c in range(3):

        def residuals(x, c=c):
            alpha, p = float(np.exp(x[2])), float(x[3])
            inverse, (log_k, _, _) = sgd.shadowing(alpha, p)
            area = np.interp(position_i, nodes, inverse[0]) * np.interp(position_o, nodes, inverse[0])
            lobe = sgd.distribution(tan2, alpha, p, log_k)[0] * area
            f = (x[0] + np.exp(x[1]) * lobe * sgd.fresnel(cos_d, x[4], x[5])) / np.pi
            return (f - rho[:, c]) * roots[:, c]

        numbers = [float(found.parameters[p.name][c]) for p in MODELS["sgd"].parameters]
        start = np.array([numbers[0], np.log(max(numbers[1], 1e-9)), np.log(numbers[2]), *numbers[3:]])
        start += [-0.2 * start[0], -0.2, 0.2, 0.1, 0.1 * abs(start[4]), 0.1 * abs(start[5])]
        lower, upper = [0, -40, np.log(1e-7), 0, 0, -200], [np.inf, 30, np.log(20), 4, 200, 200]
        bounded = np.clip(start, lower, upper)
        total += 2 * float(least_squares(residuals, bounded, bounds=(lower, upper), x_scale="jac").cost)
    return total


def main(files: list[Path]) -> None:
    seconds: dict[str, list[float]] = {name: [] for name in NAMES}
    ratios = []
    for index, path in enumerate(files):
        measured = read_merl(path)
        for name in NAMES:
            if index == 0:
                fit(name, measured)  # compiles and fills the caches
            found, spent = timed(lambda m=measured, n=name: fit(n, m))
            seconds[name].append(spent)
            if index == 0:
                ratios.append((name, measured, found, spent))
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    for name, values in seconds.items():
        median = statistics.median(values)
        print(f"{name}: median {median:.2f} s CPU over {len(values)} materials (asked 3), most {max(values):.2f} s")
    print(f"peak memory, plain fits and earlier benchmarks included, {peak:.2f} GB (asked of a fit job: 1)")
    for name, measured, found, spent in ratios:
        plain = plain_sgd if name == "sgd" else plain_single_lobe
        reached, plain_seconds = timed(lambda m=measured, f=found, p=plain: p(m, f))
        ours = found.report["objective"] ** (2 if found.report["objective_name"].startswith("cosine") else 1)
        print(
            f"{name} on {measured.name}: ours {spent:.2f} s to {ours:.6g}, plain {THINNING} x {plain_seconds:.2f} s to "
            f"{reached:.6g} on the thinned samples, ratio {THINNING * plain_seconds / spent:.0f}",
            flush=True,
        )


if __name__ == "__main__":
    main([Path(p) for p in sys.argv[1:]] or sys.exit(__doc__))
