"""All models on all materials in one figure: sorted error curves (as Fig. 8 of Bagher et al. 2016, whose PSNR cannot be
compared between materials; these show ΔE00)."""

import os
from collections.abc import Iterable, Mapping, Sequence

import numpy as np
import pandas as pd

from brdfatlas.constants import REFERENCE, REFERENCE_AGAIN
from brdfatlas.figures import style
from brdfatlas.figures.jobs import titles_of
from brdfatlas.files import read_record
from brdfatlas.measures.summary import LEADING, median
from brdfatlas.measures.tsv import read_tsv

#: Characters of a model's title in the legend, which is as wide as the room for it.
LONGEST = 42


def mean_errors(errors: pd.DataFrame, column: str = LEADING.key) -> pd.DataFrame:
    """An error averaged over scenes: materials x models, NaN where a fit failed.

    ``errors``: rows with material, model, scene and ``column`` (results/errors/*/images.tsv in turn). ValueError names
    a missing column.
    """
    for name in ("material", "model", "scene", column):
        if name not in errors:
            raise ValueError(f"errors: no column {name!r}")
    rows = errors[~errors["model"].isin((REFERENCE, REFERENCE_AGAIN))]
    values = pd.to_numeric(rows[column], errors="coerce")
    return rows.assign(value=values).pivot_table("value", "material", "model", aggfunc="mean", dropna=False, sort=False)


def plot_summary(
    errors: pd.DataFrame,
    diffuseness: Mapping[str, float],
    path: str | os.PathLike,
    *,
    titles: Mapping[str, str] | None = None,
    models: Sequence[str] = (),
    guide: str = "independent_g",
) -> None:
    """Two plots of ΔE00 over materials, a line a model: sorted by diffuseness, and by that of ``guide``, worst first.

    ``diffuseness``: material -> number; ``titles``: model -> name in the legend, which has the lowest median first;
    ``models``: their order, which chooses the colours. If ``guide`` is not among them the model with the lowest median
    takes its place. Where every fit or render failed the figure says so.
    """
    table = mean_errors(errors)
    models = [m for m in (models or table.columns) if m in table.columns and table[m].notna().any()]
    if not models:
        _say_so(path)
        return
    ranked = sorted(models, key=lambda model: median(table[model]))
    if guide not in models:
        guide = ranked[0]
    names = dict(titles or {})
    by_diffuseness = sorted(table.index, key=lambda material: (diffuseness.get(material, np.inf), material))
    by_error = table[guide].sort_values(ascending=False, kind="stable", na_position="first").index
    orders = (
        (by_diffuseness, "sorted by diffuseness: specular left, diffuse right"),
        (by_error, f"sorted by the {LEADING.title} of {names.get(guide, guide)}"),
    )
    count = len(table)
    with style.paper():
        marker = "o" if count <= 40 else ""
        below = 0.15 + 0.05 * max(map(len, table.index)) if count <= 40 else 0.4  # inches, of names or one line
        size = (8.4, max(7.2, 2 * below + 4.6))  # long names take nothing of the plots
        figure, axes = style.panels(2, 1, size, right=2.45, bottom=below, top=0.25, gaps=(0, below + 0.3))
        axes[1, 0].sharey(axes[0, 0])
        for axis, (order, title) in zip(axes[:, 0], orders):
            for model in ranked:
                axis.plot(
                    np.arange(count),
                    table.loc[list(order), model],
                    marker=marker,
                    markersize=2.5,
                    linewidth=1.1,
                    label=style.short(names.get(model, model), LONGEST),
                    **style.line_of(models.index(model)),
                )
            axis.set_title(f"Materials {title}", loc="left")
            axis.set(ylabel=f"{LEADING.title}, mean over scenes", xlim=(-0.5, count - 0.5))
            if table[models].min(axis=None) > 0:
                style.log_axis(axis, fine=True)
            axis.grid(axis="x", visible=False)
            if count <= 40:
                axis.set_xticks(np.arange(count), list(order), rotation=90, fontsize=6)
            else:
                axis.set_xticks([])
                axis.set_xlabel(f"{count} materials")
        figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="upper right")
        style.save(figure, path)


def _say_so(path: str | os.PathLike) -> None:
    """One line in place of curves; a job that fails here would leave the page of an earlier run."""
    with style.paper():
        figure, ((axis,),) = style.panels(1, 1, (8.4, 0.6))
        axis.text(0, 0, f"No {LEADING.title} to draw: every fit or render failed, or the references are black.")
        axis.set_axis_off()
        style.save(figure, path)


def summary_job(
    errors: Iterable[str | os.PathLike],
    descriptions: Iterable[str | os.PathLike],
    models: Sequence[str],
    path: str | os.PathLike,
) -> None:
    """Draw the sorted ΔE00 curves of all models over all materials (Bagher et al. 2016, Fig. 8)."""
    facts = [read_record(item, "name", "diffuseness") for item in descriptions]
    diffuseness = {item["name"]: item["diffuseness"] for item in facts}
    plot_summary(read_tsv(errors), diffuseness, path, titles=titles_of(models), models=models)
