"""One channel of the factor microfacet models as problems of alternating least squares with joint steps.

f = rho_d + M[h, d] G(theta_i) G(theta_o) / (cos theta_i cos theta_o) with

* :class:`FactorProblem`: M = sum_r u_r(theta_h) v_r(theta_d), G free or derived from D by Smith's integral;
* :class:`TableProblem`: M a free, non-negative table.

Bagher et al. 2016, sections 4.2, 4.3 and 6.
"""

from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve

from brdfatlas.angles import N_THETA_D, N_THETA_H, cell_widths, theta_h_centres
from brdfatlas.models.bagher2016.awls import (
    GOLDEN,
    N_NODES,
    Channel,
    clamped,
    coefficients,
    cross,
    g_nodes,
    gaussian_kernel,
    pair_joint,
    pair_sums,
    quotient,
    smooth,
    update_g,
)
from brdfatlas.solvers.acceleration import damped_solve

N_H, N_D = N_THETA_H, N_THETA_D
G_REPETITIONS, G_TOLERANCE = 20, 1e-4
#: Rounds of updates of the factors after each joint step.
ROUNDS = 2


@cache
def smoothing_matrix(sigma: float) -> np.ndarray:
    """The Gaussian filter over the nodes of G as a matrix (90, 90)."""
    kernel, out = gaussian_kernel(sigma), np.empty((N_NODES, N_NODES))
    for k, unit in enumerate(np.eye(N_NODES)):
        smooth(unit, kernel, out[:, k])
    return out


@cache
def smith_operators() -> tuple[np.ndarray, np.ndarray]:
    """(lambda_matrix, mean): Lambda at the nodes of G is lambda_matrix @ D / (mean @ D), (90, 90) and (90,).

    The integrals of section 4.3 are linear in D. The two of Lambda by 15-point Gauss-Legendre quadrature with D
    interpolated linearly between its cells, as published; that of Eq. 19 by the sum over D's cells, because 15
    points can miss the lobe of a mirror-like material.
    """
    x, weight = np.polynomial.legendre.leggauss(15)
    x, weight = 0.5 * (x + 1), 0.5 * weight
    psi, weight_psi = x * (np.pi / 2), weight * (np.pi / 2)
    matrix = np.zeros((N_NODES, N_H))
    for k, theta in enumerate(g_nodes()[1:-1], start=1):
        mu = 1.0 / np.tan(theta)
        omega, weight_omega = (np.pi / 2 - theta) + x * theta, weight * theta
        tan_w, tan_p = np.tan(omega)[:, None], np.tan(psi)[None, :]
        squared = tan_w**2 + tan_p**2
        factor = weight_omega[:, None] * (tan_w - mu) * (1 + tan_w**2) / mu * 2 * weight_psi * (1 + tan_p**2)
        factor = factor / (1 + squared) ** 2
        place = np.sqrt(np.arctan(np.sqrt(squared)) / (np.pi / 2)) * N_H - 0.5
        place = np.clip(place, 0, N_H - 1)
        low = np.minimum(place.astype(int), N_H - 2)
        high_share = place - low
        np.add.at(matrix[k], low, factor * (1 - high_share))
        np.add.at(matrix[k], low + 1, factor * high_share)
    theta_h = theta_h_centres()
    mean = 2 * np.pi * np.cos(theta_h) * np.sin(theta_h) * cell_widths()[0]
    return matrix, mean


def g_from_d(d: np.ndarray) -> np.ndarray:
    """G at its 90 nodes from D at the centres of the 90 theta_h cells (any scale), by Smith's integral."""
    matrix, mean = smith_operators()
    total = mean @ d
    if not total > 0:
        return np.ones(N_NODES)
    g = 1.0 / (1.0 + np.maximum(matrix @ d, 0.0) / total)
    g[-1] = 0.0
    return g


def g_from_d_derivative(d: np.ndarray) -> np.ndarray:
    """dG/dD, (90 nodes, 90 cells)."""
    matrix, mean = smith_operators()
    total = mean @ d
    if not total > 0:
        return np.zeros((N_NODES, N_H))
    smith = matrix @ d
    g = g_from_d(d)
    return -(g**2)[:, None] * (matrix / total - np.outer(smith, mean) / total**2)


@dataclass(frozen=True)
class FactorState:
    """``u`` (rank, 90) carries the scale, ``v`` (rank, 90) and ``g`` (90) have 1 as the largest absolute value."""

    u: np.ndarray
    v: np.ndarray
    g: np.ndarray
    rho_d: float
    objective: float
    sums: np.ndarray

    @property
    def m(self) -> np.ndarray:
        return self.u.T @ self.v


