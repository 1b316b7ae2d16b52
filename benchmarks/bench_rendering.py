"""Rendering 256 x 256 pixels, 512 samples, built-in scene A, after compilation; and the same by stock Mitsuba.

    python benchmarks/bench_rendering.py [FILE.binary ...]

Asked: <= 4.5 s on 2 idle cores, >= 2.5 times faster than ``mi.render`` with the stock ``direct`` integrator and the
same plugin at equal noise, <= 1.5 GB. Equal noise: the time stock Mitsuba would need for the variance that ours has,
from its time and variance at 64 samples; both variances are means over the material's pixels of the variance of
batches. CPU seconds of the process stand beside the wall time, which means nothing on a busy machine.
"""

import resource
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from brdfatlas import read_merl
from brdfatlas.rendering import use_variant
from brdfatlas.rendering.jobs import stock_batches
from brdfatlas.rendering.scenes import prepare_scene, read_scenes

SAMPLES, STOCK_SAMPLES, BATCHES, SIZE = 512, 64, 8, 256


def timed(function) -> tuple[float, float, np.ndarray]:
    """Wall seconds, CPU seconds and the result of a second call; the first one compiles."""
    function()
    wall, cpu = time.perf_counter(), time.process_time()
    result = function()
    return time.perf_counter() - wall, time.process_time() - cpu, result


def main(files: list[Path] | None = None, scenes: tuple[str, ...] = ("studio_sphere",)) -> list[float]:
    """Print the table; returns the speed-ups at equal noise."""
    if not files:
        from brdfatlas.pipeline.standins import write_standin

        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "alum-bronze.binary"
            write_standin(path.stem, path)
            return main([path], scenes)
    use_variant("llvm_ad_rgb")
    from brdfatlas.rendering.bsdf import reflectance_of
    from brdfatlas.rendering.integrator import render_batches, set_up, share_lanes

    definitions, ratios = read_scenes(), []
    print(f"{'scene':16} {'material':24} {'wall s':>7} {'CPU s':>7}   {'stock CPU s, equal noise':>24} {'faster':>7}")
    for name in scenes:
        scene = prepare_scene(name, definitions[name], SIZE)
        setup, inside = set_up(scene), scene.mask
        for file in files:
            reflectance = reflectance_of(read_merl(file))

            def render(setup=setup, reflectance=reflectance):
                lanes = share_lanes(setup, reflectance, SAMPLES, 1)
                return render_batches(setup, reflectance, SAMPLES, BATCHES, 1, lanes)

            wall, cpu, ours = timed(render)
            _, stock_cpu, stock = timed(lambda: stock_batches(scene, reflectance, STOCK_SAMPLES, BATCHES, 1))  # noqa: B023
            noise = stock[:, inside].var(0, ddof=1).mean() / ours[:, inside].var(0, ddof=1).mean()
            needed = stock_cpu * noise
            ratios.append(needed / cpu)
            print(f"{name:16} {file.stem:24} {wall:7.2f} {cpu:7.2f}   {needed:24.1f} {ratios[-1]:6.1f}x", flush=True)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024**2
    print(
        f"(asked: 4.5 s on 2 idle cores, 2.5x at equal noise, 1.5 GB; peak of all that this process ran {peak:.2f} GB)"
    )
    return ratios


if __name__ == "__main__":
    main([Path(name) for name in sys.argv[1:]])
