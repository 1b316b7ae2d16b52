"""Safeguarded joint steps: what makes alternating least squares fast without changing what it minimises.

Alternating updates crawl along valleys in which several factors move together (D against F and G, rho_d against all).
After some sweeps a damped Gauss-Newton (Levenberg-Marquardt) step moves every unknown at once. It is taken only
if the objective falls, and every accepted state obeys the same clamps, so the sequence of objectives never rises.
"""

from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve


class State(Protocol):
    """A point of the minimisation with its objective."""

    objective: float


class Problem(Protocol):
    """What the driver needs of a model's channel."""

    def sweep(self, state: Any) -> Any:
        """One published iteration; never raises the objective."""

    def linearise(self, state: Any) -> Any:
        """What :meth:`propose` needs at this state, computed once."""

    def propose(self, state: Any, linear: Any, damping: float) -> Any:
        """The state after a joint step with this damping, clamped and with its objective; None if singular."""


@dataclass
class Trace:
    """How a minimisation went. ``history`` holds the objective after every iteration, the start's first; ``states``, if
    it is a list, the points themselves."""

    history: list[float] = field(default_factory=list)
    states: list[Any] | None = None
    sweeps: int = 0
    joint_steps: int = 0
    converged: bool = False

    def note(self, state: Any) -> None:
        """Keep the point that an iteration reached."""
        self.history.append(state.objective)
        if self.states is not None:
            self.states.append(state)

    @property
    def iterations(self) -> int:
        return self.sweeps + self.joint_steps


def alternate(problem: Problem, state: Any, trace: Trace, *, sweeps: int, tolerance: float) -> Any:
    """Plain published iterations until one lowers the objective by less than ``tolerance`` of it (three in a row)."""
    quiet = 0
    for _ in range(sweeps):
        before = state.objective
        state = problem.sweep(state)
        trace.sweeps += 1
        trace.note(state)
        quiet = quiet + 1 if before - state.objective <= tolerance * before else 0
        if quiet == 3:
            trace.converged = True
            break
    return state


def accelerate(
    problem: Problem, state: Any, trace: Trace, *, steps: int, tolerance: float, damping: float = 1e-3
) -> Any:
    """Joint steps until two in a row lower the objective by less than ``tolerance`` of it, or none lowers it."""
    quiet = 0
    for _ in range(steps):
        linear = problem.linearise(state)
        trial = None
        for attempt in range(12):
            trial = problem.propose(state, linear, damping)
            if trial is not None and trial.objective < state.objective:
                break
            trial = None
            damping *= 4.0 if attempt == 0 else 10.0
        if trial is None:
            trace.converged = True
            break
        gain = state.objective - trial.objective
        quiet = quiet + 1 if gain <= tolerance * state.objective else 0
        state = trial
        damping = max(damping / 8.0, 1e-9)
        trace.joint_steps += 1
        trace.note(state)
        if quiet == 2:
            trace.converged = True
            break
    return state


def damped_solve(matrix: np.ndarray, gradient: np.ndarray, damping: float, held: np.ndarray) -> np.ndarray | None:
    """The step of (matrix + damping diag(matrix)) step = gradient with the unknowns in ``held`` fixed."""
    free = ~held
    diagonal = matrix.diagonal()
    scale = diagonal[free] + 1e-12 * diagonal.max()
    system = matrix[np.ix_(free, free)]
    system[np.diag_indices_from(system)] += damping * scale + 1e-300
    try:
        step = cho_solve(cho_factor(system, overwrite_a=True, check_finite=False), gradient[free], check_finite=False)
    except LinAlgError:
        return None
    out = np.zeros(gradient.size)
    out[free] = step
    return out if np.isfinite(out).all() else None


def thinned(history: list[float], most: int = 200) -> list[float]:
    """At most ``most`` points of a convergence curve, evenly spaced, with both ends."""
    if len(history) <= most:
        return [float(value) for value in history]
    return [float(history[k]) for k in np.unique(np.linspace(0, len(history) - 1, most).round().astype(int))]
