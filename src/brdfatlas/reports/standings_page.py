"""Standings: wins and ties between models, classes of materials, published figures beside ours."""

import math
import os
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy.cluster.hierarchy import leaves_list, linkage

from brdfatlas.constants import REFERENCE_AGAIN
from brdfatlas.files import atomic_path
from brdfatlas.measures.ranking import LEADING, SIGNIFICANT
from brdfatlas.measures.summary import Summary
from brdfatlas.measures.tables import CLASSES, TIE_DB
from brdfatlas.measures.tsv import read_tsv
from brdfatlas.reports.data import model_facts, read_run, summarise_run
from brdfatlas.reports.pages import find_picture, render_page

#: Columns of the table of classes: measure, its statistics, heading, decimals, whether more is better. Linear PSNR
#: cannot be compared between materials: only its median stands here.
SHOWN = (
    ("de00_mean", ("mean", "median"), "ΔE00", 2, False),
    ("flip_mean", ("mean", "median"), "FLIP", 3, False),
    ("psnr_db", ("median",), "PSNR (dB)", 1, True),
)
TABLES = ("summary", "summary_brdf", "wins", "published")


def write_standings(
    output: str | os.PathLike,
    *,
    tables: str | os.PathLike,
    data: str | os.PathLike,
    figure: str | os.PathLike,
    models: Sequence[str],
    files: Mapping[str, Mapping[str, Any]] | None = None,
    statistics: str | os.PathLike | None = None,
    **links: bool,
) -> None:
    """Write the page from the tables of :mod:`.tables` in ``tables``, and copies of them into ``data``.

    ``figure``: the sorted errors of all models, of :func:`brdfatlas.figures.summary.plot_summary`; ``files``: those of
    every material, for the statistics of the fits (:func:`.data.read_run`); ``statistics``: Table I of Bagher et al.
    2016, a CSV, whose rows stand beside ours.
    """
    output, tables = Path(output), Path(tables)
    for name in TABLES:
        with atomic_path(Path(data) / f"{name}.tsv") as temporary:
            shutil.copyfile(tables / f"{name}.tsv", temporary)
    summary, wins, published = (read_tsv(tables / f"{name}.tsv") for name in ("summary", "wins", "published"))
    facts = {name: model_facts(name) for name in models}
    whole = summary[(summary["scene"] == "all") & (summary["class"] == "all")]
    render_page(
        "standings.html.j2",
        output,
        root="",
        here="standings",
        **links,
        facts=facts,
        standins=int(whole["standins"].max()),
        reconstructed=int(whole["reconstructions"].max()),
        materials=int(whole["materials"].max()),
        tie=f"{TIE_DB:g}",
        columns=[f"{title}, {kind}" for _, kinds, title, _, _ in SHOWN for kind in kinds],
        scenes=scene_rows(summary, models),
        classes=class_rows(summary, models),
        duels=duel_rows(wins, models),
        statistics=statistics_rows(summarise_run(read_run(files), facts), statistics) if files else [],
        figure=find_picture(output, Path(figure)),
        published=published.to_dict("records"),
        differs=differences(published),
        data_links=[(f"{name}.tsv", f"data/{name}.tsv") for name in TABLES],
    )


def statistics_rows(summary: Summary, published: str | os.PathLike | None) -> list[dict[str, Any]]:
    """Table I of Bagher et al. 2016 for every model, and the published row below those that it has."""
    printed: dict[str, dict[str, Any]] = {}
    if published is not None:
        printed = {row["model"]: row for row in pd.read_csv(published, comment="#").to_dict("records")}
    rows = []
    for model in summary.order():
        rows.append({"model": model, "published": False} | summary.fitting_statistics(model))
        if model in printed:
            rows.append(printed[model] | {"published": True})
    return rows


def differences(published: pd.DataFrame) -> list[tuple[str, list[str]]]:
    """What differs from the papers, each said once with the sources that it holds for."""
    notes: dict[str, list[str]] = {}
    for row in published.to_dict("records"):
        sources = notes.setdefault(row["note"], [])
        if row["source"] not in sources:
            sources.append(row["source"])
    return list(notes.items())


def clustered(duels: pd.DataFrame, names: list[str]) -> list[str]:
    """Models whose duels end alike side by side, those that win most first."""
    if len(names) < 3:
        return names
    share = (duels["wins"] - duels["losses"]) / duels["count"].clip(lower=1)
    matrix = share.unstack("other").reindex(index=names, columns=names).fillna(0).to_numpy(float)
    order = leaves_list(linkage(matrix, "average", optimal_ordering=True))
    if np.corrcoef(matrix[order].sum(1), np.arange(len(names)))[0, 1] > 0:
        order = order[::-1]
    return [names[i] for i in order]


