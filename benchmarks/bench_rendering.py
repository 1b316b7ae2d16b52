"""Rendering 256 x 256 pixels, 512 samples, after compilation: one table by our integrator and by stock Mitsuba in the
built-in scene A; and a reference with 21 fits along the same paths against one after another, spheres and statues.

    python benchmarks/bench_rendering.py [FILE.binary ...]

Asked: <= 4.5 s on 2 idle cores, >= 2.5 times faster than ``mi.render`` with the stock ``direct`` integrator and the
same plugin at equal noise, <= 1.5 GB. Equal noise: the time stock Mitsuba would need for the variance that ours has,
from its time and variance at 64 samples; both variances are means over the material's pixels of the variance of
batches. CPU seconds of the process stand beside the wall time, which means nothing on a busy machine.

Of all models at once: >= 2.5 times faster a picture on spheres, >= 6 times on statues, <= 3 GB. Paths are camera rays;
each looks two directions up, two cells a direction. The bytes of these cells a second stand beside those that a plain
copy reads and writes in the same run: cells that the caches hold are counted too.
"""

import resource
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path

import numpy as np

from brdfatlas import read_merl
from brdfatlas.rendering import use_variant
from brdfatlas.rendering.jobs import stock_batches
from brdfatlas.rendering.scenes import prepare_scene, read_scenes

SAMPLES, STOCK_SAMPLES, BATCHES, SIZE = 512, 64, 8, 256


def thrice(function) -> tuple[float, float, float]:
    """Wall seconds of a first call, which compiles; least wall and CPU seconds of two more."""
    calls = []
    for _ in range(3):
        wall, cpu = time.perf_counter(), time.process_time()
        function()
        calls.append((time.perf_counter() - wall, time.process_time() - cpu))
    return calls[0][0], *map(min, zip(*calls[1:]))


def timed(function) -> tuple[float, float, np.ndarray]:
    """Wall seconds, CPU seconds and the result of a second call; the first one compiles."""
    function()
    wall, cpu = time.perf_counter(), time.process_time()
    result = function()
    return time.perf_counter() - wall, time.process_time() - cpu, result


def copy_bandwidth(threads: int = 2) -> float:
    """Bytes a second, read and written, of a plain copy by ``threads`` threads; the best of three."""
    parts = [(np.ones(1 << 25, np.float32), np.empty(1 << 25, np.float32)) for _ in range(threads)]
    seconds = []
    with ThreadPoolExecutor(threads) as pool:
        for _ in range(3):
            start = time.perf_counter()
            list(pool.map(lambda part: np.copyto(part[1], part[0]), parts))
            seconds.append(time.perf_counter() - start)
    return 2 * sum(a.nbytes for a, _ in parts) / min(seconds)


def shared_paths(file: Path, scenes: tuple[str, ...], tables: int = 21, samples: int = SAMPLES) -> list[float]:
    """Print a reference with ``tables`` fits in one pass against passes of their own; returns the speed-ups by CPU."""
    from brdfatlas.rendering.bsdf import reflectance_of
    from brdfatlas.rendering.integrator import render_batches, set_up, share_lanes

    measured, definitions, ratios = read_merl(file), read_scenes(), []
    reference, bandwidth = reflectance_of(measured), copy_bandwidth()
    fits = [measured.table * np.float32(1 + 0.02 * n) for n in range(tables)]
    groups = {
        "one": [measured.table],
        "all, MERL grid": [measured.table, *fits],
        "all, full circle": [measured.table, *fits[1:], np.concatenate([fits[0], fits[0]], 2)],
    }
    print(f"\n{file.stem}, {samples} samples; a plain copy moves {bandwidth / 1e9:.1f} GB/s")
    print("scene            tables               first s  wall s   CPU s  faster   M paths  G gathers  GB/s  of copy")
    for name in scenes:
        setup = set_up(prepare_scene(name, definitions[name], SIZE))
        lanes = share_lanes(setup, reference, samples, 2)
        single = 0.0
        for title, group in groups.items():
            reflectance = reference.with_tables(group)
            first, wall, cpu = thrice(partial(render_batches, setup, reflectance, samples, BATCHES, 1, lanes))
            single = single or cpu
            faster = single * len(group) / cpu
            paths = int(lanes.sum()) * samples
            gathers, width = 4 * paths, 4 * max(4, 3 * reflectance.size)
            rate = gathers * width / wall
            times = f"{first:8.2f} {wall:7.2f} {cpu:7.2f} {faster:6.1f}x"
            counts = f"{paths / 1e6:9.1f} {gathers / 1e9:10.2f} {rate / 1e9:5.1f} {rate / bandwidth:8.2f}"
            print(f"{name:16} {title:16} {len(group):3} {times} {counts}", flush=True)
            if len(group) > 1:
                ratios.append(faster)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024**2
    print(f"(asked: 2.5x on spheres, 6x on statues, 3 GB; peak of all that this process ran {peak:.2f} GB)")
    return ratios


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
                lanes = share_lanes(setup, reflectance, SAMPLES, 2)
                return render_batches(setup, reflectance, SAMPLES, BATCHES, 1, lanes)[0]

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
    return ratios + shared_paths(files[0], ("studio_sphere", "overcast_statue"))


if __name__ == "__main__":
    main([Path(name) for name in sys.argv[1:]])
