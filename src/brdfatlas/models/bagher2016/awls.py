"""Alternating weighted least squares for factor microfacet models (Bagher et al. 2016, sections 4.2 and 4.3).

The objective of one colour channel is sum_j w_j (f_j - rho_j)^2 with

    f = rho_d + M[h, d] G(theta_i) G(theta_o) / (cos theta_i cos theta_o),

where M is rho_s D F (independent-G, G-from-D), a free table (bivariate with G) or a sum of few products (low rank).
Three exact reductions make an iteration cheap; none changes the objective:

* These models do not change when theta_i and theta_o swap, so the cells phi_d and pi - phi_d see one value of f.
  Their weights and weighted values are added, which leaves half of the samples.
* With G fixed, the objective depends on M only through three 90 x 90 sums over phi_d (:func:`contract`).
* With M fixed, it depends on G only through 17 sums for each pair of G's intervals (:func:`collect`): G is piecewise
  linear, so G(theta_i) G(theta_o) is bilinear in four of its nodes inside such a pair.

So an update of D, F, rho_d, rho_s costs microseconds between two passes over the samples.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from brdfatlas.angles import N_PHI_D, N_THETA_D, N_THETA_H, grid_axes
from brdfatlas.compiled import njit

N_NODES = 90
N_CELLS_2D = N_THETA_H * N_THETA_D
#: The dynamic range of a factor of independent-G: no component is below this share of the largest.
CLAMP = 1e-6
GOLDEN = (np.sqrt(5.0) - 1.0) / 2.0


def g_nodes() -> np.ndarray:
    """The 90 nodes of G, evenly spaced over [0, pi/2] with both ends; radians."""
    return np.linspace(0.0, np.pi / 2, N_NODES)


def node_cosines() -> np.ndarray:
    """cos at the nodes of G. The paper interpolates the cosines of Eq. 3 like G, so G = cos cancels them exactly."""
    cosines = np.cos(g_nodes())
    cosines[-1] = 0.0
    return cosines


def node_position(cosine: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Interval (int) and place within it, in [0, 1], of the angles with these cosines."""
    x = np.arccos(np.clip(cosine, 0.0, 1.0)) / (np.pi / 2) * (N_NODES - 1)
    interval = np.minimum(x.astype(np.int64), N_NODES - 2)
    return interval, x - interval


def interpolated(nodes: np.ndarray, interval: np.ndarray, place: np.ndarray) -> np.ndarray:
    """Linear interpolation between nodes."""
    return nodes[interval] + place * (nodes[interval + 1] - nodes[interval])


