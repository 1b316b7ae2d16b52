"""The orthogonal factorisation rho_d + D(theta_h) F(theta_d) H(phi_d) of one channel (Bagher et al. 2016, Eq. 4).

Nothing couples its factors but their product, so every sum is a matrix product over the (90, 90, 180) block.
"""

from dataclasses import dataclass

import numpy as np

from brdfatlas.angles import GRID_SHAPE, N_PHI_D, N_THETA_D, N_THETA_H
from brdfatlas.models.bagher2016.awls import clamped, coefficients, quotient
from brdfatlas.solvers.acceleration import damped_solve

N_H, N_D, N_P = N_THETA_H, N_THETA_D, N_PHI_D


@dataclass(frozen=True)
class NaiveState:
    """``u`` = rho_s D (90), ``v`` = F (90) and ``h`` = H (180) with largest component 1, ``rho_d``."""

    u: np.ndarray
    v: np.ndarray
    h: np.ndarray
    rho_d: float
    objective: float


class NaiveProblem:
    """``weights`` and ``rho`` (GRID_SHAPE) of one channel; values with weight 0 are not looked at."""

    def __init__(self, weights: np.ndarray, rho: np.ndarray):
        self.w = np.ascontiguousarray(weights, float).reshape(-1, N_P)
        values = np.where(self.w > 0, rho.reshape(-1, N_P), 0.0)
        self.wr = self.w * values
        self.power = float(np.vdot(self.wr, values))
        self.total, self.total_r = float(self.w.sum()), float(self.wr.sum())
        self.empty_components = 0

    def start(self, u, v, h, rho_d=0.0) -> NaiveState:
        return self._state(np.asarray(u, float), np.asarray(v, float), np.asarray(h, float), rho_d)

    def _state(self, u, v, h, rho_d) -> NaiveState:
        u, v, h = clamped(u, 0.0), clamped(v, 0.0), clamped(h, 0.0)
        scale_v, scale_h = v.max(), h.max()
        if not (u.max() > 0 and scale_v > 0 and scale_h > 0):
            return NaiveState(u, v, h, rho_d, np.inf)
        u, v, h = u * (scale_v * scale_h), v / scale_v, h / scale_h
        s1, s2, r1 = self._over_phi(h)
        m = np.outer(u, v)
        value = (
            self.power - 2 * rho_d * self.total_r + rho_d**2 * self.total
            - 2 * np.vdot(m, r1) + 2 * rho_d * np.vdot(m, s1) + np.vdot(m * m, s2)
        )  # fmt: skip
        return NaiveState(u, v, h, float(rho_d), float(max(value, 0.0)))

    def _over_phi(self, h):
        sums = self.w @ np.stack([h, h * h], 1)
        return sums[:, 0].reshape(N_H, N_D), sums[:, 1].reshape(N_H, N_D), (self.wr @ h).reshape(N_H, N_D)

    def sweep(self, state: NaiveState) -> NaiveState:
        """D, F, H by Eq. 14, then rho_d and rho_s by Eqs. 16 - 18."""
        u, v, h, rho_d = state.u, state.v, state.h, state.rho_d
        s1, s2, r1 = self._over_phi(h)
        z = r1 - rho_d * s1
        u, empty_u = quotient(z @ v, s2 @ (v * v), u)
        u = clamped(u, 0.0)
        v, empty_v = quotient(u @ z, (u * u) @ s2, v)
        v = clamped(v, 0.0)
        m = np.outer(u, v).ravel()
        w1, w2, wr1 = m @ self.w, (m * m) @ self.w, m @ self.wr
        h, empty_h = quotient(wr1 - rho_d * w1, w2, h)
        h = clamped(h, 0.0)
        self.empty_components = empty_u + empty_v + empty_h
        best = coefficients(self.total, self.total_r, float(w1 @ h), float(w2 @ (h * h)), float(wr1 @ h))
        trial = self._state(u * best[1], v, h, best[0]) if best else self._state(u, v, h, rho_d)
        return trial if trial.objective <= state.objective else state

    def linearise(self, state: NaiveState):
        u, v, h, rho_d = state.u, state.v, state.h, state.rho_d
        s1, s2, r1 = self._over_phi(h)
        m = np.outer(u, v)
        z = r1 - rho_d * s1 - m * s2
        flat = m.ravel()
        w1, w2, wr1 = flat @ self.w, (flat * flat) @ self.w, flat @ self.wr
        block = self.w.reshape(GRID_SHAPE)
        n = N_H + N_D + N_P + 1
        a = np.zeros((n, n))
        iu, iv, ih, last = slice(0, N_H), slice(N_H, N_H + N_D), slice(N_H + N_D, n - 1), n - 1
        a[iu, iu] = np.diag(s2 @ (v * v))
        a[iv, iv] = np.diag((u * u) @ s2)
        a[ih, ih] = np.diag(w2)
        a[iu, iv] = s2 * m
        a[iu, ih] = np.matmul(v * v, block) * np.outer(u, h)
        a[iv, ih] = ((u * u) @ self.w.reshape(N_H, -1)).reshape(N_D, N_P) * np.outer(v, h)
        a[iu, last], a[iv, last], a[ih, last] = s1 @ v, u @ s1, w1
        a[last, last] = self.total
        a = np.triu(a) + np.triu(a, 1).T
        gradient = np.concatenate(
            [z @ v, u @ z, wr1 - rho_d * w1 - h * w2, [self.total_r - rho_d * self.total - np.vdot(m, s1)]]
        )
        return a, gradient

    def propose(self, state: NaiveState, linear, damping: float) -> NaiveState | None:
        matrix, gradient = linear
        x = np.concatenate([state.u, state.v, state.h, [state.rho_d]])
        step = damped_solve(matrix, gradient, damping, (x <= 0) & (gradient < 0))
        if step is None:
            return None
        x = x + step
        return self._state(x[:N_H], x[N_H : N_H + N_D], x[N_H + N_D : -1], max(float(x[-1]), 0.0))
