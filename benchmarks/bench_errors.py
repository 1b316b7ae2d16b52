"""Time of the error measures of one picture of 256 x 256 pixels, warm, one core.

    python benchmarks/bench_errors.py

Asked: the dE00 map <= 0.1 s. CPU seconds of this thread, the median of 5. The yardstick of dE00 in the same run is
colour-science, of FLIP its authors' flip-evaluator (CPU seconds of the process, which has threads), of the MSE the sum
over all pairs of batches.
"""

import statistics
import time
from pathlib import Path

import numpy as np

from brdfatlas.figures import pictures
from brdfatlas.measures import errors, flip
from brdfatlas.rendering.images import Render, tone_map


def seconds(function, repeats: int = 5, clock=time.thread_time) -> float:
    """Median CPU time, after one warm call."""
    function()
    times = []
    for _ in range(repeats):
        start = clock()
        function()
        times.append(clock() - start)
    return statistics.median(times)


def picture(seed: int, size: int = 256, batches: int = 8) -> Render:
    """A noisy disk."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[0:size, 0:size] / size - 0.5
    mean = np.clip(1 - 3 * (x**2 + y**2), 0.02, None)[..., None] * np.array([0.8, 0.5, 0.3])
    noisy = (mean * (1 + 0.2 * rng.random((batches, size, size, 3)))).astype(np.float32)
    return Render(noisy.mean(0), noisy, np.hypot(x, y) < 0.45, {})


def all_pairs(a: np.ndarray, b: np.ndarray) -> float:
    """The unbiased MSE as its definition says."""
    d = b.astype(np.float64) - a
    n = len(d)
    return float(np.mean([np.mean(d[i] * d[j]) for i in range(n) for j in range(n) if i != j]))


def main(files: list[Path] | None = None) -> None:
    """``files`` are not needed: the cost does not depend on the material."""
    import colour
    from flip_evaluator import evaluate

    a, b, tone = picture(1), picture(2), errors.Tone(1.0, 2.2)
    shown = [tone_map(x.mean, *tone) for x in (a, b)]
    delta = seconds(lambda: errors.delta_e(*(errors.displayed_lab(x.mean, 1.0) for x in (a, b))))
    lab = [errors.displayed_lab(x.mean, 1.0).astype(np.float64) for x in (a, b)]
    yardstick = seconds(lambda: colour.difference.delta_E_CIE2000(*lab), 3)
    own = seconds(lambda: errors.delta_e(*lab))
    linear = seconds(lambda: errors.linear_errors(a, b))
    x, y = a.batches[:, a.mask], b.batches[:, a.mask]
    pairs = seconds(lambda: all_pairs(x, y), 3)
    gram = seconds(lambda: errors.mean_squared_error(errors.batch_products(x, y)))
    print(f"dE00 map, with both conversions to Lab   {delta:7.3f} s   (asked: 0.1)")
    print(f"  CIEDE2000 alone                        {own:7.3f} s   {yardstick / own:.1f} x faster than colour-science")
    print(f"PSNR, its standard error, relative MSE   {linear:7.3f} s")
    print(f"  unbiased MSE alone                     {gram:7.3f} s   {pairs / gram:.1f} x faster than all pairs")
    ssim = seconds(lambda: errors.ssim_map(*map(errors.structure, shown)))
    print(f"SSIM                                     {ssim:7.3f} s")
    own = seconds(lambda: flip.flip(*map(flip.see, shown)))
    settings = {"ppd": flip.SCALE}
    inputs = [np.ascontiguousarray(x, np.float32) for x in shown]
    yardstick = seconds(
        lambda: evaluate(*inputs, "LDR", applyMagma=False, computeMeanError=False, parameters=settings),
        3,
        time.process_time,
    )
    print(f"FLIP                                     {own:7.3f} s   {yardstick / own:.1f} x faster than flip-evaluator")
    whole = seconds(lambda: errors.image_errors(a, b, tone))
    print(f"all measures of one picture              {whole:7.3f} s")
    print(f"its pictures for the pages               {seconds(lambda: pictures.Scene(a, tone).pictures(b)):7.3f} s")


if __name__ == "__main__":
    main()