@dataclass(frozen=True)
class Geometry:
    """The samples of a mask of cells, phi_d and pi - phi_d merged: where they are and which nodes of G they touch.

    ``start`` (8101): the samples of cell c = 90 h + d are start[c] .. start[c + 1] - 1. ``first``, ``second``: flat
    grid indices of the two merged cells. ``ki, u`` and ``ko, v``: interval of G and place for theta_i, theta_o;
    ``q``: 1 / (cos theta_i cos theta_o). ``order`` sorts the samples by pairs of intervals; ``pair_start``,
    ``pair_i``, ``pair_o`` say which are together, and the arrays named ``*_p`` are in that order.
    """

    start: np.ndarray
    first: np.ndarray
    second: np.ndarray
    cell: np.ndarray
    ki: np.ndarray
    ko: np.ndarray
    u: np.ndarray
    v: np.ndarray
    q: np.ndarray
    order: np.ndarray
    pair_start: np.ndarray
    pair_i: np.ndarray
    pair_o: np.ndarray
    cell_p: np.ndarray
    u_p: np.ndarray
    v_p: np.ndarray
    q_p: np.ndarray

    @classmethod
    def of(cls, keep: np.ndarray) -> "Geometry":
        """Of a bool mask of GRID_SHAPE; a cell counts if it or its mirror image in phi_d does."""
        half = N_PHI_D // 2
        either = keep[..., :half] | keep[..., : half - 1 : -1]
        h, d, p = np.nonzero(either)
        theta_h, theta_d, phi_d = grid_axes()
        middle = (np.cos(theta_h) * np.cos(theta_d))[h, d, 0]
        swing = (np.sin(theta_h) * np.sin(theta_d))[h, d, 0] * np.cos(phi_d)[0, 0, p]
        ki, u = node_position(middle - swing)
        ko, v = node_position(middle + swing)
        cosines = node_cosines()
        q = 1.0 / (interpolated(cosines, ki, u) * interpolated(cosines, ko, v))
        cell = (h * N_THETA_D + d).astype(np.int32)
        start = np.searchsorted(cell, np.arange(N_CELLS_2D + 1))
        pair = ki * N_NODES + ko
        order = np.argsort(pair, kind="stable")
        pairs, pair_start = np.unique(pair[order], return_index=True)
        flat = cell.astype(np.int64) * N_PHI_D
        return cls(
            start, flat + p, flat + (N_PHI_D - 1 - p), cell, ki.astype(np.uint8), ko.astype(np.uint8), u, v, q,
            order, np.append(pair_start, pair.size), pairs // N_NODES, pairs % N_NODES,
            cell[order], u[order], v[order], q[order],
        )  # fmt: skip

    @cached_property
    def held(self) -> np.ndarray:
        """(90, 90), what every G is multiplied with: the identity but for nodes that are the nearest node of no sample.
        There G / cos is that of the next node that is, linear between two: nothing else says what G is, and the filter
        would let it grow without bound. Samples end at 89 degrees, so the last node follows the one before."""
        nearest = np.rint(np.append(self.ki + self.u, self.ko + self.v)).astype(np.int64)
        seen = np.bincount(nearest, minlength=N_NODES) > 0
        seen[-1] |= seen[-2]
        nodes, cosines = np.flatnonzero(seen[:-1]), node_cosines()  # at the last node the cosine is 0
        held = np.eye(N_NODES)
        if nodes.size and not seen.all():
            ratio = np.stack([np.interp(np.arange(N_NODES), nodes, unit) for unit in np.eye(nodes.size)], 1)
            held *= seen[:, None]
            held[np.ix_(~seen, nodes)] = (cosines[:, None] * ratio / cosines[nodes])[~seen]
        return held


@dataclass(frozen=True)
class Channel:
    """The merged samples of one colour channel: weight ``w``, weighted value ``wr``, and the constant sum w rho^2."""

    geometry: Geometry
    w: np.ndarray
    wr: np.ndarray
    power: float

    @classmethod
    def of(cls, geometry: Geometry, weights: np.ndarray, rho: np.ndarray) -> "Channel":
        """From weights and values of GRID_SHAPE; values with weight 0 are not looked at."""
        weights, rho = np.ravel(weights), np.ravel(rho)
        w, wr = np.empty(geometry.q.size), np.empty(geometry.q.size)
        power = _merge(geometry.first, geometry.second, weights, rho, w, wr)
        return cls(geometry, w, wr, power)

    @cached_property
    def w_p(self) -> np.ndarray:
        return self.w[self.geometry.order]

    @cached_property
    def wr_p(self) -> np.ndarray:
        return self.wr[self.geometry.order]

    @cached_property
    def sums(self) -> tuple[np.ndarray, np.ndarray]:
        """sum w and sum w rho of each (theta_h, theta_d), (90, 90)."""
        cell = self.geometry.cell
        a = np.bincount(cell, self.w, N_CELLS_2D).reshape(N_THETA_H, N_THETA_D)
        b = np.bincount(cell, self.wr, N_CELLS_2D).reshape(N_THETA_H, N_THETA_D)
        return a, b

    def contract(self, g: np.ndarray) -> np.ndarray:
        """The sums over phi_d of w x, w x^2 and w rho x with x = G G / (cos cos): (3, 90, 90)."""
        out = np.empty((3, N_THETA_H, N_THETA_D))
        o = self.geometry
        contract(o.start, o.ki, o.ko, o.u, o.v, o.q, self.w, self.wr, g, out.reshape(3, -1))
        return out

    def collect(self, m: np.ndarray) -> np.ndarray:
        """The 17 sums for each pair of intervals of G, with M (90, 90) fixed."""
        o = self.geometry
        out = np.empty((o.pair_i.size, 17))
        collect(o.pair_start, o.cell_p, o.u_p, o.v_p, o.q_p, self.w_p, self.wr_p, np.ravel(m), out)
        return out


