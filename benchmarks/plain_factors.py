"""The iteration of Bagher et al. 2016 written out in NumPy, sample by sample: slow, and independent of the package's
solvers. The benchmark measures against it; the tests check the compiled passes with it.

One channel; every array is over the samples with weight > 0: ``h``, ``d``, ``p`` cells, ``w`` weight, ``rho`` value.
"""

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter1d

CLAMP = 1e-6
GOLDEN = (np.sqrt(5) - 1) / 2


@dataclass
class Samples:
    """One channel of a table (90, 90, 180) with its weights, flat."""

    w: np.ndarray
    rho: np.ndarray

    def __post_init__(self):
        keep = self.w > 0
        self.h, self.d, self.p = np.nonzero(keep)
        theta_h, theta_d = ((self.h + 0.5) / 90) ** 2 * np.pi / 2, (self.d + 0.5) / 180 * np.pi
        phi_d = (self.p + 0.5) / 180 * np.pi
        middle, swing = np.cos(theta_h) * np.cos(theta_d), np.sin(theta_h) * np.sin(theta_d) * np.cos(phi_d)
        self.w, self.rho = self.w[keep].astype(float), self.rho[keep].astype(float)
        nodes = np.cos(np.linspace(0, np.pi / 2, 90))
        nodes[-1] = 0
        self.at = []
        self.q = np.ones(self.w.size)
        for cosine in (middle - swing, middle + swing):
            x = np.arccos(np.clip(cosine, 0, 1)) / (np.pi / 2) * 89
            k = np.minimum(x.astype(int), 88)
            self.at.append((k, x - k))
            self.q /= (1 - (x - k)) * nodes[k] + (x - k) * nodes[k + 1]
        self.power = float((self.w * self.rho**2).sum())


@dataclass
class Factors:
    """D, F and G (independent-G) or H (naive), rho_d, rho_s, the objective, golden-section calls so far."""

    d: np.ndarray
    f: np.ndarray
    g: np.ndarray
    rho_d: float
    rho_s: float
    objective: float = np.inf
    golden: int = 0


def at_nodes(g, place):
    k, t = place
    return (1 - t) * g[k] + t * g[k + 1]


def shape(s: Samples, d, f, g, naive: bool):
    """The part of the model that rho_s multiplies."""
    around = g[s.p] if naive else at_nodes(g, s.at[0]) * at_nodes(g, s.at[1]) * s.q
    return d[s.h] * f[s.d] * around


def objective(s: Samples, d, f, g, rho_d, rho_s, naive):
    return float((s.w * (rho_d + rho_s * shape(s, d, f, g, naive) - s.rho) ** 2).sum())


def quotient(index, y, z, w, old):
    n = old.size
    top, bottom = np.bincount(index, w * y * z, n), np.bincount(index, w * y * y, n)
    good = bottom > 1e-14 * bottom.max()
    return np.where(good, top / np.where(good, bottom, 1), old)


def scalars(s: Samples, x):
    """Cramer's rule, Eqs. 16 - 18."""
    w, wr = s.w.sum(), (s.w * s.rho).sum()
    s1, s2, r1 = (s.w * x).sum(), (s.w * x * x).sum(), (s.w * x * s.rho).sum()
    determinant = w * s2 - s1 * s1
    a, b = (wr * s2 - s1 * r1) / determinant, (w * r1 - s1 * wr) / determinant
    return (0.0, r1 / s2) if a < 0 else (a, b)


def normal(values, clamp):
    return np.maximum(values, clamp * values.max()) / values.max(), values.max()


def solve_g(s: Samples, g, base, z, place, other):
    """One of the two G with the other held: Eq. 14 with the samples shared between the two nodes of their interval."""
    y = base * at_nodes(g, other)
    k, t = place
    top = np.bincount(k, s.w * (1 - t) * y * z, 90) + np.bincount(k + 1, s.w * t * y * z, 90)
    bottom = np.bincount(k, s.w * (1 - t) * y * y, 90) + np.bincount(k + 1, s.w * t * y * y, 90)
    good = bottom > 1e-14 * bottom.max()
    return np.where(good, top / np.where(good, bottom, 1), g)