@dataclass(frozen=True)
class TableState:
    """``m`` (90, 90) carries the scale, ``g`` (90) has 1 as its largest value."""

    m: np.ndarray
    g: np.ndarray
    rho_d: float
    objective: float
    sums: np.ndarray


class _MicrofacetProblem:
    """What the two problems share: the objective from the sums over phi_d, and the update of G."""

    def __init__(self, channel: Channel, *, clamp: float, smoothing: float):
        self.channel = channel
        self.clamp = clamp
        self.kernel = gaussian_kernel(smoothing)
        self.held = channel.geometry.held
        self.smoothing = self.held @ smoothing_matrix(float(smoothing)) @ self.held
        table_w, table_wr = channel.sums
        self.w, self.wr, self.power = float(table_w.sum()), float(table_wr.sum()), channel.power
        self.golden_calls = 0
        self.empty_components = 0

    def objective(self, m: np.ndarray, rho_d: float, sums: np.ndarray) -> float:
        s1, s2, r1 = sums
        value = self.power - 2 * rho_d * self.wr + rho_d**2 * self.w
        value += float(np.vdot(m, m * s2 + 2 * rho_d * s1 - 2 * r1))
        return max(value, 0.0) if np.isfinite(value) else np.inf

    def _improve_g(self, m: np.ndarray, g: np.ndarray, rho_d: float):
        """The published update of G with M and rho_d held: (G with largest 1, factor for M, rho_d, empty nodes)."""
        geometry = self.channel.geometry
        pairs = self.channel.collect(m)
        constant = self.power - 2 * rho_d * self.wr + rho_d**2 * self.w
        g, _, golden, empty = update_g(
            geometry.pair_i, geometry.pair_o, pairs, g, rho_d, constant, self.kernel, self.clamp,
            G_REPETITIONS, G_TOLERANCE,
        )  # fmt: skip
        self.golden_calls += golden
        peak = g.max()
        g = clamped(g / peak, self.clamp)
        x = pair_sums(geometry.pair_i, geometry.pair_o, pairs, g)
        best = coefficients(self.w, self.wr, *x)
        return (g, best[1], best[0], empty) if best else (g, peak * peak, rho_d, empty)

    def _linear_g(self, m: np.ndarray, g: np.ndarray, rho_d: float):
        """Blocks of the joint step that concern G: p (90, 90, 90), matrix, gradient and mean, from two passes."""
        o = self.channel.geometry
        sums, p = np.empty((2, N_H * N_D)), np.empty((N_H * N_D, N_NODES))
        cross(o.start, o.ki, o.ko, o.u, o.v, o.q, self.channel.w, g, sums, p)
        matrix, gradient, mean = np.empty((N_NODES, N_NODES)), np.empty(N_NODES), np.empty(N_NODES)
        pair_joint(o.pair_i, o.pair_o, self.channel.collect(m), g, rho_d, matrix, gradient, mean)
        return p.reshape(N_H, N_D, N_NODES), matrix, gradient, mean