@njit(cache=True, nogil=True)
def _merge(first, second, weights, rho, w, wr):
    power = 0.0
    for s in range(first.size):
        a, b = weights[first[s]], weights[second[s]]
        wa, wb = 0.0, 0.0
        if a > 0.0:
            r = float(rho[first[s]])
            wa = a * r
            power += wa * r
        if b > 0.0:
            r = float(rho[second[s]])
            wb = b * r
            power += wb * r
        w[s], wr[s] = a + b, wa + wb
    return power


@njit(cache=True, nogil=True)
def contract(start, ki, ko, u, v, q, w, wr, g, out):
    slope = g[1:] - g[:-1]
    for c in range(start.size - 1):
        s1, s2, r1 = 0.0, 0.0, 0.0
        for s in range(start[c], start[c + 1]):
            i, o = ki[s], ko[s]
            x = (g[i] + u[s] * slope[i]) * (g[o] + v[s] * slope[o]) * q[s]
            wx = w[s] * x
            s1 += wx
            s2 += wx * x
            r1 += wr[s] * x
        out[0, c], out[1, c], out[2, c] = s1, s2, r1


@njit(cache=True, nogil=True)
def collect(pair_start, cell, u, v, q, w, wr, m, out):
    """Per pair: w rho y c_ab (4), w y c_ab (4), w y^2 times the monomials of u (3) and v (3); y = M / (cos cos)."""
    for b in range(pair_start.size - 1):
        r00 = r01 = r10 = r11 = s00 = s01 = s10 = s11 = 0.0
        q00 = q01 = q02 = q10 = q11 = q12 = q20 = q21 = q22 = 0.0
        for s in range(pair_start[b], pair_start[b + 1]):
            y = m[cell[s]] * q[s]
            u1, v1 = u[s], v[s]
            u0, v0 = 1.0 - u1, 1.0 - v1
            ry, wy = wr[s] * y, w[s] * y
            a0, a1 = ry * u0, ry * u1
            r00 += a0 * v0
            r01 += a0 * v1
            r10 += a1 * v0
            r11 += a1 * v1
            a0, a1 = wy * u0, wy * u1
            s00 += a0 * v0
            s01 += a0 * v1
            s10 += a1 * v0
            s11 += a1 * v1
            a0, a1, a2 = wy * y * u0 * u0, wy * y * u0 * u1, wy * y * u1 * u1
            b0, b1, b2 = v0 * v0, v0 * v1, v1 * v1
            q00 += a0 * b0
            q01 += a0 * b1
            q02 += a0 * b2
            q10 += a1 * b0
            q11 += a1 * b1
            q12 += a1 * b2
            q20 += a2 * b0
            q21 += a2 * b1
            q22 += a2 * b2
        t = out[b]
        t[0], t[1], t[2], t[3] = r00, r01, r10, r11
        t[4], t[5], t[6], t[7] = s00, s01, s10, s11
        t[8], t[9], t[10] = q00, q01, q02
        t[11], t[12], t[13] = q10, q11, q12
        t[14], t[15], t[16] = q20, q21, q22


@njit(cache=True, nogil=True)
def first_sums(t):
    """Of one row of :func:`collect`: r_ab = sum w rho y u_a v_b and s_ab = sum w y u_a v_b, a and b the lower (0) or
    upper (1) node of the interval, u_0 = 1 - u, u_1 = u."""
    return t[0], t[1], t[2], t[3], t[4], t[5], t[6], t[7]


@njit(cache=True, nogil=True)
def second_sums(t):
    """Of one row of :func:`collect`: q_ab = sum w y^2 U_a V_b with the monomials U = (u_0^2, u_0 u_1, u_1^2) and V."""
    return t[8], t[9], t[10], t[11], t[12], t[13], t[14], t[15], t[16]


