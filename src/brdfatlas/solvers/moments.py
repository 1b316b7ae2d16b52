"""Exact inner products on the MERL grid from sums over phi_d.

Where a model is  f = a_0 + a_1 sum_k A_k(theta_h, theta_d; x) g_k(theta_h, theta_d, phi_d)  with g_k free of
parameters, every weighted inner product over the million samples needs of phi_d only the sums of w g_k g_l and
w rho g_k, once. A step of a fit then costs a pass over 8,100 cells instead. No sample is dropped or averaged: the
numbers are those of the full sum.

:class:`CellMoments` serves a weighted sum of squares (Bagher 2016's compressive metric, Ngan's), as moments of a
``SeparableProblem`` of ``solvers.least_squares``. :class:`LogCells` serves Löw's E2, squared differences of
ln(1 + rho cos theta_i), where the sums change with the model and take a pass over the samples at every step.
"""

from collections.abc import Sequence

import numpy as np

from brdfatlas.compiled import njit
from brdfatlas.solvers.least_squares import Moments


@njit(cache=True, nogil=True)
def _accumulate(weights, target, factors, between, cross, power):
    cells, n_phi, channels = weights.shape
    count = factors.shape[0] + 1
    g = np.empty(count)
    g[0] = 1.0
    for i in range(cells):
        for p in range(n_phi):
            for k in range(count - 1):
                g[k + 1] = factors[k, i, p]
            for c in range(channels):
                w = weights[i, p, c]
                if w > 0.0:
                    rho = target[i, p, c]
                    power[c] += w * rho * rho
                    for k in range(count):
                        wg = w * g[k]
                        cross[c, k, i] += wg * rho
                        for m in range(k + 1):
                            between[c, k, m, i] += wg * g[m]


def _product(a: np.ndarray, b: np.ndarray, width: int = 300) -> np.ndarray:
    """a @ b.T of two long flat matrices, in pieces so small that BLAS starts no threads: a fit uses one core."""
    if a.shape[1] % width:
        return a @ b.T
    a, b = (m.reshape(m.shape[0], -1, width).transpose(1, 0, 2) for m in (a, b))
    return np.matmul(a, b.transpose(0, 2, 1)).sum(0)


class CellMoments:
    """Sums over phi_d of a weighted material, and the moments of any columns made of amplitudes times ``factors``.

    ``weights``, ``target``: (..., n_phi, C); what has weight 0 may be NaN. ``factors``: K arrays (..., n_phi).
    """

    def __init__(self, weights: np.ndarray, target: np.ndarray, factors: Sequence[np.ndarray]) -> None:
        n_phi, channels = target.shape[-2:]
        weights, target = weights.reshape(-1, n_phi, channels), target.reshape(-1, n_phi, channels)
        stacked = np.stack([np.broadcast_to(g, (*g.shape[:-1], n_phi)).reshape(-1, n_phi) for g in factors])
        count, cells = len(factors) + 1, target.shape[0]
        between = np.zeros((channels, count, count, cells))
        cross = np.zeros((channels, count, cells))
        self.power = np.zeros(channels)
        _accumulate(weights, target, stacked, between, cross, self.power)
        for k in range(count):
            for m in range(k):
                between[:, m, k] = between[:, k, m]
        self.between, self.cross = between, cross
        self.constant = between[:, 0, 0].sum(-1)
        self.constant_cross = cross[:, 0].sum(-1)

    def moments(self, columns: np.ndarray) -> Moments:
        """Of the columns [1, sum_k columns[0, k] g_k, sum_k columns[1, k] g_k, ...]; columns (q - 1, K, ...cells)."""
        count, n_factors = columns.shape[:2]
        columns = columns.reshape(count, n_factors, -1)
        channels = self.power.size
        gram, cross = np.empty((channels, count + 1, count + 1)), np.empty((channels, count + 1))
        flat = columns.reshape(count, -1)
        for c in range(channels):
            inner = self.between[c, 1:, 1:]
            if n_factors == 1:
                weighted = columns[:, 0] * inner[0, 0]
            else:
                weighted = np.einsum("qkn,kmn->qmn", columns, inner).reshape(count, -1)
            gram[c, 1:, 1:] = _product(weighted, flat)
            sums = _product(flat, np.stack([self.between[c, 0, 1:].ravel(), self.cross[c, 1:].ravel()]))
            gram[c, 0, 0], cross[c, 0] = self.constant[c], self.constant_cross[c]
            gram[c, 0, 1:] = gram[c, 1:, 0] = sums[:, 0]
            cross[c, 1:] = sums[:, 1]
        return Moments(gram, cross, self.power)