def iterate(s: Samples, x: Factors, *, naive=False, smoothing=1.0, repetitions=20, tolerance=1e-4) -> Factors:
    """One iteration: D, F, G (or H), then rho_d and rho_s."""
    clamp = 0.0 if naive else CLAMP
    d, f, g, rho_d, rho_s, golden = x.d, x.f, x.g, x.rho_d, x.rho_s, x.golden
    z = s.rho - rho_d
    around = shape(s, np.ones(90), np.ones(90), g, naive)
    d, scale = normal(quotient(s.h, rho_s * f[s.d] * around, z, s.w, d), clamp)
    rho_s *= scale
    f, scale = normal(quotient(s.d, rho_s * d[s.h] * around, z, s.w, f), clamp)
    rho_s *= scale
    if naive:
        g, scale = normal(quotient(s.p, rho_s * d[s.h] * f[s.d], z, s.w, g), clamp)
    else:
        value = objective(s, d, f, g, rho_d, rho_s, False)
        base = rho_s * d[s.h] * f[s.d] * s.q
        for repetition in range(repetitions):
            mean = 0.5 * (solve_g(s, g, base, z, *s.at) + solve_g(s, g, base, z, *s.at[::-1]))
            trial = gaussian_filter1d(mean, smoothing, mode="nearest", truncate=4.0) if smoothing else mean
            trial = np.maximum(trial, clamp * trial.max())
            new = objective(s, d, f, trial, rho_d, rho_s, False)
            if new < value:
                done = value - new < tolerance * value
                g, value = trial, new
                if done:
                    break
                continue
            if repetition == 0:
                golden += 1
                g, value = line_search(s, d, f, g, trial, rho_d, rho_s, value)
            break
        g, scale = normal(g, clamp)
    part = shape(s, d, f, g, naive)
    rho_d, rho_s = scalars(s, part)
    return Factors(d, f, g, rho_d, rho_s, objective(s, d, f, g, rho_d, rho_s, naive), golden)


def line_search(s, d, f, old, new, rho_d, rho_s, value):
    a, b = 0.0, 1.0
    at = lambda x: objective(s, d, f, old + x * (new - old), rho_d, rho_s, False)  # noqa: E731
    x1, x2 = b - GOLDEN * (b - a), a + GOLDEN * (b - a)
    f1, f2 = at(x1), at(x2)
    while b - a > 1e-3:
        if f1 < f2:
            b, x2, f2 = x2, x1, f1
            x1 = b - GOLDEN * (b - a)
            f1 = at(x1)
        else:
            a, x1, f1 = x1, x2, f2
            x2 = a + GOLDEN * (b - a)
            f2 = at(x2)
    x, best = (x1, f1) if f1 < f2 else (x2, f2)
    return (old + x * (new - old), best) if best < value else (old, value)


def slices(s: Samples) -> tuple[np.ndarray, np.ndarray]:
    """D from theta_d = 0 and F from theta_h = 0 as weighted means, largest component 1."""
    w = np.bincount(s.h * 90 + s.d, s.w, 8100).reshape(90, 90)
    wr = np.bincount(s.h * 90 + s.d, s.w * s.rho, 8100).reshape(90, 90)
    table = np.where(w > 0, wr / np.where(w > 0, w, 1), 0)
    d, f = table[:, 0], table[0]
    return np.maximum(d / d.max(), CLAMP), np.maximum(f / f.max(), CLAMP)


def start(s: Samples, d, f, *, naive=False) -> Factors:
    """A start with G or H constant and the best rho_d and rho_s."""
    g = np.ones(180 if naive else 90)
    rho_d, rho_s = scalars(s, shape(s, d, f, g, naive))
    return Factors(d, f, g, rho_d, rho_s, objective(s, d, f, g, rho_d, rho_s, naive))