@njit(cache=True, nogil=True)
def pair_sums(pair_i, pair_o, t, g):
    """sum w x, sum w x^2, sum w rho x over all samples, x = M G G / (cos cos), from the sums of :func:`collect`."""
    s1, s2, r1 = 0.0, 0.0, 0.0
    for b in range(pair_i.size):
        i0, i1 = g[pair_i[b]], g[pair_i[b] + 1]
        o0, o1 = g[pair_o[b]], g[pair_o[b] + 1]
        r00, r01, r10, r11, s00, s01, s10, s11 = first_sums(t[b])
        q00, q01, q02, q10, q11, q12, q20, q21, q22 = second_sums(t[b])
        r1 += i0 * (r00 * o0 + r01 * o1) + i1 * (r10 * o0 + r11 * o1)
        s1 += i0 * (s00 * o0 + s01 * o1) + i1 * (s10 * o0 + s11 * o1)
        b0, b1, b2 = o0 * o0, 2.0 * o0 * o1, o1 * o1
        s2 += (
            i0 * i0 * (q00 * b0 + q01 * b1 + q02 * b2)
            + 2.0 * i0 * i1 * (q10 * b0 + q11 * b1 + q12 * b2)
            + i1 * i1 * (q20 * b0 + q21 * b1 + q22 * b2)
        )
    return s1, s2, r1


@njit(cache=True, nogil=True)
def pair_normal(pair_i, pair_o, t, g, rho_d, diagonal, off, right):
    """The normal equations of one of the two G with the other held at ``g``, the roles of theta_i and theta_o added:
    a symmetric tridiagonal matrix (``diagonal``, ``off``) and the right side."""
    diagonal[:] = 0.0
    off[:] = 0.0
    right[:] = 0.0
    for b in range(pair_i.size):
        i, o = pair_i[b], pair_o[b]
        i0, i1, o0, o1 = g[i], g[i + 1], g[o], g[o + 1]
        r00, r01, r10, r11, s00, s01, s10, s11 = first_sums(t[b])
        q00, q01, q02, q10, q11, q12, q20, q21, q22 = second_sums(t[b])
        z00, z01, z10, z11 = r00 - rho_d * s00, r01 - rho_d * s01, r10 - rho_d * s10, r11 - rho_d * s11
        right[i] += z00 * o0 + z01 * o1
        right[i + 1] += z10 * o0 + z11 * o1
        right[o] += z00 * i0 + z10 * i1
        right[o + 1] += z01 * i0 + z11 * i1
        x0, x1, x2 = o0 * o0, 2.0 * o0 * o1, o1 * o1
        diagonal[i] += q00 * x0 + q01 * x1 + q02 * x2
        off[i] += q10 * x0 + q11 * x1 + q12 * x2
        diagonal[i + 1] += q20 * x0 + q21 * x1 + q22 * x2
        x0, x1, x2 = i0 * i0, 2.0 * i0 * i1, i1 * i1
        diagonal[o] += q00 * x0 + q10 * x1 + q20 * x2
        off[o] += q01 * x0 + q11 * x1 + q21 * x2
        diagonal[o + 1] += q02 * x0 + q12 * x1 + q22 * x2


@njit(cache=True, nogil=True)
def smooth(values, kernel, out):
    """Convolution with a symmetric kernel (its middle and one side); the ends are continued."""
    n = values.size
    for k in range(n):
        total = kernel[0] * values[k]
        for j in range(1, kernel.size):
            total += kernel[j] * (values[max(k - j, 0)] + values[min(k + j, n - 1)])
        out[k] = total


def gaussian_kernel(sigma: float) -> np.ndarray:
    """The middle and one side of a normalised Gaussian filter, cut at 4 sigma; sigma in nodes, 0 for none."""
    if sigma <= 0:
        return np.ones(1)
    x = np.arange(int(np.ceil(4 * sigma)) + 1)
    half = np.exp(-0.5 * (x / sigma) ** 2)
    return half / (half[0] + 2 * half[1:].sum())