@njit(cache=True, nogil=True)
def _log_pass(stored, weights, cosine, factors, amplitude, a, sums, between, cross):
    """Adds up w (ln(1 + f c) - stored)^2, and over phi_d w u^2 g g and w u r g with u = d ln(1 + f c) / df."""
    cells, n_phi, channels = stored.shape
    count = factors.shape[0] + 1
    want = between.size > 0
    g = np.empty(count)
    g[0] = 1.0
    for i in range(cells):
        for p in range(n_phi):
            w = weights[i, p]
            if not w > 0.0:
                continue
            specular = 0.0
            for k in range(count - 1):
                g[k + 1] = factors[k, i, p]
                specular += amplitude[k, i] * g[k + 1]
            cos = cosine[i, p]
            for c in range(channels):
                value = 1.0 + (a[c, 0] + a[c, 1] * specular) * cos
                r = np.log(value) - stored[i, p, c]
                sums[c] += w * r * r
                if want:
                    u = cos / value
                    for k in range(count):
                        cross[c, k, i] += w * u * r * g[k]
                        ug = w * u * u * g[k]
                        for m in range(k + 1):
                            between[c, k, m, i] += ug * g[m]


class LogCells:
    """Löw's E2 of f = a_c0 + a_c1 sum_k A_k g_k against a material: value and normal equations.

    ``target`` (..., n_phi, C) in 1/sr; ``weights`` (..., n_phi), 0 for what is left out; ``cosine`` cos theta_i,
    ``factors`` as in :class:`CellMoments`. The value is the weighted mean of the squares, summed over the channels
    (``objectives.loew_e2``).
    """

    def __init__(self, target, weights, cosine, factors: Sequence[np.ndarray]) -> None:
        n_phi, channels = target.shape[-2:]
        self.channels = channels
        cosine = np.ascontiguousarray(cosine, np.float32).reshape(-1, n_phi)
        keep = weights > 0
        stored = np.zeros(target.shape, np.float32)
        stored[keep] = np.log1p(np.maximum(target[keep] * cosine.reshape(keep.shape)[keep][:, None], 0))
        self.stored, self.cosine = stored.reshape(-1, n_phi, channels), cosine
        self.factors = np.stack([np.broadcast_to(g, keep.shape).reshape(-1, n_phi) for g in factors])
        self.weights = np.ascontiguousarray(weights / weights.sum(), float).reshape(-1, n_phi)

    def value(self, amplitude: np.ndarray, a: np.ndarray) -> float:
        """E2 of the amplitudes (K, ...cells) and the linear parameters a (C, 2)."""
        sums = np.zeros(self.channels)
        amplitude = np.ascontiguousarray(amplitude).reshape(len(self.factors), -1)
        empty = np.empty((0, 0, 0, 0))
        nothing = np.empty((0, 0, 0))
        _log_pass(self.stored, self.weights, self.cosine, self.factors, amplitude, a, sums, empty, nothing)
        return float(sums.sum())

    def normal_equations(self, columns: np.ndarray, a: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
        """value, J^T r and J^T J by [x_0 .. x_{P-1}, a_00, a_01, a_10, ...].

        ``columns`` (1 + P, K, ...cells): the amplitudes and their derivatives by each x.
        """
        count, n_factors = columns.shape[:2]
        columns = np.ascontiguousarray(columns).reshape(count, n_factors, -1)
        cells, n_x = columns.shape[-1], count - 1
        sums = np.zeros(self.channels)
        between = np.zeros((self.channels, n_factors + 1, n_factors + 1, cells))
        cross = np.zeros((self.channels, n_factors + 1, cells))
        _log_pass(self.stored, self.weights, self.cosine, self.factors, columns[0], a, sums, between, cross)
        size = n_x + 2 * self.channels
        gradient, matrix = np.zeros(size), np.zeros((size, size))
        for c in range(self.channels):
            for k in range(n_factors + 1):
                for m in range(k):
                    between[c, m, k] = between[c, k, m]
            weighted = np.einsum("qkn,kmn->qmn", columns, between[c, 1:, 1:]).reshape(count, -1)
            flat = columns.reshape(count, -1)
            gram = np.empty((count + 1, count + 1))
            gram[1:, 1:] = _product(weighted, flat)
            projected = _product(flat, np.stack([between[c, 0, 1:].ravel(), cross[c, 1:].ravel()]))
            gram[0, 0] = between[c, 0, 0].sum()
            gram[0, 1:] = gram[1:, 0] = projected[:, 0]
            slope = np.concatenate([[cross[c, 0].sum()], projected[:, 1]])
            # columns of J: x_j -> a_1 dA/dx_j, a_0 -> 1, a_1 -> A
            combine = np.zeros((size, count + 1))
            combine[np.arange(n_x), 2 + np.arange(n_x)] = a[c, 1]
            combine[n_x + 2 * c, 0] = combine[n_x + 2 * c + 1, 1] = 1.0
            gradient += combine @ slope
            matrix += combine @ gram @ combine.T
        return float(sums.sum()), gradient, matrix
