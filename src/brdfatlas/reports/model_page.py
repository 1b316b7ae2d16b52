"""The page of one model: formula and source, best and worst materials, where its parameters fall, physics checks."""

import math
import statistics
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any
from urllib.parse import quote

import pandas as pd

from brdfatlas.constants import REFERENCE
from brdfatlas.figures.pictures import picture_file
from brdfatlas.reports.data import (
    MEASURES,
    Material,
    ModelFacts,
    SceneFacts,
    fits_frame,
    model_facts,
    parameters_frame,
    read_run,
    score_of,
    write_tsv,
)
from brdfatlas.reports.formats import seconds as duration
from brdfatlas.reports.formats import storage
from brdfatlas.reports.material_page import make_entry, parameter_rows
from brdfatlas.reports.pages import find_picture, render_page

#: Measures with a column of their own in tables over many materials; the others are in the TSV.
TABLE_MEASURES = ("psnr_db", "psnr_tonemapped_db", "de00_mean", "flip_mean", "ssim")


def write_model_page(
    output: str | Path,
    *,
    model: str,
    run: Sequence[Material],
    pictures: str | Path,
    data: str | Path,
    models: Sequence[str],
    scenes: Sequence[SceneFacts],
    **links: bool,
) -> None:
    """Write the page of one model over all materials of a run and its tables in ``data``.

    ``pictures`` holds one folder of pictures a material.
    """
    output, data = Path(output), Path(data)
    facts = model_facts(model)
    rows, distributions, values = [], [], {}
    seconds = []
    used: dict[str, Any] = {}
    for whole in run:
        material = Material(
            whole.facts, {k: v for k, v in whole.fits.items() if k == model}, whole.errors, whole.brdf_errors
        )
        entry = make_entry(whole, model, facts, scenes)
        means = {name: score_of(whole.scores, name).mean for name in models if not whole.missing.get(name)}
        order = sorted((name for name in means if not math.isnan(means[name])), key=lambda name: -means[name])
        ok = entry.fit is not None and entry.fit.get("status") == "ok"
        rows.append(
            {
                "material": material.name,
                "title": material.title,
                "standin": material.standin,
                "class": str(material.facts.get("class") or ""),
                "fit": entry.fit if ok else None,
                "bytes": whole.stored_bytes(model),
                "physics": entry.physics,
                "reason": entry.reason,
                "scores": {measure.key: score_of(whole.scores, model, measure.key) for measure in MEASURES},
                "rank": order.index(model) + 1 if model in order else None,
                "frame": (
                    fits_frame(material),
                    parameters_frame(material),
                    material.errors[material.errors["model"] == model],
                ),
            }
        )
        if ok and entry.fit:
            used |= {key: value for key, value in (entry.fit.get("options") or {}).items()}
            if entry.fit.get("seconds") is not None:
                seconds.append(float(entry.fit["seconds"]))
            for name, numbers in parameter_rows(entry):
                for index, value in enumerate(numbers):
                    label = name if len(numbers) == 1 else f"{name}[{index + 1}]"
                    values.setdefault(label, []).append(value)
    distributions = [strip(label, numbers) for label, numbers in values.items() if len(numbers) > 1]
    names = ("fits", "parameters", "errors")
    for place, name in enumerate(names):
        frames = [frame for row in rows if not (frame := row["frame"][place]).empty]
        table = pd.concat(frames) if frames else rows[0]["frame"][place]
        write_tsv(data / "models" / model / f"{name}.tsv", table)
    ranked = sorted(
        (row for row in rows if not math.isnan(row["scores"]["psnr_db"].mean)),
        key=lambda row: -row["scores"]["psnr_db"].mean,
    )
    ends, ends_shown = [], min(2, len(ranked) // 2)
    for kind, chosen in (("Best", ranked[:ends_shown]), ("Worst", ranked[len(ranked) - ends_shown :])):
        for row in chosen:
            folder = Path(pictures) / row["material"]
            picture = find_picture(output, picture_file(folder, scenes[0].name, model))
            reference = find_picture(output, picture_file(folder, scenes[0].name, REFERENCE))
            ends.append(
                (kind, row | {"psnr": row["scores"]["psnr_db"].mean, "picture": picture, "reference": reference})
            )
    sizes = [row["bytes"] for row in rows if row["bytes"] is not None]
    place = list(models).index(model)
    render_page(
        "model.html.j2",
        output,
        root="../",
        here="model",
        **links,
        model=facts,
        lede=model_lede(facts, ranked, rows, seconds),
        stored=(min(sizes), max(sizes)) if sizes else None,
        previous=models[place - 1] if place else "",
        following=models[place + 1] if place + 1 < len(models) else "",
        standins=sum(row["standin"] for row in rows),
        rows=rows,
        used=used,
        ends=ends if len(ranked) > 1 else [],
        scene=scenes[0],
        table_measures=[measure for measure in MEASURES if measure.key in TABLE_MEASURES],
        model_count=len(models),
        distributions=distributions,
        times=strip("seconds of a fit", seconds) if len(seconds) > 1 else None,
        data_links=[(name, f"../data/models/{quote(model)}/{name}.tsv") for name in names],
    )


def model_lede(facts: ModelFacts, ranked: Sequence[Mapping], rows: Sequence[Mapping], seconds: Sequence[float]) -> str:
    """One sentence on how a model did."""
    failed = sum(bool(row["reason"]) for row in rows)
    stored = [row["bytes"] for row in rows if row["bytes"] is not None]
    text = facts.paper
    if stored:
        text += f", {storage(statistics.median(stored))} a material"
        text += " (median)" if min(stored) < max(stored) else ""
    if seconds:
        text += f", fitted in {duration(sorted(seconds)[len(seconds) // 2])} (median)"
    if ranked:
        mean = sum(row["scores"]["psnr_db"].mean for row in ranked) / len(ranked)
        text += f"; {mean:.1f} dB PSNR on average over {len(ranked)} material{'s' if len(ranked) > 1 else ''}"
        firsts = sum(row["rank"] == 1 for row in rows)
        if firsts:
            text += f", first on {firsts} of them"
    if failed:
        text += f"; failed on {failed}, with the reasons below"
    return text + "."


def strip(label: str, values: Sequence[float]) -> dict[str, Any]:
    """A strip of dots: where values fall between their extremes, logarithmic when they span two decades."""
    ordered = sorted(values)
    low, high = ordered[0], ordered[-1]
    middle = ordered[len(ordered) // 2]
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
    return {
        "label": label,
        "count": len(ordered),
        "low": low,
        "high": high,
        "median": middle,
        "median_x": place(middle),
        "log": log,
        "dots": dots,
    }


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
    for model in models:
        page = Path(folder) / f"{model}.html"
        write_model_page(
            page, model=model, run=run, pictures=pictures, data=data, models=models, scenes=scenes, **links
        )