class FactorProblem(_MicrofacetProblem):
    """M = sum of ``rank`` products. With ``signed`` the products may be negative (low rank); else every component
    is at least ``clamp`` times its factor's largest. With ``derived``, G is Smith's of u (rank 1). ``hold``: weights
    and values (90, 90) that hold M where no sample does, beside the samples."""

    def __init__(self, channel, *, rank=1, clamp=0.0, smoothing=1.0, derived=False, signed=False, hold=None):
        super().__init__(channel, clamp=clamp, smoothing=smoothing)
        self.rank, self.derived, self.signed = rank, derived, signed
        weight, value = hold if hold else (np.zeros((N_H, N_D)), np.zeros((N_H, N_D)))
        self.more = np.stack([np.zeros((N_H, N_D)), weight, weight * value])
        self.power += float(np.vdot(weight * value, value))

    def start(self, u, v, g=None, rho_d=0.0, *, best_scale=True) -> FactorState:
        """A state from factors of any scale; ``best_scale``: with the best rho_d and rho_s for them."""
        u, v = np.atleast_2d(np.asarray(u, float)), np.atleast_2d(np.asarray(v, float))
        state = self._state(u, v, np.ones(N_NODES) if g is None else np.asarray(g, float), rho_d)
        return self._best_scale(state) if best_scale else state

    def _best_scale(self, state: FactorState) -> FactorState:
        m, (s1, s2, r1) = state.m, state.sums
        best = coefficients(self.w, self.wr, float(np.vdot(m, s1)), float(np.vdot(m * m, s2)), float(np.vdot(m, r1)))
        if best is None:
            return state
        trial = self._with(state, state.u * best[1], state.v, best[0])
        return trial if trial.objective <= state.objective else state

    def _with(self, state: FactorState, u, v, rho_d) -> FactorState:
        """New u, v, rho_d with the same G (not for a derived G)."""
        u, v = self._bounded(u), self._bounded(v)
        scale = np.abs(v).max(axis=1, keepdims=True)
        scale = np.where(scale > 0, scale, 1.0)
        u, v = u * scale, v / scale
        return FactorState(u, v, state.g, float(rho_d), self.objective(u.T @ v, rho_d, state.sums), state.sums)

    def _state(self, u, v, g, rho_d) -> FactorState:
        u, v = self._bounded(u), self._bounded(v)
        if self.derived:
            g = g_from_d(u[0])
        else:
            g = clamped(self.held @ g, self.clamp)
            peak = g.max()
            if not (peak > 0 and np.isfinite(peak)):
                return FactorState(u, v, g, rho_d, np.inf, np.zeros((3, N_H, N_D)))
            g, u = g / peak, u * (peak * peak)
        blank = FactorState(u, v, g, rho_d, np.inf, self.channel.contract(g) + self.more)
        return self._with(blank, u, v, rho_d)

    def sweep(self, state: FactorState) -> FactorState:
        """D, F, G, then rho_d and rho_s, each step taken only if the objective does not rise."""
        empty = 0
        u, v, rho_d = state.u, state.v, state.rho_d
        s1, s2, r1 = state.sums
        for k in range(self.rank):
            others = np.delete(u, k, 0).T @ np.delete(v, k, 0)
            z = r1 - rho_d * s1 - others * s2
            u_k, empty_u = quotient(z @ v[k], s2 @ (v[k] ** 2), u[k])
            state = self._replace_u(state, k, u_k)
            u, v, (s1, s2, r1) = state.u, state.v, state.sums
            others = np.delete(u, k, 0).T @ np.delete(v, k, 0)
            z = r1 - rho_d * s1 - others * s2
            v_k, empty_v = quotient(u[k] @ z, (u[k] ** 2) @ s2, v[k])
            v = v.copy()
            v[k] = v_k
            trial = self._with(state, u, v, rho_d)
            state = trial if trial.objective <= state.objective else state
            u, v = state.u, state.v
            empty += empty_u + empty_v
        if not self.derived:
            g, factor, rho_d, empty_g = self._improve_g(state.m, state.g, state.rho_d)
            trial = self._state(state.u * factor, state.v, g, rho_d)
            state = trial if trial.objective <= state.objective else state
            empty += empty_g
        self.empty_components = empty
        return self._best_scale(state)

    def _replace_u(self, state: FactorState, k: int, u_k: np.ndarray) -> FactorState:
        u = state.u.copy()
        u[k] = u_k
        if not self.derived:
            trial = self._with(state, u, state.v, state.rho_d)
            return trial if trial.objective <= state.objective else state
        # G follows D, so the least-squares D need not be the best: golden-section search between the old and the new.
        new = clamped(u, self.clamp)
        trial = self._state(new, state.v, state.g, state.rho_d)
        if trial.objective <= state.objective:
            return trial
        self.golden_calls += 1
        a, b = 0.0, 1.0
        at = lambda x: self._state(state.u + x * (new - state.u), state.v, state.g, state.rho_d)  # noqa: E731
        x1, x2 = b - GOLDEN * (b - a), a + GOLDEN * (b - a)
        f1, f2 = at(x1), at(x2)
        while b - a > 1e-3:
            if f1.objective < f2.objective:
                b, x2, f2 = x2, x1, f1
                x1 = b - GOLDEN * (b - a)
                f1 = at(x1)
            else:
                a, x1, f1 = x1, x2, f2
                x2 = a + GOLDEN * (b - a)
                f2 = at(x2)
        trial = f1 if f1.objective < f2.objective else f2
        return trial if trial.objective <= state.objective else state

    def linearise(self, state: FactorState):
        """Gauss-Newton matrix and gradient in (u, v, G's steps before smoothing, rho_d); G's are absent if derived."""
        r, u, v, g, rho_d, m = self.rank, state.u, state.v, state.g, state.rho_d, state.m
        s1, s2, r1 = state.sums
        p, g_matrix, g_gradient, g_mean = self._linear_g(m, g, rho_d)
        p = p * m[:, :, None]
        z = r1 - rho_d * s1 - m * s2
        n = r * (N_H + N_D) + N_NODES + 1
        iu, iv = np.arange(r * N_H).reshape(r, N_H), r * N_H + np.arange(r * N_D).reshape(r, N_D)
        ig, last = slice(n - 1 - N_NODES, n - 1), n - 1
        a = np.zeros((n, n))
        gradient = np.empty(n)
        for k in range(r):
            for j in range(r):
                a[iu[k], iu[j]] = s2 @ (v[k] * v[j])
                a[iv[k], iv[j]] = (u[k] * u[j]) @ s2
                block = s2 * np.outer(u[j], v[k])
                a[np.ix_(iu[k], iv[j])] = block
                a[np.ix_(iv[j], iu[k])] = block.T
            ug, vg = np.matmul(v[k], p), (u[k] @ p.reshape(N_H, -1)).reshape(N_D, N_NODES)
            a[iu[k], ig], a[ig, iu[k]], a[iv[k], ig], a[ig, iv[k]] = ug, ug.T, vg, vg.T
            a[iu[k], last] = a[last, iu[k]] = s1 @ v[k]
            a[iv[k], last] = a[last, iv[k]] = u[k] @ s1
            gradient[iu[k]], gradient[iv[k]] = z @ v[k], u[k] @ z
        a[ig, ig], a[last, last] = g_matrix, self.w
        a[ig, last] = a[last, ig] = g_mean
        gradient[ig] = g_gradient
        gradient[last] = self.wr - rho_d * self.w - np.vdot(m, s1)
        if self.derived:
            chain = g_from_d_derivative(u[0])
            a[:N_H] += chain.T @ a[ig]
            a[:, :N_H] += a[:, ig] @ chain
            gradient[:N_H] += chain.T @ gradient[ig]
            keep = np.r_[0 : n - 1 - N_NODES, last]
            return a[np.ix_(keep, keep)], gradient[keep]
        a[ig] = self.smoothing.T @ a[ig]
        a[:, ig] = a[:, ig] @ self.smoothing
        gradient[ig] = self.smoothing.T @ gradient[ig]
        return a, gradient

    def propose(self, state: FactorState, linear, damping: float) -> FactorState | None:
        matrix, gradient = linear
        r, n_u, n_v = self.rank, self.rank * N_H, self.rank * N_D
        x = np.concatenate([state.u.ravel(), state.v.ravel()])
        held = np.zeros(gradient.size, bool)
        if not self.signed:
            low = np.r_[np.full(n_u, self.clamp * state.u.max()), np.full(n_v, self.clamp * state.v.max())]
            held[: x.size] = (x <= low * (1 + 1e-9)) & (gradient[: x.size] < 0)
        held[-1] = state.rho_d <= 0 and gradient[-1] < 0
        step = damped_solve(matrix, gradient, damping, held)
        if step is None:
            return None
        x = x + step[: x.size]
        g = state.g if self.derived else state.g + self.smoothing @ step[x.size : -1]
        u, v = x[:n_u].reshape(r, N_H), x[n_u:].reshape(r, N_D)
        trial = self._state(u, v, g, max(state.rho_d + float(step[-1]), 0.0))
        return trial if self.derived else self._settled(trial)

    def _settled(self, state: FactorState) -> FactorState:
        """u, v and rho_d, one after another, at their best for a free G.

        A joint step leaves the curved valley of the products, and only a short one would stay in it: this goes back to
        its bottom, without a pass over the samples. Far fewer steps are needed, and each may be longer.
        """
        (s1, s2, r1), u, v = state.sums, state.u, state.v
        for _ in range(ROUNDS):
            z = r1 - state.rho_d * s1
            u = self._bounded(best_rows(s2, z, v, u))
            v = self._bounded(best_rows(s2.T, z.T, u, v))
            rho_d = max((self.wr - float(np.vdot(u.T @ v, s1))) / self.w, 0.0)
            trial = self._with(state, u, v, rho_d)
            if not trial.objective < state.objective:
                break
            state, u, v = trial, trial.u, trial.v
        return state

    def _bounded(self, factor: np.ndarray) -> np.ndarray:
        """Not below the clamp, but for products that may be negative."""
        return factor if self.signed else clamped(factor, self.clamp)


