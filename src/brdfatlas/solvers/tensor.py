"""Sums of rank-one terms: the higher-order power iteration with missing data, and what evaluates its result."""

import numpy as np

from brdfatlas.compiled import njit


@njit(cache=True, nogil=True)
def _weighted_square(residual, weight):
    total = 0.0
    for i in range(residual.shape[0]):
        for j in range(residual.shape[1]):
            for k in range(residual.shape[2]):
                total += weight[i, j, k] * residual[i, j, k] ** 2
    return total


@njit(cache=True, nogil=True)
def _normalise(vector):
    norm = np.sqrt((vector * vector).sum())
    if norm > 0:
        vector /= norm
    return norm


@njit(cache=True, nogil=True)
def power_iteration(residual, weight, a, b, c, max_iterations, tolerance):
    """Best rank-one approximation scale · a ⊗ b ⊗ c of ``residual`` under ``weight``, from the starting vectors.

    Each step solves one vector by weighted least squares with the other two held, which for equal weights is the
    higher-order power iteration (De Lathauwer et al. 2000); weight 0 marks a missing entry. a, b, c are changed in
    place to unit vectors. Returns (scale, gain, iterations): gain is by how much the weighted square fell.
    """
    n_a, n_b, n_c = residual.shape
    _normalise(b)
    _normalise(c)
    scale, gain = 0.0, 0.0
    # an entry that nearly no data touch would be a quotient of two tiny numbers
    ridge = 1e-9 * weight.max()
    for iteration in range(max_iterations):
        numerator, denominator = np.zeros(n_a), np.full(n_a, ridge)
        for i in range(n_a):
            for j in range(n_b):
                for k in range(n_c):
                    w = weight[i, j, k]
                    v = b[j] * c[k]
                    numerator[i] += w * residual[i, j, k] * v
                    denominator[i] += w * v * v
        a[:] = numerator / denominator
        _normalise(a)
        numerator, denominator = np.zeros(n_b), np.full(n_b, ridge)
        for i in range(n_a):
            for j in range(n_b):
                for k in range(n_c):
                    w = weight[i, j, k]
                    v = a[i] * c[k]
                    numerator[j] += w * residual[i, j, k] * v
                    denominator[j] += w * v * v
        b[:] = numerator / denominator
        _normalise(b)
        numerator, denominator = np.zeros(n_c), np.full(n_c, ridge)
        for i in range(n_a):
            for j in range(n_b):
                v = a[i] * b[j]
                for k in range(n_c):
                    w = weight[i, j, k]
                    numerator[k] += w * residual[i, j, k] * v
                    denominator[k] += w * v * v
        c[:] = numerator / denominator
        # |residual|^2 - |residual - a b c|^2, from the normal equations of the last step
        previous, gain = gain, 0.0
        for k in range(n_c):
            gain += 2 * numerator[k] * c[k] - (denominator[k] - ridge) * c[k] ** 2
        scale = _normalise(c)
        if gain - previous <= tolerance * gain:
            return scale, gain, iteration + 1
    return scale, gain, max_iterations


@njit(cache=True, nogil=True)
def _subtract(residual, scale, a, b, c):
    for i in range(a.size):
        for j in range(b.size):
            v = scale * a[i] * b[j]
            for k in range(c.size):
                residual[i, j, k] -= v * c[k]


def _starts(residual: np.ndarray, weight: np.ndarray) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Two starts: constant vectors, and the three fibres through the entry with the largest weighted square."""
    i, j, k = np.unravel_index(np.argmax(weight * residual**2), residual.shape)
    fibres = tuple(
        np.where(w > 0, r, 0.0)
        for r, w in (
            (residual[:, j, k], weight[:, j, k]),
            (residual[i, :, k], weight[i, :, k]),
            (residual[i, j, :], weight[i, j, :]),
        )
    )
    constant = tuple(np.ones(n) for n in residual.shape)
    return [constant, fibres]  # type: ignore[list-item]


def residual_terms(
    tensor: np.ndarray, weight: np.ndarray, terms: int, *, max_iterations: int = 60, tolerance: float = 1e-4
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, list[float]]:
    """Rank-one terms fitted one after the other, each to what the ones before leave over.

    ``tensor``, ``weight``: (n_a, n_b, n_c), weight >= 0, 0 = missing. Returns scale (terms,), a (terms, n_a),
    b (terms, n_b), c (terms, n_c) with unit rows, and the weighted square of the residual after 0, 1, ... terms,
    which never rises. Deterministic. A term that would gain nothing is zero.
    """
    residual = np.ascontiguousarray(tensor, float).copy()
    weight = np.ascontiguousarray(weight, float)
    residual[weight == 0] = 0.0
    history = [_weighted_square(residual, weight)]
    scale = np.zeros(terms)
    factors = tuple(np.zeros((terms, n)) for n in residual.shape)
    for term in range(terms):
        best_gain = 0.0
        for a, b, c in _starts(residual, weight):
            size, gain, _ = power_iteration(residual, weight, a, b, c, max_iterations, tolerance)
            if np.isfinite(size) and gain > best_gain * (1 + 1e-9):
                best_gain, scale[term] = gain, size
                factors[0][term], factors[1][term], factors[2][term] = a, b, c
        _subtract(residual, scale[term], factors[0][term], factors[1][term], factors[2][term])
        history.append(_weighted_square(residual, weight))
    return scale, *factors, history


@njit(cache=True, nogil=True)
def _blend(row, position):
    """Linear interpolation of a vector at a position in units of its entries."""
    n = row.size
    if n == 1:
        return row[0]
    i = min(int(position), n - 2)
    t = position - i
    return row[i] + t * (row[i + 1] - row[i])


@njit(cache=True, nogil=True)
def sum_terms(scale, a, b, c, x, y, z, out):
    """out[s, channel] = sum over terms of scale · a(x) b(y) c(z), every factor interpolated linearly.

    scale (channels, terms), a, b, c (channels, terms, n); x, y, z (samples,) positions in units of entries.
    """
    for s in range(x.size):
        for channel in range(scale.shape[0]):
            total = 0.0
            for t in range(scale.shape[1]):
                total += (
                    scale[channel, t]
                    * _blend(a[channel, t], x[s])
                    * _blend(b[channel, t], y[s])
                    * _blend(c[channel, t], z[s])
                )
            out[s, channel] = total


@njit(cache=True, nogil=True)
def bilinear_rows(tensor, y, z, out):
    """out[h, s, channel] = tensor[h] interpolated bilinearly at (y, z)[h, s]; tensor (h, n_y, n_z, channels)."""
    n_y, n_z, channels = tensor.shape[1:]
    for h in range(tensor.shape[0]):
        for s in range(y.shape[1]):
            j, k = min(int(y[h, s]), n_y - 2), min(int(z[h, s]), n_z - 2)
            u, v = y[h, s] - j, z[h, s] - k
            for channel in range(channels):
                out[h, s, channel] = (1 - u) * (
                    (1 - v) * tensor[h, j, k, channel] + v * tensor[h, j, k + 1, channel]
                ) + u * ((1 - v) * tensor[h, j + 1, k, channel] + v * tensor[h, j + 1, k + 1, channel])
