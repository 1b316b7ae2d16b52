"""Weighted non-negative factorization of scattered rgb samples by multiplicative updates.

    y[h, s, c] ~ sum_j F_j(z[h, s], c) sum_k U_jk[h] V_jk(y[h, s])

The samples of row h share the node h of U; V and F are interpolated linearly between their nodes. All is non-negative.
With equal weights on a full grid this is the non-negative matrix factorization of Lee and Seung 2000, with the
columns of one matrix factored again as in Lawrence et al. 2004; weight 0 marks missing data.
"""

from dataclasses import dataclass

import numpy as np

from brdfatlas.compiled import njit

TINY = 1e-300


@dataclass(frozen=True)
class Samples:
    """``value``, ``weight`` (rows, samples, 3), weight >= 0; ``v_position``, ``f_position`` (rows, samples) in units of
    nodes, within 0 .. n - 1; ``n_v``, ``n_f`` the numbers of nodes (at least 2)."""

    value: np.ndarray
    weight: np.ndarray
    v_position: np.ndarray
    f_position: np.ndarray
    n_v: int
    n_f: int

    def thinned(self, step: int) -> "Samples":
        """Every ``step``-th sample of each row, for choosing a start."""
        arrays = (self.value, self.weight, self.v_position, self.f_position)
        return Samples(*(np.ascontiguousarray(a[:, ::step]) for a in arrays), self.n_v, self.n_f)


@dataclass
class Factors:
    """u (rows, J K), v (n_v, J K), f (n_f, 3, J); column j K + k of u and v belongs to column j of f."""

    u: np.ndarray
    v: np.ndarray
    f: np.ndarray

    def copy(self) -> "Factors":
        return Factors(self.u.copy(), self.v.copy(), self.f.copy())


@njit(cache=True, nogil=True)
def _multiply(x, gram, right, steps):
    """``steps`` multiplicative updates x <- x right / (gram x) of min x G x - 2 r x, x >= 0; none raises it."""
    for _ in range(steps):
        product = gram @ x
        for i in range(x.size):
            x[i] = x[i] * right[i] / max(product[i], TINY)


@njit(cache=True, nogil=True)
def _update_u(value, weight, v_position, f_position, u, v, f, steps):
    n_terms, n_outer = u.shape[1], f.shape[2]
    n_inner = n_terms // n_outer
    q = np.empty((3, n_terms))
    for h in range(value.shape[0]):
        gram, right = np.zeros((n_terms, n_terms)), np.zeros(n_terms)
        for s in range(value.shape[1]):
            if weight[h, s, 0] + weight[h, s, 1] + weight[h, s, 2] == 0:
                continue
            j = min(int(v_position[h, s]), v.shape[0] - 2)
            t = v_position[h, s] - j
            k = min(int(f_position[h, s]), f.shape[0] - 2)
            r = f_position[h, s] - k
            for a in range(n_terms):
                along = v[j, a] + t * (v[j + 1, a] - v[j, a])
                for c in range(3):
                    b = a // n_inner
                    q[c, a] = along * (f[k, c, b] + r * (f[k + 1, c, b] - f[k, c, b]))
            for c in range(3):
                w, y = weight[h, s, c], value[h, s, c]
                for a in range(n_terms):
                    right[a] += w * y * q[c, a]
                    for b in range(a + 1):
                        gram[a, b] += w * q[c, a] * q[c, b]
        for a in range(n_terms):
            for b in range(a):
                gram[b, a] = gram[a, b]
        row = u[h].copy()
        _multiply(row, gram, right, steps)
        u[h] = row


@njit(cache=True, nogil=True)
def _update_v(value, weight, v_position, f_position, u, v, f, steps):
    n_terms, n_outer, n_v = u.shape[1], f.shape[2], v.shape[0]
    n_inner = n_terms // n_outer
    # blocks of one node with itself and with the next one; the rest is zero
    same, after = np.zeros((n_v, n_terms, n_terms)), np.zeros((n_v, n_terms, n_terms))
    right = np.zeros((n_v, n_terms))
    q = np.empty((3, n_terms))
    for h in range(value.shape[0]):
        for s in range(value.shape[1]):
            if weight[h, s, 0] + weight[h, s, 1] + weight[h, s, 2] == 0:
                continue
            j = min(int(v_position[h, s]), n_v - 2)
            t = v_position[h, s] - j
            k = min(int(f_position[h, s]), f.shape[0] - 2)
            r = f_position[h, s] - k
            for a in range(n_terms):
                b = a // n_inner
                for c in range(3):
                    q[c, a] = u[h, a] * (f[k, c, b] + r * (f[k + 1, c, b] - f[k, c, b]))
            for a in range(n_terms):
                linear = 0.0
                for c in range(3):
                    linear += weight[h, s, c] * value[h, s, c] * q[c, a]
                right[j, a] += (1 - t) * linear
                right[j + 1, a] += t * linear
                for b in range(n_terms):
                    square = 0.0
                    for c in range(3):
                        square += weight[h, s, c] * q[c, a] * q[c, b]
                    same[j, a, b] += (1 - t) * (1 - t) * square
                    same[j + 1, a, b] += t * t * square
                    after[j, a, b] += t * (1 - t) * square
    gram = np.zeros((n_v * n_terms, n_v * n_terms))
    for j in range(n_v):
        for a in range(n_terms):
            for b in range(n_terms):
                gram[j * n_terms + a, j * n_terms + b] = same[j, a, b]
                if j + 1 < n_v:
                    gram[j * n_terms + a, (j + 1) * n_terms + b] = after[j, a, b]
                    gram[(j + 1) * n_terms + a, j * n_terms + b] = after[j, b, a]
    x = v.copy().reshape(-1)
    _multiply(x, gram, right.reshape(-1), steps)
    v[:] = x.reshape(n_v, n_terms)