def best_rows(s2: np.ndarray, z: np.ndarray, v: np.ndarray, u: np.ndarray) -> np.ndarray:
    """The u (rank, n) with the least sum of s2 (m - z / s2)^2, m = u.T @ v, for given ``v`` (rank, k) and sums ``s2``,
    ``z`` (n, k): normal equations a row; nearest to the old ``u`` where they leave it free."""
    matrix = np.einsum("nk,ik,jk->nij", s2, v, v, optimize=True)
    weight = np.trace(matrix, axis1=1, axis2=2)[:, None]
    ridge = 1e-10 * weight + 1e-14 * weight.max() + 1e-300
    right = z @ v.T + ridge * u.T
    return np.linalg.solve(matrix + ridge[..., None] * np.eye(len(v)), right[..., None])[..., 0].T


class TableProblem(_MicrofacetProblem):
    """M a free table: for given G and rho_d every cell has its best value at once, so the step is in G and rho_d."""

    def start(self, m, g, rho_d=0.0) -> TableState:
        """The better of the given table and of the best table for G and rho_d."""
        state = self._state(np.asarray(g, float), float(rho_d), np.asarray(m, float))
        given = TableState(
            np.asarray(m, float) * (np.max(g) ** 2), state.g, state.rho_d,
            self.objective(np.asarray(m, float) * (np.max(g) ** 2), state.rho_d, state.sums), state.sums,
        )  # fmt: skip
        return state if state.objective <= given.objective else given

    def _state(self, g, rho_d, previous) -> TableState:
        g = clamped(self.held @ g, self.clamp)
        peak = g.max()
        if not (peak > 0 and np.isfinite(peak)):
            return TableState(previous, g, rho_d, np.inf, np.zeros((3, N_H, N_D)))
        g = g / peak
        sums = self.channel.contract(g)
        m, _ = quotient(sums[2] - rho_d * sums[0], sums[1], previous * (peak * peak))
        m = np.maximum(m, 0.0)
        return TableState(m, g, rho_d, self.objective(m, rho_d, sums), sums)

    def sweep(self, state: TableState) -> TableState:
        """B, then G, then rho_d and the scale of B."""
        state = self._better(state, self._state(state.g, state.rho_d, state.m))
        self.empty_components = int((state.sums[1] <= 0).sum())
        g, factor, rho_d, empty = self._improve_g(state.m, state.g, state.rho_d)
        self.empty_components += empty
        return self._better(state, self._state(g, rho_d, state.m * factor))

    @staticmethod
    def _better(old: TableState, new: TableState) -> TableState:
        return new if new.objective <= old.objective else old

    def linearise(self, state: TableState):
        s1, s2, r1 = state.sums
        p, matrix, gradient, mean = self._linear_g(state.m, state.g, state.rho_d)
        coupling = np.empty((N_H * N_D, N_NODES + 1))
        coupling[:, :-1] = (p.reshape(-1, N_NODES) * state.m.reshape(-1, 1)) @ self.smoothing
        coupling[:, -1] = s1.ravel()
        a = np.empty((N_NODES + 1, N_NODES + 1))
        a[:-1, :-1] = self.smoothing.T @ matrix @ self.smoothing
        a[:-1, -1] = a[-1, :-1] = self.smoothing.T @ mean
        a[-1, -1] = self.w
        residual = (r1 - state.rho_d * s1 - state.m * s2).ravel()
        rest = self.wr - state.rho_d * self.w - float(np.vdot(state.m, s1))
        # Cells that hold at 0 or have no samples stay as they are.
        active = (s2.ravel() > 1e-14 * s2.max()) & ((state.m.ravel() > 0) | (residual > 0))
        diagonal = np.where(active, s2.ravel(), np.inf)
        return a, np.append(self.smoothing.T @ gradient, rest), coupling, diagonal, residual

    def propose(self, state: TableState, linear, damping: float) -> TableState | None:
        a, gradient, coupling, diagonal, residual = linear
        scaled = coupling / (diagonal * (1.0 + damping))[:, None]
        matrix = a + np.diag(damping * a.diagonal() + 1e-300) - coupling.T @ scaled
        right = gradient - scaled.T @ residual
        n = right.size - (1 if state.rho_d <= 0 and right[-1] < 0 else 0)
        try:
            step = cho_solve(cho_factor(matrix[:n, :n] + 1e-12 * np.diag(a.diagonal()[:n])), right[:n])
        except (LinAlgError, ValueError):
            return None
        rho_d = state.rho_d if n < right.size else max(state.rho_d + float(step[-1]), 0.0)
        return self._state(state.g + self.smoothing @ step[:N_NODES], rho_d, state.m)