def comparable(row: pd.Series) -> bool:
    """Whether the means of a row of the summary are over as many pictures as any model has."""
    return row["count"] > 0 and not row["missing"]


def scene_rows(summary: pd.DataFrame, models: Sequence[str]) -> dict[str, Any]:
    """Mean dE00 over all materials, a column a scene and all scenes last: {"names": [...], "rows": [...]}, the best of
    each column marked. No names where the run has one scene."""
    part = summary[summary["class"] == "all"]
    names = [name for name in dict.fromkeys(part["scene"]) if name != "all"]
    part = part.set_index(["model", "scene"])
    best = {}
    for scene in [*names, "all"]:
        column = part.xs(scene, level="scene")
        column = column[column.index.isin(models) & column.apply(comparable, axis=1).astype(bool)]
        best[scene] = column[f"{LEADING}_mean"].min()
    rows = []
    for model in [*models, REFERENCE_AGAIN]:
        if (model, "all") not in part.index:
            continue
        cells = []
        for scene in [*names, "all"]:
            row = part.loc[(model, scene)] if (model, scene) in part.index else None
            value = float("nan") if row is None else float(row[f"{LEADING}_mean"])
            is_best = model != REFERENCE_AGAIN and row is not None and comparable(row) and value == best[scene]
            cells.append({"value": value, "best": is_best})
        rows.append({"model": model, "floor": model == REFERENCE_AGAIN, "cells": cells})
    return {"names": names, "rows": rows}


def class_rows(summary: pd.DataFrame, models: Sequence[str]) -> list[dict[str, Any]]:
    """For each class of material a table: its rows, best first, with (mean, median) per measure; the best of each
    column is marked."""
    tables = []
    for class_name in CLASSES:
        part = summary[(summary["class"] == class_name) & (summary["scene"] == "all")].set_index("model")
        if part.empty:
            continue
        judged = [name for name in models if name in part.index and comparable(part.loc[name])]
        rows = []
        best_first = part[part.index.isin(models)].sort_values(f"{LEADING}_median", kind="stable").index
        for name in [*best_first, REFERENCE_AGAIN]:
            if name not in part.index:
                continue
            cells = []
            for measure, kinds, _, places, higher in SHOWN:
                for kind in kinds:
                    column = part.loc[judged, f"{measure}_{kind}"]
                    best = name in judged and part.loc[name, f"{measure}_{kind}"] == (
                        column.max() if higher else column.min()
                    )
                    cells.append({"value": part.loc[name, f"{measure}_{kind}"], "places": places, "best": bool(best)})
            counts = {key: int(part.loc[name, key]) for key in ("count", "failed", "bounds")}
            rows.append({"model": name, "floor": name == REFERENCE_AGAIN, "cells": cells} | counts)
        tables.append({"class": class_name, "rows": rows})
    return tables


def duel_rows(wins: pd.DataFrame, models: Sequence[str], measure: str = LEADING) -> dict[str, Any]:
    """Every model against every other over all materials in a measure: {"names": [...], "rows": [(name, cells)]}; a
    cell is None on the diagonal, else wins, ties, losses, their balance in [-1, 1], the mean difference, its standard
    error over materials (NaN for one material) and whether the difference is not within that error of 0."""
    found = wins[(wins["class"] == "all") & (wins["measure"] == measure)].set_index(["model", "other"])
    names = clustered(found, [name for name in models if name in found.index.get_level_values(0)])
    rows = []
    for model in names:
        cells: list[Mapping[str, Any] | None] = []
        for other in names:
            if model == other:
                cells.append(None)
                continue
            row = found.loc[(model, other)]
            cell: dict[str, Any] = {key: int(row[key]) for key in ("count", "wins", "ties", "losses")}
            balance = (cell["wins"] - cell["losses"]) / max(cell["count"], 1)
            difference, error = float(row["mean_difference"]), float(row["se_difference"])
            apart = math.isinf(difference) or not abs(difference) <= SIGNIFICANT * error
            cells.append(cell | {"balance": balance, "difference": difference, "error": error, "apart": apart})
        rows.append((model, cells))
    return {"names": names, "rows": rows}
