"""Fitting statistics of the factor models in the form of Bagher et al. 2016, Table I, and the gain over plain NumPy.

    python benchmarks/bench_factors.py FOLDER [--limit N] [--models naive ...]

CPU seconds of one thread, warm. "vs NumPy": CPU seconds of one published iteration of one channel in NumPy
(plain_factors.py) over those of the package's compiled iteration, in this process on the same samples.
"""

import argparse
import importlib.util
import os
import statistics
import sys
import time
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from brdfatlas import read_merl
from brdfatlas.fits import fit
from brdfatlas.measured import Measured
from brdfatlas.models.bagher2016.awls import CLAMP, Channel, Geometry
from brdfatlas.models.bagher2016.factors import slices
from brdfatlas.models.bagher2016.microfacet_factors import FactorProblem
from brdfatlas.models.bagher2016.naive import naive_problem
from brdfatlas.objectives import compressive_weights

#: Asked: median seconds a material.
ASKED = {
    "independent_g": 45.0, "g_from_d": 10.0, "naive": 8.0, "bivariate": 0.3, "bivariate_g": 30.0, "low_rank_2": 30.0,
    "low_rank_4": 30.0,
}  # fmt: skip
SLOW = ("independent_g", "bivariate_g", "low_rank_2", "low_rank_4")
#: Table I, 100 materials on one core in 2016: (min, mean, max) of seconds, iterations and golden-section calls, and
#: how many materials called it.
PUBLISHED = {
    "independent_g": ((59, 2838, 16421), (25, 1192, 10168), (1, 47, 2296), 57),
    "g_from_d": ((135, 765, 7222), (15, 56, 1012), (2, 69, 359), 46),
    "naive": ((349, 680, 2281), (817, 2038, 7628), (0, 0, 0), 0),
}


def plain_module():
    path = Path(__file__).with_name("plain_factors.py")
    specification = importlib.util.spec_from_file_location("plain_factors", path)
    module = importlib.util.module_from_spec(specification)
    sys.modules[specification.name] = module
    specification.loader.exec_module(module)
    return module


def seconds(function, repeats: int) -> float:
    """Median CPU time of this thread, after one warm call."""
    function()
    times = []
    for _ in range(repeats):
        start = time.thread_time()
        function()
        times.append(time.thread_time() - start)
    return statistics.median(times)


def ratios(measured: Measured) -> dict[str, float]:
    """Seconds of a plain iteration over seconds of a compiled one, green channel, after three iterations."""
    plain = plain_module()
    weights, rho = compressive_weights(measured.table)[..., 1], measured.table[..., 1]
    samples = plain.Samples(weights, rho)
    found = {}
    for name, naive in (("independent_g", False), ("naive", True)):
        if naive:
            problem, start = naive_problem(weights, rho)
            state = problem.start(*start)
        else:
            channel = Channel.of(Geometry.of(weights > 0), weights, rho)
            problem = FactorProblem(channel, clamp=CLAMP)
            state = problem.start(*slices(channel))
        slow = plain.start(samples, *plain.slices(samples), naive=naive)
        for _ in range(3):
            slow, state = plain.iterate(samples, slow, naive=naive), problem.sweep(state)
        # One G update each: how often it repeats depends on the data.
        plain_time = seconds(lambda: plain.iterate(samples, slow, naive=naive), 1)  # noqa: B023
        found[name] = plain_time / seconds(lambda: problem.sweep(state), 5)  # noqa: B023
    return found


def three(values) -> str:
    values = list(values)
    return f"{min(values):8.4g} {statistics.mean(values):8.4g} {max(values):8.4g}"


def main(paths: list[Path], models=tuple(ASKED), slow: int = 1) -> None:
    """``slow``: on how many of the files the models that take many seconds are measured."""
    rows: dict[str, list[tuple[float, int, int, float]]] = {name: [] for name in models}
    for number, path in enumerate(paths):
        measured = read_merl(path)
        if number == 0:
            # Warm: these compile and cache what all models use.
            for name in ("bivariate", "naive", "g_from_d", "independent_g"):
                fit(name, measured, **({"starts": "slices"} if name == "independent_g" else {}))
        for name in models:
            if name in SLOW and number >= slow:
                continue
            start = time.thread_time()
            report = fit(name, measured).report
            spent = time.thread_time() - start
            golden = int(report["details"].get("golden_section_calls", 0))
            rows[name].append((spent, report["iterations"], golden, report["objective"]))
    gain = ratios(read_merl(paths[0]))
    counts = {name: len(found) for name, found in rows.items()}
    print(f"factor models, CPU seconds of one thread; min mean max over files: {counts}")
    head = "fitting time (s)", "iterations (3 channels)", "golden-section calls", "materials"
    print(f"{'':24s}{head[0]:>28s}{head[1]:>28s}{head[2]:>28s}{head[3]:>11s}  objective   median (asked)  vs NumPy")
    for name, found in rows.items():
        spent, iterations, golden, objective = zip(*found)
        calls = [value for value in golden if value] or [0]
        print(
            f"{name:24s}{three(spent):>28s}{three(iterations):>28s}{three(calls):>28s}"
            f"{sum(value > 0 for value in golden):11d}  {np.mean(objective):9.3e}"
            f"   {statistics.median(spent):6.2f} ({ASKED[name]:g})"
            + (f"  {gain[name]:.0f} x an iteration" if name in gain else "")
        )
        if name in PUBLISHED:
            *columns, materials = PUBLISHED[name]
            numbers = "".join(f"{' '.join(f'{value:8d}' for value in column):>28s}" for column in columns)
            print(f"{'  published, 2016':24s}{numbers}{materials:11d}")


if __name__ == "__main__":
    arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    arguments.add_argument("folder", type=Path, help="folder of MERL .binary files")
    arguments.add_argument("--limit", type=int, default=4, help="how many of the files, at most")
    arguments.add_argument("--models", nargs="+", default=list(ASKED), choices=list(ASKED))
    args = arguments.parse_args()
    files = sorted(args.folder.glob("*.binary"))[: args.limit]
    if not files:
        arguments.error(f"no .binary file in {args.folder}")
    main(files, tuple(args.models), slow=len(files))