@njit(cache=True, nogil=True)
def _update_f(value, weight, v_position, f_position, u, v, f, steps):
    """Returns the weighted square error after the update, from the normal equations."""
    n_terms, n_outer, n_f = u.shape[1], f.shape[2], f.shape[0]
    n_inner = n_terms // n_outer
    same, after = np.zeros((3, n_f, n_outer, n_outer)), np.zeros((3, n_f, n_outer, n_outer))
    right = np.zeros((3, n_f, n_outer))
    power = np.zeros(3)
    q = np.empty(n_outer)
    for h in range(value.shape[0]):
        for s in range(value.shape[1]):
            if weight[h, s, 0] + weight[h, s, 1] + weight[h, s, 2] == 0:
                continue
            j = min(int(v_position[h, s]), v.shape[0] - 2)
            t = v_position[h, s] - j
            k = min(int(f_position[h, s]), n_f - 2)
            r = f_position[h, s] - k
            q[:] = 0.0
            for a in range(n_terms):
                q[a // n_inner] += u[h, a] * (v[j, a] + t * (v[j + 1, a] - v[j, a]))
            for c in range(3):
                w, y = weight[h, s, c], value[h, s, c]
                power[c] += w * y * y
                for a in range(n_outer):
                    linear = w * y * q[a]
                    right[c, k, a] += (1 - r) * linear
                    right[c, k + 1, a] += r * linear
                    for b in range(n_outer):
                        square = w * q[a] * q[b]
                        same[c, k, a, b] += (1 - r) * (1 - r) * square
                        same[c, k + 1, a, b] += r * r * square
                        after[c, k, a, b] += r * (1 - r) * square
    error = 0.0
    for c in range(3):
        gram = np.zeros((n_f * n_outer, n_f * n_outer))
        for k in range(n_f):
            for a in range(n_outer):
                for b in range(n_outer):
                    gram[k * n_outer + a, k * n_outer + b] = same[c, k, a, b]
                    if k + 1 < n_f:
                        gram[k * n_outer + a, (k + 1) * n_outer + b] = after[c, k, a, b]
                        gram[(k + 1) * n_outer + a, k * n_outer + b] = after[c, k, b, a]
        x = f[:, c].copy().reshape(-1)
        flat = right[c].copy().reshape(-1)
        _multiply(x, gram, flat, steps)
        f[:, c] = x.reshape(n_f, n_outer)
        error += power[c] - 2 * (x * flat).sum() + (x * (gram @ x)).sum()
    return error


def _balance(factors: Factors) -> None:
    """Scale every u and v to maximum 1 and put the size into f, where the inner terms leave that to be done."""
    inner = factors.u.shape[1] // factors.f.shape[2]
    peak_u, peak_v = np.maximum(factors.u.max(0), TINY), np.maximum(factors.v.max(0), TINY)
    factors.v /= peak_v
    if inner == 1:
        factors.u /= peak_u
        factors.f *= peak_u * peak_v
    else:
        factors.u *= peak_v
        peak = np.maximum(factors.u.reshape(len(factors.u), -1, inner).max((0, 2)), TINY)
        factors.u /= np.repeat(peak, inner)
        factors.f *= peak


def factorize(
    samples: Samples, start: Factors, *, max_iterations: int, tolerance: float = 1e-4, steps: int = 20
) -> tuple[Factors, list[float], bool]:
    """Multiplicative updates of u, v and f in turn from ``start``, ``steps`` of each on its exact normal equations.

    Returns the factors, the weighted square error after each iteration (it never rises beyond rounding) and whether its
    relative fall came below ``tolerance``. An entry that no sample with weight touches becomes 0.
    """
    factors = start.copy()
    data = (samples.value, samples.weight, samples.v_position, samples.f_position)
    history: list[float] = []
    for _ in range(max_iterations):
        _update_u(*data, factors.u, factors.v, factors.f, steps)
        _update_v(*data, factors.u, factors.v, factors.f, steps)
        history.append(float(max(_update_f(*data, factors.u, factors.v, factors.f, steps), 0.0)))
        _balance(factors)
        if len(history) > 1 and history[-2] - history[-1] <= tolerance * history[-2]:
            return factors, history, True
    return factors, history, False
