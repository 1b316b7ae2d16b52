"""The page of one model: what it costs, where it is strong and weak, formula, every material."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any
from urllib.parse import quote

import pandas as pd

from brdfatlas.constants import REFERENCE
from brdfatlas.figures.pictures import picture_file
from brdfatlas.measures.summary import LEADING, MEASURES, Summary, median, score_of
from brdfatlas.reports.data import (
    Material,
    ModelFacts,
    SceneFacts,
    fits_frame,
    model_facts,
    parameters_frame,
    read_run,
    summarise_run,
    write_tsv,
)
from brdfatlas.reports.formats import digits, storage
from brdfatlas.reports.formats import seconds as duration
from brdfatlas.reports.material_page import make_entry, parameter_rows
from brdfatlas.reports.pages import find_picture, render_page

#: Measures with a column of their own in tables over many materials; the others are in the TSV.
TABLE_MEASURES = ("de00_mean", "flip_mean", "psnr_db", "ssim")


def write_model_page(
    output: str | Path,
    *,
    model: str,
    run: Sequence[Material],
    pictures: str | Path,
    data: str | Path,
    models: Sequence[str],
    scenes: Sequence[SceneFacts],
    summary: Summary | None = None,
    **links: bool,
) -> None:
    """Write the page of one model over all materials of a run and its tables in ``data``.

    ``pictures`` holds one folder of pictures a material; ``summary`` is that of the run, made where it is not given.
    """
    output, data = Path(output), Path(data)
    summary = summary or summarise_run(run, {name: model_facts(name) for name in models})
    facts = summary.models[model]
    rows = [material_row(material, model, summary, scenes) for material in run if model not in material.absent]
    write_model_tables(data / "models" / model, model, run)
    ranked = sorted((row for row in rows if row["rank"]), key=lambda row: row["scores"][LEADING.key].mean)
    ends = [("Material", row) for row in ranked]
    if len(ranked) > 1:
        ends = [("Best", ranked[0]), ("Worst", ranked[-1])]
    shown = []
    for kind, row in ends:
        folder = Path(pictures) / row["material"]
        found = {
            "picture": find_picture(output, picture_file(folder, scenes[0].name, model)),
            "reference": find_picture(output, picture_file(folder, scenes[0].name, REFERENCE)),
        }
        shown.append((kind, row | found))
    seconds = [float(row["fit"]["seconds"]) for row in rows if row["fit"] and row["fit"]["seconds"] is not None]
    stored = sorted({row["bytes"] for row in rows if row["bytes"] is not None})
    place = list(models).index(model)
    render_page(
        "model.html.j2",
        output,
        root="../",
        here="model",
        **links,
        model=facts,
        lede=model_lede(facts, summary, rows),
        rows=rows,
        standins=sum(row["standin"] for row in rows),
        reconstructed=sum(row["reconstructed"] for row in rows),
        ends=shown,
        by_class=class_strengths(model, summary),
        previous=models[place - 1] if place else "",
        following=models[place + 1] if place + 1 < len(models) else "",
        scene=scenes[0],
        stored=[stored[0], stored[-1]] if stored else [],
        used={k: v for row in rows for k, v in ((row["fit"] or {}).get("options") or {}).items()},
        table_measures=[measure for measure in MEASURES if measure.key in TABLE_MEASURES],
        model_count=len(models),
        distributions=distributions(rows, seconds),
        data_links=[(name, f"../data/models/{quote(model)}/{name}.tsv") for name in ("fits", "parameters", "errors")],
    )


def material_row(material: Material, model: str, summary: Summary, scenes: Sequence[SceneFacts]) -> dict[str, Any]:
    """The model on one material: scores, rank by ΔE00 among the models with every picture, fit, physics checks."""
    entry = make_entry(material, model, summary.models[model], scenes)
    ranked = {name: summary.value(name, LEADING, material.name) for name in summary.complete(material.name)}
    ok = entry.fit is not None and entry.fit.get("status") == "ok"
    scores = summary.by_material[material.name]
    return {
        "material": material.name,
        "title": material.title,
        "standin": material.standin,
        "reconstructed": material.reconstructed,
        "class": summary.classes[material.name],
        "fit": entry.fit if ok else None,
        "bytes": material.stored_bytes(model),
        "physics": entry.physics,
        "reason": entry.reason,
        "unjudged": "" if LEADING.key in scores.get(model, {}) else material.unjudged_told(scenes),
        "scores": {measure.key: score_of(scores, model, measure.key) for measure in MEASURES},
        "rank": rank_of(model, ranked),
        "parameters": parameter_rows(entry) if ok else [],
    }


def rank_of(name: str, values: Mapping[str, float]) -> int | None:
    """1 for the lowest error; equal errors have one rank. None without a value."""
    return 1 + sum(value < values[name] for value in values.values()) if name in values else None


def write_model_tables(folder: Path, model: str, run: Sequence[Material]) -> None:
    """fits.tsv, parameters.tsv and errors.tsv of one model over all materials."""
    frames: dict[str, list[pd.DataFrame]] = {"fits": [], "parameters": [], "errors": []}
    for whole in run:
        own = Material(
            whole.facts, {k: v for k, v in whole.fits.items() if k == model}, whole.errors, whole.brdf_errors
        )
        frames["fits"].append(fits_frame(own))
        frames["parameters"].append(parameters_frame(own))
        frames["errors"].append(whole.errors[whole.errors["model"] == model])
    for name, parts in frames.items():
        filled = [frame for frame in parts if not frame.empty]
        write_tsv(folder / f"{name}.tsv", pd.concat(filled) if filled else parts[0])


def class_strengths(model: str, summary: Summary) -> list[dict[str, Any]]:
    """For each class of materials: the median ΔE00 of the model, its rank by it, and the best model there."""
    rows = []
    for name in dict.fromkeys(filter(None, summary.classes.values())):
        members = [material for material, found in summary.classes.items() if found == name]
        whole = [m for m in summary.models if not any(summary.missing_in[material][m] for material in members)]
        values = {m: median(summary.value(m, LEADING, material) for material in members) for m in whole}
        values = {m: value for m, value in values.items() if not math.isnan(value)}
        order = sorted(values, key=values.__getitem__)
        if order:
            best = order[0]
            judged = len(set(summary.pictured(best)) & set(members))
            about = {"class": name, "materials": judged, "value": values.get(model)}
            about["rank"] = rank_of(model, values)
            rows.append(about | {"best": best, "best_title": summary.models[best].title, "best_value": values[best]})
    return rows


def model_lede(facts: ModelFacts, summary: Summary, rows: Sequence[Mapping]) -> str:
    """How a model did: size, time, median ΔE00, where it is first, what failed."""
    text, name = facts.paper, facts.name
    stored, seconds = summary.cost(name, "bytes"), summary.cost(name, "seconds")
    middle = " (median)" if len(rows) > 1 else ""
    if not math.isnan(stored):
        text += f"; {storage(stored)} per material{middle if facts.variable_size else ''}"
    if facts.given:
        text += ", given, not fitted"
    elif not math.isnan(seconds):
        text += f", fitted in {duration(seconds)}{middle}"
    value = summary.value(name)
    ranked = [row for row in rows if row["rank"]]
    if not math.isnan(value):
        count = len(summary.pictured(name))
        over = f", the median over {count} materials" if count > 1 else ""
        text += f". ΔE00 {digits(value, LEADING.digits)}{over}"
        firsts = sum(row["rank"] == 1 for row in ranked)
        if firsts:
            text += f"; best on {firsts} of them" if len(ranked) > 1 else "; the best model on it"
    failed = sum(bool(row["reason"]) for row in rows)
    if failed:
        text += f". It failed on {failed} material{'s' if failed > 1 else ''}: the reason is in the table"
    return text + "."


def distributions(rows: Sequence[Mapping], seconds: Sequence[float]) -> list[dict[str, Any]]:
    """A strip of dots for every parameter and for the time of a fit, where there is more than one value."""
    values: dict[str, list[float]] = {}
    for row in rows:
        for name, numbers in row["parameters"]:
            for index, value in enumerate(numbers):
                label = name if len(numbers) == 1 else f"{name}[{index + 1}]"
                values.setdefault(label, []).append(value)
    values["seconds of a fit"] = list(seconds)
    return [strip(label, numbers) for label, numbers in values.items() if len(numbers) > 1]


def strip(label: str, values: Sequence[float]) -> dict[str, Any]:
    """A strip of dots: where values fall between their extremes, logarithmic when they span two decades."""
    ordered = sorted(values)
    low, high = ordered[0], ordered[-1]
    middle = median(ordered)
    log = low > 0 and high / low > 100

    def place(value: float) -> float:
        if high == low:
            return 150.0
        share = math.log(value / low) / math.log(high / low) if log else (value - low) / (high - low)
        return round(6 + 288 * share, 1)

    stacked: dict[int, int] = {}
    dots = []
    for value in ordered:
        x = place(value)
        level = stacked[round(x / 5)] = stacked.get(round(x / 5), -1) + 1
        dots.append((x, round(30 - 4.2 * (level % 6), 1)))
    about = {"label": label, "count": len(ordered), "low": low, "high": high, "log": log, "dots": dots}
    return about | {"median": middle, "median_x": place(middle)}


def write_model_pages(
    folder: str | Path,
    *,
    files: Mapping[str, Mapping[str, Any]],
    pictures: str | Path,
    data: str | Path,
    models: Sequence[str],
    scenes: Sequence[SceneFacts],
    **links: bool,
) -> None:
    """Write the pages of all models: each ranks its model among the others, so they are made together."""
    run = read_run(files)
    summary = summarise_run(run, {name: model_facts(name) for name in models})
    shared = {"pictures": pictures, "data": data, "models": models, "scenes": scenes, "summary": summary}
    for model in models:
        write_model_page(Path(folder) / f"{model}.html", model=model, run=run, **shared, **links)
