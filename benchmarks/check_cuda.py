"""The built-in scenes on a GPU (cuda_ad_rgb) against llvm_ad_rgb: a z-test of every pixel, and times.

    python benchmarks/check_cuda.py [FILE.binary] [--tables 21] [--size 256] [--samples 512]

For each scene, rendered with other random numbers on either side: the largest |z| of all pixels and channels against
the value that independent tests exceed with a probability of 1 % (Šidák, with a margin of 1.3 for Student's tails), and
the means of all light. Then the pictures of one seed, which differ by rounding where no path goes another way. Exits
with 1 if a test fails, with 2 where there is no usable GPU.
"""

import argparse
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from scipy.stats import norm

from brdfatlas import read_merl
from brdfatlas.constants import REFERENCE
from brdfatlas.measured import Measured
from brdfatlas.rendering import use_variant
from brdfatlas.rendering.images import Render
from brdfatlas.rendering.jobs import render_models
from brdfatlas.rendering.scenes import PreparedScene, prepare_scene, read_scenes

BATCHES, SAMPLES, SIZE = 24, 24 * 32, 96


def pictures(variant: str, scene: PreparedScene, measured: Measured, seed: int) -> dict[str, Render]:
    """The reference, and a darker table on the full circle, by one variant."""
    use_variant(variant)
    darker = np.concatenate([measured.table, 0.5 * measured.table], 2)
    tables = {REFERENCE: None, "darker": darker}
    return render_models(scene, measured, tables, samples=SAMPLES, batches=BATCHES, seed=seed)


def compare(name: str, one: Render, other: Render) -> bool:
    """Print the z-test of two renders with independent noise; whether it passes."""
    a, b = (render.batches[:, render.mask].astype(float) for render in (one, other))
    error = np.sqrt(np.maximum((a.var(0, ddof=1) + b.var(0, ddof=1)) / BATCHES, 1e-12))
    z = (a.mean(0) - b.mean(0)) / error
    limit = 1.3 * norm.isf(0.5 * (1 - 0.99 ** (1 / z.size)))
    drift = a.mean() / b.mean() - 1
    passed = bool(abs(z).max() < limit and abs(drift) < 0.01)
    verdict = "ok" if passed else "DIFFERS"
    print(
        f"{name:28} max |z| {abs(z).max():5.2f} of {limit:4.2f}, mean z {z.mean():+.3f}, light {drift:+.4%}: {verdict}"
    )
    return passed


def timed(variant: str, scene: PreparedScene, measured: Measured, count: int, samples: int) -> tuple[float, float]:
    """Seconds of a first call, which compiles, and of the best of two later ones."""
    use_variant(variant)
    tables = {f"m{n}": measured.table * (1 + 0.01 * n) for n in range(count)}
    seconds = []
    for _ in range(3):
        start = time.perf_counter()
        render_models(scene, measured, {REFERENCE: None} | tables, samples=samples)
        seconds.append(time.perf_counter() - start)
    return seconds[0], min(seconds[1:])


def main(arguments: list[str] | None = None) -> int:
    """Run the check; the exit status."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("file", nargs="?", help="a MERL file; by default a stand-in is made")
    parser.add_argument("--tables", type=int, default=21)
    parser.add_argument("--size", type=int, default=256)
    parser.add_argument("--samples", type=int, default=512)
    args = parser.parse_args(arguments)
    try:
        use_variant("cuda_ad_rgb")
        import drjit as dr

        dr.eval(dr.cuda.Float([1.0]) + 1)
    except Exception as error:
        print(f"no usable GPU: {str(error).splitlines()[0]}", file=sys.stderr)
        return 2
    with tempfile.TemporaryDirectory() as folder:
        path = Path(args.file or Path(folder) / "alum-bronze.binary")
        if not args.file:
            from brdfatlas.pipeline.standins import write_standin

            write_standin(path.stem, path)
        measured = read_merl(path)
    passed, definitions = True, read_scenes()
    for name, definition in definitions.items():
        use_variant("llvm_ad_rgb")
        scene = prepare_scene(name, definition, SIZE)
        llvm, gpu = (pictures(v, scene, measured, seed) for v, seed in (("llvm_ad_rgb", 1), ("cuda_ad_rgb", 2)))
        for item in llvm:
            passed &= compare(f"{name}, {item}", llvm[item], gpu[item])
        same = pictures("cuda_ad_rgb", scene, measured, 1)[REFERENCE]
        apart = np.abs(same.mean - llvm[REFERENCE].mean)[scene.mask] / np.maximum(
            llvm[REFERENCE].mean[scene.mask], 1e-3
        )
        print(f"{'':28} one seed: relative difference median {np.median(apart):.1e}, largest {apart.max():.1e}")
    for name, definition in definitions.items():
        use_variant("llvm_ad_rgb")
        scene = prepare_scene(name, definition, args.size)
        for variant in ("llvm_ad_rgb", "cuda_ad_rgb"):
            first, best = timed(variant, scene, measured, args.tables, args.samples)
            each = best / (args.tables + 1)
            pictures_of = f"{name:18} {variant:12} {args.tables + 1} pictures"
            print(f"{pictures_of} {best:7.2f} s, {each:.3f} s each, first {first:.2f} s")
    return 0 if passed else 1


if __name__ == "__main__":
    sys.exit(main())
