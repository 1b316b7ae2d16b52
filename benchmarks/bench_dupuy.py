"""Time from file to fit of the three models of Dupuy et al. 2015 on one material, warm, one core.

    python benchmarks/bench_dupuy.py [FILE.binary ...]

Asked: all three <= 0.3 s. CPU seconds, the median of 5. The yardstick in the same run is the same Fresnel average
written as whole-array numpy, since most of the time goes there.
"""

import statistics
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from brdfatlas import microfacet, read_merl
from brdfatlas.angles import above_horizon, grid_axes, grid_cosines
from brdfatlas.fits import fit
from brdfatlas.formats.merl import write_merl
from brdfatlas.models.dupuy2015 import power_iteration

MODELS = ("tabulated", "gaussian", "ggx")


def synthetic(path: Path) -> Path:
    """A GGX surface of roughness 0.2 as a MERL file."""
    theta_h, theta_d, _ = grid_axes()
    cos_i, cos_o = (np.maximum(c, 1e-6) for c in grid_cosines())
    g = microfacet.smith_g(microfacet.ggx_g1(cos_i, 0.2), microfacet.ggx_g1(cos_o, 0.2))
    f = microfacet.ggx_ndf(np.cos(theta_h), 0.2) * microfacet.schlick(np.cos(theta_d), 0.05) * g / (4 * cos_i * cos_o)
    write_merl(path, np.where(above_horizon()[..., None], np.repeat(f[..., None], 3, -1), np.nan))
    return path


def plain_fresnel(table: np.ndarray, ndf: np.ndarray) -> np.ndarray:
    """power_iteration.fresnel_corrected without compiled code."""
    cos_i, cos_o = grid_cosines()
    theta_h, theta_d, _ = grid_axes()
    sigma = microfacet.smith_sigma(ndf)
    g = microfacet.smith_g(microfacet.smith_g1(sigma, cos_i), microfacet.smith_g1(sigma, cos_o))
    with np.errstate(all="ignore"):
        ideal = ndf[:, None, None] * g / (4 * cos_i * cos_o)
        keep = (ideal > power_iteration.MIN_IDEAL) & (theta_h < np.pi / 2 - theta_d) & (table[..., 0] >= 0)
        ratio = np.where(keep[..., None], table / ideal[..., None], 0)
    return np.clip(ratio.sum((0, 2)) / keep.sum((0, 2))[:, None], 0, 1)


def seconds(function, repeats: int = 5) -> float:
    """Median CPU time of this thread, after one warm call."""
    function()
    times = []
    for _ in range(repeats):
        start = time.thread_time()
        function()
        times.append(time.thread_time() - start)
    return statistics.median(times)


def main(paths: list[Path]) -> None:
    for path in paths:
        measured = read_merl(path)
        ndf = power_iteration.distribution(power_iteration.retro_slice(measured.table)[0])[0]
        reading = seconds(lambda path=path: read_merl(path))
        fits = {model: seconds(lambda model=model, m=measured: fit(model, m)) for model in MODELS}
        compiled = seconds(lambda m=measured, d=ndf: power_iteration.fresnel_corrected(m.table, d))
        plain = seconds(lambda m=measured, d=ndf: plain_fresnel(m.table, d))
        each = ", ".join(f"{model} {value:.3f} s" for model, value in fits.items())
        total = reading + sum(fits.values())
        print(f"dupuy {path.stem}: file to three fits {total:.3f} s CPU (asked 0.3): read {reading:.3f} s, {each}")
        print(f"dupuy {path.stem}: Fresnel {compiled:.4f} s, plain numpy {plain:.4f} s, ratio {plain / compiled:.1f}")


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        main([Path(p) for p in sys.argv[1:]] or [synthetic(Path(folder) / "ggx-0.2.binary")])
