"""Time, memory and quality of `lawrence` and `tucker` on one material, warm, one core.

    python benchmarks/bench_factorizations.py [FILE.binary ...]

Asked: each <= 20 s, <= 1 GB, and tucker closer than lawrence in mean |log1p(f cos) - log1p(g cos)|. CPU seconds. The
yardstick in the same run is the same arithmetic as whole-array numpy: one power iteration of a rank-one term, and one
round of multiplicative updates of u.
"""

import resource
import statistics
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from brdfatlas import read_merl
from brdfatlas.fits import fit
from brdfatlas.measured import extend, fold
from brdfatlas.models.factorised.lawrence import outgoing_samples
from brdfatlas.models.factorised.tucker import RESOLUTION, log_tensor
from brdfatlas.objectives import log_deviation
from brdfatlas.solvers import nmf, tensor

ROUNDS = 5


def seconds(function, repeats: int = 3) -> float:
    """Median CPU time of this thread, after one warm call."""
    function()
    times = []
    for _ in range(repeats):
        start = time.thread_time()
        function()
        times.append(time.thread_time() - start)
    return statistics.median(times)


def plain_power_iteration(residual: np.ndarray, weight: np.ndarray, rounds: int) -> tuple[np.ndarray, ...]:
    """tensor.power_iteration as numpy.einsum."""
    weighted = weight * residual
    a, b, c = (np.ones(n) for n in residual.shape)
    for _ in range(rounds):
        a = np.einsum("abc,b,c->a", weighted, b, c) / np.einsum("abc,b,c->a", weight, b * b, c * c)
        b = np.einsum("abc,a,c->b", weighted, a, c) / np.einsum("abc,a,c->b", weight, a * a, c * c)
        c = np.einsum("abc,a,b->c", weighted, a, b) / np.einsum("abc,a,b->c", weight, a * a, b * b)
    return a, b, c


def plain_update_u(samples: nmf.Samples, factors: nmf.Factors, steps: int) -> np.ndarray:
    """nmf._update_u as whole-array numpy, K = 1."""

    def blend(array: np.ndarray, position: np.ndarray) -> np.ndarray:
        low = np.minimum(position.astype(int), len(array) - 2)
        t = (position - low).reshape(position.shape + (1,) * (array.ndim - 1))
        return (1 - t) * array[low] + t * array[low + 1]

    basis = blend(factors.v, samples.v_position)[:, :, None] * blend(factors.f, samples.f_position)
    gram = np.einsum("hsc,hsca,hscb->hab", samples.weight, basis, basis, optimize=True)
    right = np.einsum("hsc,hsca->ha", samples.weight * samples.value, basis)
    u = factors.u.copy()
    for _ in range(steps):
        u *= right / np.maximum(np.einsum("hab,hb->ha", gram, u), nmf.TINY)
    return u


def main(paths: list[Path]) -> None:
    for path in paths:
        measured = read_merl(path)
        scores, times = {}, {}
        for name in ("lawrence", "tucker"):
            fit(name, measured)
            start = time.thread_time()
            fitted = fit(name, measured)
            times[name] = time.thread_time() - start
            scores[name] = log_deviation(measured.table, fold(fitted.table()))
            print(
                f"factorizations {path.stem}: {name} {times[name]:.2f} s CPU (asked 20), {fitted.bytes:,} bytes, "
                f"log deviation {scores[name]:.4f}, {fitted.report['message']}"
            )
        log, weight = (np.ascontiguousarray(a[..., 1]) for a in log_tensor(measured, RESOLUTION))
        usable = weight.any((0, 1))
        log, weight = np.ascontiguousarray(log[..., usable]), np.ascontiguousarray(weight[..., usable])
        own = seconds(
            lambda r=log, w=weight: tensor.power_iteration(r, w, *(np.ones(n) for n in r.shape), ROUNDS, -1.0)
        )
        plain = seconds(lambda r=log, w=weight: plain_power_iteration(r, w, ROUNDS))
        print(f"factorizations {path.stem}: power iteration {own:.4f} s, numpy {plain:.4f} s, ratio {plain / own:.1f}")
        samples = outgoing_samples(measured, extend(measured.table, measured.valid), (128, 16, 16))
        rng = np.random.default_rng(0)
        factors = nmf.Factors(rng.random((128, 4)), rng.random((16, 4)), rng.random((16, 3, 4)))
        arrays = (samples.value, samples.weight, samples.v_position, samples.f_position)
        own = seconds(lambda a=arrays, f=factors: nmf._update_u(*a, f.u.copy(), f.v, f.f, 20))
        plain = seconds(lambda s=samples, f=factors: plain_update_u(s, f, 20))
        print(f"factorizations {path.stem}: update of u {own:.4f} s, numpy {plain:.4f} s, ratio {plain / own:.1f}")
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (1024**3 if sys.platform == "darwin" else 1024**2)
    print(
        f"factorizations: peak memory of this process {peak:.2f} GB (asked 1 a fit job; this one holds all files' fits)"
    )


if __name__ == "__main__":
    if sys.argv[1:]:
        main([Path(p) for p in sys.argv[1:]])
    else:
        from brdfatlas.pipeline.standins import write_standin

        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "alum-bronze.binary"
            write_standin("alum-bronze", file)
            main([file])
