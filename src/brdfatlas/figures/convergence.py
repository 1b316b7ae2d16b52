"""How the factors of a fit with several starts move to their ends, one picture an iteration."""

from collections.abc import Iterator, Sequence

import numpy as np
from matplotlib import pyplot

from brdfatlas.angles import theta_d_centres, theta_h_centres
from brdfatlas.figures import style
from brdfatlas.models.bagher2016.awls import g_nodes
from brdfatlas.models.bagher2016.factors import relative
from brdfatlas.models.bagher2016.independent_g import Run

#: Inches and dots an inch: 960 x 360 pixels.
SIZE, DOTS = (8.0, 3.0), 120
#: The least D that is shown, as a share of its largest value.
DECADES = 1e-7


def shown_curves(run: Run, iteration: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """D (theta_h), F (theta_d) and G (theta) of a start after so many iterations, or at its end, each relative to its
    largest value; (90,) each."""
    state = run.trace.states[min(iteration, len(run.trace.states) - 1)]
    d, f = state.u[0], state.v[0]
    return d / d.max(), f / f.max(), state.g


def convergence_frames(runs: Sequence[Run], *, still: int = 6) -> Iterator[np.ndarray]:
    """Pictures (h, w, 3) uint8 of the factors of all starts after 0, 1, 2 ... iterations and of their relative
    objectives; the last one ``still`` times. Each start stops where it was given up or settled."""
    power = runs[0].problem.power
    longest = max(len(run.trace.states) for run in runs)
    angles = [np.rad2deg(a) for a in (theta_h_centres(), theta_d_centres(), g_nodes())]
    histories = [np.maximum(relative(run.trace.history, power), 1e-16) for run in runs]
    low, high = min(h.min() for h in histories), max(h.max() for h in histories)
    with style.paper():
        figure, axes = style.panels(1, 4, SIZE, top=0.3, bottom=0.7, gaps=(0.5, 0))
        axes = axes[0]
        figure.set_dpi(DOTS)
        lines = [
            [axis.plot([], [], label=run.name, **style.line_of(n))[0] for axis in axes] for n, run in enumerate(runs)
        ]
        for axis, name, symbol in zip(axes, ("θh", "θd", "θ"), ("D", "F", "G")):
            axis.set(xlabel=f"{name} (degrees)", title=f"{symbol} / largest", xlim=(0, 90), ylim=(0, 1.02))
            axis.set_xticks([0, 30, 60, 90])
        style.root_axis(axes[0])
        style.log_axis(axes[0], DECADES, 2)
        axes[3].set(xlabel="iteration", title="objective (relative)", xlim=(0, longest))
        style.log_axis(axes[3], low / 2, high * 2)
        figure.legend(*axes[0].get_legend_handles_labels(), loc="lower center", ncols=len(runs))
        for iteration in range(longest):
            for run, history, own in zip(runs, histories, lines):
                for line, angle, curve in zip(own, angles, shown_curves(run, iteration)):
                    line.set_data(angle, np.maximum(curve, DECADES / 10))
                own[3].set_data(np.arange(len(history))[: iteration + 1], history[: iteration + 1])
            figure.canvas.draw()
            frame = np.asarray(figure.canvas.buffer_rgba())[..., :3].copy()
            for _ in range(still if iteration == longest - 1 else 1):
                yield frame
        pyplot.close(figure)
