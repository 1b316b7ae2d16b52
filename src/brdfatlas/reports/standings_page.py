"""Standings: wins and ties between models, classes of materials, published figures beside ours."""

import os
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from brdfatlas.files import atomic_path
from brdfatlas.reports.data import NOISE_FLOOR, model_facts
from brdfatlas.reports.pages import find_picture, render_page
from brdfatlas.tables import CLASSES, TIE_DB
from brdfatlas.tsv import read_tsv

#: Columns of the table of classes: measure, heading, decimals, whether more is better.
SHOWN = (("psnr_db", "PSNR (dB)", 1, True), ("de00_mean", "ΔE00", 2, False), ("flip_mean", "FLIP", 3, False))
TABLES = ("summary", "summary_brdf", "wins", "published")


def write_standings(
    output: str | os.PathLike,
    *,
    tables: str | os.PathLike,
    data: str | os.PathLike,
    figure: str | os.PathLike,
    models: Sequence[str],
    **links: bool,
) -> None:
    """Write the page from the tables of :mod:`brdfatlas.tables` in ``tables``, and copies of them into ``data``.

    ``figure``: the sorted errors of all models, of :func:`brdfatlas.figures.summary.plot_summary`.
    """
    output, tables = Path(output), Path(tables)
    for name in TABLES:
        with atomic_path(Path(data) / f"{name}.tsv") as temporary:
            shutil.copyfile(tables / f"{name}.tsv", temporary)
    summary, wins, published = (read_tsv(tables / f"{name}.tsv") for name in ("summary", "wins", "published"))
    facts = {name: model_facts(name) for name in models}
    whole = summary[(summary["model"] == models[0]) & (summary["scene"] == "all") & (summary["class"] == "all")]
    render_page(
        "standings.html.j2",
        output,
        root="",
        here="standings",
        **links,
        facts=facts,
        standins=int(whole["standins"].sum()),
        tie=f"{TIE_DB:g}",
        measures=[(name, title, places) for name, title, places, _ in SHOWN],
        classes=class_rows(summary, models),
        duels=duel_rows(wins, models),
        figure=find_picture(output, Path(figure)),
        published=published.to_dict("records"),
        data_links=[(f"{name}.tsv", f"data/{name}.tsv") for name in TABLES],
    )


def class_rows(summary: pd.DataFrame, models: Sequence[str]) -> list[dict[str, Any]]:
    """For each class of material a table: its rows with (mean, median) per measure, the best of each column marked."""
    tables = []
    for class_name in CLASSES:
        part = summary[(summary["class"] == class_name) & (summary["scene"] == "all")].set_index("model")
        if part.empty:
            continue
        judged = [name for name in models if name in part.index and part.loc[name, "count"] > 0]
        rows = []
        for name in [*(name for name in models if name in part.index), NOISE_FLOOR]:
            if name not in part.index:
                continue
            cells = []
            for measure, _, places, higher in SHOWN:
                for kind in ("mean", "median"):
                    column = part.loc[judged, f"{measure}_{kind}"]
                    best = name in judged and part.loc[name, f"{measure}_{kind}"] == (
                        column.max() if higher else column.min()
                    )
                    cells.append({"value": part.loc[name, f"{measure}_{kind}"], "places": places, "best": bool(best)})
            counts = {key: int(part.loc[name, key]) for key in ("count", "failed", "bounds")}
            rows.append({"model": name, "floor": name == NOISE_FLOOR, "cells": cells} | counts)
        tables.append({"class": class_name, "rows": rows})
    return tables


def duel_rows(wins: pd.DataFrame, models: Sequence[str]) -> dict[str, Any]:
    """Every model against every other over all materials: {"names": [...], "rows": [(name, cells)]}; a cell is None on
    the diagonal, else wins, ties, losses and their balance in [-1, 1]."""
    found = wins[wins["class"] == "all"].set_index(["model", "other"])
    names = [name for name in models if name in found.index.get_level_values(0)]
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
            cells.append(cell | {"balance": balance, "difference": float(row["mean_difference_db"])})
        rows.append((model, cells))
    return {"names": names, "rows": rows}