@njit(cache=True, nogil=True)
def cross(start, ki, ko, u, v, q, w, g, sums, p):
    """:func:`contract` without its third sum, and p[c, k] = sum w x dx/dG_k: what couples M and G in a joint step."""
    slope = g[1:] - g[:-1]
    for c in range(start.size - 1):
        s1, s2 = 0.0, 0.0
        row = p[c]
        row[:] = 0.0
        for s in range(start[c], start[c + 1]):
            i, o = ki[s], ko[s]
            gi, go = g[i] + u[s] * slope[i], g[o] + v[s] * slope[o]
            x = gi * go * q[s]
            wx = w[s] * x
            s1 += wx
            s2 += wx * x
            left, right = wx * q[s] * go, wx * q[s] * gi
            row[i] += left * (1.0 - u[s])
            row[i + 1] += left * u[s]
            row[o] += right * (1.0 - v[s])
            row[o + 1] += right * v[s]
        sums[0, c], sums[1, c] = s1, s2


@njit(cache=True, nogil=True)
def pair_joint(pair_i, pair_o, t, g, rho_d, a, gradient, mean):
    """For G with M fixed: the Gauss-Newton matrix ``a`` (90, 90), ``gradient`` = sum w (rho - f) df/dG and ``mean`` =
    sum w df/dG."""
    a[:] = 0.0
    gradient[:] = 0.0
    mean[:] = 0.0
    block = np.empty((4, 4))
    value = np.empty(4)
    index = np.empty(4, np.int64)
    for b in range(pair_i.size):
        i, o = pair_i[b], pair_o[b]
        i0, i1, o0, o1 = g[i], g[i + 1], g[o], g[o + 1]
        r00, r01, r10, r11, s00, s01, s10, s11 = first_sums(t[b])
        q00, q01, q02, q10, q11, q12, q20, q21, q22 = second_sums(t[b])
        index[0], index[1], index[2], index[3] = i, i + 1, o, o + 1
        value[0], value[1], value[2], value[3] = i0, i1, o0, o1
        x0, x1, x2 = o0 * o0, 2.0 * o0 * o1, o1 * o1
        block[0, 0] = q00 * x0 + q01 * x1 + q02 * x2
        block[0, 1] = q10 * x0 + q11 * x1 + q12 * x2
        block[1, 1] = q20 * x0 + q21 * x1 + q22 * x2
        x0, x1, x2 = i0 * i0, 2.0 * i0 * i1, i1 * i1
        block[2, 2] = q00 * x0 + q10 * x1 + q20 * x2
        block[2, 3] = q01 * x0 + q11 * x1 + q21 * x2
        block[3, 3] = q02 * x0 + q12 * x1 + q22 * x2
        # w y^2 u_a v_b G_i G_o, with G_i G_o written out in its four nodes
        x0, x1, x2, x3 = i0 * o0, i0 * o1, i1 * o0, i1 * o1
        block[0, 2] = q00 * x0 + q01 * x1 + q10 * x2 + q11 * x3
        block[0, 3] = q01 * x0 + q02 * x1 + q11 * x2 + q12 * x3
        block[1, 2] = q10 * x0 + q11 * x1 + q20 * x2 + q21 * x3
        block[1, 3] = q11 * x0 + q12 * x1 + q21 * x2 + q22 * x3
        for m in range(4):
            for n in range(m):
                block[m, n] = block[n, m]
        for m in range(4):
            for n in range(4):
                a[index[m], index[n]] += block[m, n]
        m0, m1 = s00 * o0 + s01 * o1, s10 * o0 + s11 * o1
        m2, m3 = s00 * i0 + s10 * i1, s01 * i0 + s11 * i1
        mean[i] += m0
        mean[i + 1] += m1
        mean[o] += m2
        mean[o + 1] += m3
        gradient[i] += r00 * o0 + r01 * o1 - rho_d * m0 - block[0, 0] * i0 - block[0, 1] * i1
        gradient[i + 1] += r10 * o0 + r11 * o1 - rho_d * m1 - block[1, 0] * i0 - block[1, 1] * i1
        gradient[o] += r00 * i0 + r10 * i1 - rho_d * m2 - block[2, 2] * o0 - block[2, 3] * o1
        gradient[o + 1] += r01 * i0 + r11 * i1 - rho_d * m3 - block[3, 2] * o0 - block[3, 3] * o1


@njit(cache=True, nogil=True)
def _g_objective(pair_i, pair_o, t, g, rho_d, constant):
    s1, s2, r1 = pair_sums(pair_i, pair_o, t, g)
    return constant - 2.0 * r1 + 2.0 * rho_d * s1 + s2


@njit(cache=True, nogil=True)
def update_g(pair_i, pair_o, t, g, rho_d, constant, kernel, clamp, most, tolerance):
    """The paper's update of G: the two G solved apart, averaged, smoothed, clamped; repeated until it converges or
    the objective would rise. If the first repetition raises it, golden-section search between the old and the new G.

    Each node is the quotient of Eq. 14 over the samples of its two intervals, counted by their share in the
    interpolation. Returns (G, objective, golden-section calls, nodes without samples).
    """
    n = g.size
    g = g.copy()
    objective = _g_objective(pair_i, pair_o, t, g, rho_d, constant)
    diagonal, off, right = np.empty(n), np.empty(n), np.empty(n)
    solved, trial = np.empty(n), np.empty(n)
    golden, empty = 0, 0
    for repetition in range(most):
        pair_normal(pair_i, pair_o, t, g, rho_d, diagonal, off, right)
        smallest = 1e-14 * diagonal.max()
        empty = 0
        for k in range(n):
            share = diagonal[k] + off[k] + (off[k - 1] if k > 0 else 0.0)
            if share > smallest:
                solved[k] = right[k] / share
            else:
                solved[k] = g[k]
                empty += 1
        smooth(solved, kernel, trial)
        trial = np.maximum(trial, clamp * trial.max())
        value = _g_objective(pair_i, pair_o, t, trial, rho_d, constant)
        if value < objective:
            done = objective - value < tolerance * objective
            g[:] = trial
            objective = value
            if done:
                break
            continue
        if repetition == 0:
            golden += 1
            change = trial - g
            a, b = 0.0, 1.0
            x1, x2 = b - GOLDEN * (b - a), a + GOLDEN * (b - a)
            f1 = _g_objective(pair_i, pair_o, t, g + x1 * change, rho_d, constant)
            f2 = _g_objective(pair_i, pair_o, t, g + x2 * change, rho_d, constant)
            while b - a > 1e-3:
                if f1 < f2:
                    b, x2, f2 = x2, x1, f1
                    x1 = b - GOLDEN * (b - a)
                    f1 = _g_objective(pair_i, pair_o, t, g + x1 * change, rho_d, constant)
                else:
                    a, x1, f1 = x1, x2, f2
                    x2 = a + GOLDEN * (b - a)
                    f2 = _g_objective(pair_i, pair_o, t, g + x2 * change, rho_d, constant)
            best, value = (x1, f1) if f1 < f2 else (x2, f2)
            if value < objective:
                g += best * change
                objective = value
        break
    return g, objective, golden, empty


def quotient(numerator: np.ndarray, denominator: np.ndarray, previous: np.ndarray) -> tuple[np.ndarray, int]:
    """Eq. 14 for each component; a component with a zero denominator keeps its previous value. Also how many did."""
    good = denominator > 1e-14 * denominator.max(initial=0.0)
    return np.where(good, numerator / np.where(good, denominator, 1.0), previous), int((~good).sum())


def clamped(values: np.ndarray, clamp: float) -> np.ndarray:
    """No component below ``clamp`` times the largest."""
    return np.maximum(values, clamp * max(values.max(), 0.0))


def coefficients(w: float, wr: float, s1: float, s2: float, r1: float) -> tuple[float, float] | None:
    """rho_d and rho_s by Cramer's rule (Eqs. 16 - 18): the best a + b x, a >= 0. None if there is no such b > 0."""
    determinant = w * s2 - s1 * s1
    a, b = -1.0, 0.0
    if determinant > 1e-12 * w * s2:
        a, b = (wr * s2 - s1 * r1) / determinant, (w * r1 - s1 * wr) / determinant
    if a < 0 and s2 > 0:
        a, b = 0.0, r1 / s2
    return (a, b) if a >= 0 and b > 0 and np.isfinite(a + b) else None
