"""The index: what the run found, in a sentence, tables, plots; and the numbers that its scripts read."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd
import yaml

from brdfatlas.files import read_json, write_text
from brdfatlas.measures.ranking import best_rows, count_missing
from brdfatlas.reports.data import (
    MEASURES,
    NOISE_FLOOR,
    Material,
    ModelFacts,
    SceneFacts,
    best_models,
    fits_frame,
    model_facts,
    parameters_frame,
    pareto_front,
    score_models,
    score_of,
    write_tsv,
)
from brdfatlas.reports.formats import seconds as duration
from brdfatlas.reports.formats import storage
from brdfatlas.reports.model_page import TABLE_MEASURES
from brdfatlas.reports.pages import as_script, render_page


def write_index(
    output: str | Path,
    *,
    run_file: str | Path,
    materials: Sequence[Material],
    data: str | Path,
    models: Sequence[str],
    scenes: Sequence[SceneFacts],
    **links: bool,
) -> None:
    """Write the index, the tables of the whole run and ``atlas.js``, which index and compare page read.

    ``run_file`` is the record of the run.
    """
    output, data = Path(output), Path(data)
    run = read_json(run_file)
    facts = [model_facts(name) for name in models]
    rows, tables = run_tables(run, materials, facts)
    errors = tables["errors"]
    failures = list_failures(materials, {item.name: item.title for item in facts})
    for name, frame in tables.items():
        write_tsv(data / f"{name}.tsv", frame)
    write_text(data / "atlas.js", atlas_script(materials, facts, scenes))
    versions = list((run.get("versions") or {}).items())
    versions += [(key, run[key]) for key in ("revision", "machine") if run.get(key)]
    render_page(
        "index.html.j2",
        output,
        root="",
        here="index",
        **links,
        findings=findings(materials, rows),
        standins=sum(material.standin for material in materials),
        materials=[
            {"name": m.name, "title": m.title, "standin": m.standin, "class": str(m.facts.get("class") or "")}
            for m in materials
        ],
        models=facts,
        scenes=scenes,
        rows=rows,
        table_measures=[measure for measure in MEASURES if measure.key in TABLE_MEASURES],
        pictures=sum(errors[["material", "scene"]].drop_duplicates().shape[:1]),
        failures=failures,
        left_out=run.get("left_out") or [],
        versions=versions,
        config=yaml.safe_dump(run.get("config") or {}, sort_keys=False, allow_unicode=True),
        options=yaml.safe_dump(run.get("models") or {}, sort_keys=False, allow_unicode=True),
        inputs=run.get("inputs") or [],
        data_links=[(f"{name}.tsv", f"data/{name}.tsv") for name in tables],
    )


def run_tables(
    run: Mapping[str, Any], materials: Sequence[Material], facts: Sequence[ModelFacts]
) -> tuple[list[dict[str, Any]], dict[str, pd.DataFrame]]:
    """The rows of the table of models, and every table of the run by name."""
    errors = _stack([material.errors for material in materials])
    fits = _stack([fits_frame(material) for material in materials])
    rows = model_rows(facts, errors, fits)
    return rows, {
        "materials": materials_frame(materials),
        "models": models_frame(rows),
        "errors": errors,
        "brdf": _stack([material.brdf_errors for material in materials]),
        "fits": fits,
        "parameters": _stack([parameters_frame(material) for material in materials]),
        "left_out": pd.DataFrame(run.get("left_out") or [], columns=["name", "path", "reason"]),
    }


def _stack(frames: Sequence[pd.DataFrame]) -> pd.DataFrame:
    filled = [frame for frame in frames if not frame.empty]
    return pd.concat(filled, ignore_index=True) if filled else frames[0].copy()


def materials_frame(materials: Sequence[Material]) -> pd.DataFrame:
    """One row a material."""
    return pd.DataFrame(
        [
            {
                "material": m.name,
                "standin": int(m.standin),
                "class": m.facts.get("class"),
                "diffuseness": m.facts.get("diffuseness"),
                **{f"albedo_{c}": v for c, v in zip("rgb", m.facts.get("albedo") or [], strict=False)},
                "valid_cells": m.facts.get("valid_cells"),
                "source": m.facts.get("source"),
                "sha256": m.facts.get("sha256"),
            }
            for m in materials
        ]
    )


def model_rows(facts: Sequence[ModelFacts], errors: pd.DataFrame, fits: pd.DataFrame) -> list[dict[str, Any]]:
    """The table of models: means, median storage and time, wins and failures, with the best of each column marked.

    ``missing``: pictures that another model has and this one lacks; its means are never marked as best.
    """
    scores = score_models(errors)
    names = [item.name for item in facts]
    wins = best_rows(errors, names, measure="psnr_db")["model"].value_counts()
    missing = count_missing(errors, names)
    rows = []
    for item in [*facts, None]:
        name = item.name if item else NOISE_FLOOR
        mine = fits[fits["model"] == name]
        good = mine[mine["status"] == "ok"]
        pictures = errors[errors["model"] == name]
        if item is None and pictures.empty:
            continue
        seconds, stored = (pd.to_numeric(good[key]).median() for key in ("seconds", "bytes"))
        rows.append(
            {
                "name": name,
                "title": item.title if item else "noise floor (reference, other seed)",
                "facts": item,
                "floor": item is None,
                "bytes": None if pd.isna(stored) else float(stored),
                "seconds": None if pd.isna(seconds) else float(seconds),
                "scores": {measure.key: score_of(scores, name, measure.key) for measure in MEASURES},
                "wins": int(wins.get(name, 0)),
                "missing": missing.get(name, 0),
                "failures": int((mine["status"] != "ok").sum())
                if len(mine)
                else int((pictures["status"] != "ok").sum()),
                "best": {"bytes": False, "seconds": False, "wins": False},
            }
        )
    real = [row for row in rows if not row["floor"]]
    for key, value_of, better in (
        ("bytes", lambda row: row["bytes"], min),
        ("seconds", lambda row: row["seconds"], min),
        ("wins", lambda row: row["wins"] or None, max),
    ):
        known = [value for row in real if (value := value_of(row)) is not None]
        for row in real:
            row["best"][key] = bool(known) and value_of(row) == better(known)
    complete = [row["name"] for row in real if not row["missing"]]
    for measure in MEASURES:
        for row in real:
            row["best"][measure.key] = row["name"] in best_models(scores, complete, measure)
    return rows


def models_frame(rows: Sequence[Mapping[str, Any]]) -> pd.DataFrame:
    """The table of models as plain numbers."""
    return pd.DataFrame(
        [
            {
                "model": row["name"],
                "status": row["facts"].status if row["facts"] else "noise floor",
                "paper": row["facts"].citation if row["facts"] else "",
                "bytes": row["bytes"],
                "free_parameters": numbers_of(row["facts"]),
                "fit_seconds_median": row["seconds"],
                **{f"{key}_mean": value.mean for key, value in row["scores"].items()},
                "psnr_se_of_mean_db": row["scores"]["psnr_db"].error,
                "pictures": row["scores"]["psnr_db"].count,
                "pictures_missing": row["missing"],
                "pictures_best": row["wins"],
                "failures": row["failures"],
            }
            for row in rows
        ]
    )


def numbers_of(facts: ModelFacts | None) -> int | None:
    """How many numbers a fit has; None where the material decides."""
    return facts.free_parameters if facts and not facts.variable_size else None


def list_failures(materials: Sequence[Material], titles: Mapping[str, str]) -> list[dict[str, Any]]:
    """Every failed fit or render with its reason."""
    found = []
    for material in materials:
        about = {"material": material.name, "title": material.title, "standin": material.standin}
        failed = set()
        for model, record in material.fits.items():
            if record.get("status") != "ok":
                failed.add(model)
                reason = " ".join(str(record.get("reason") or "no reason given").split())
                found.append(about | {"model": model, "model_title": titles.get(model, model), "reason": reason})
        bad = material.errors[material.errors["status"] != "ok"]
        for model, rows in bad.groupby("model"):
            if model not in failed and model in titles:
                reason = f"render failed: {', '.join(map(str, rows['scene']))}"
                found.append(about | {"model": model, "model_title": titles[model], "reason": reason})
    return found


def findings(materials: Sequence[Material], rows: Sequence[Mapping[str, Any]]) -> str:
    """What this run says, in a few sentences, from its own numbers. Means are compared over the same pictures only."""
    alive = [row for row in rows if not row["floor"] and not math.isnan(row["scores"]["psnr_db"].mean)]
    if not alive:
        return "No model has a picture in this run: every fit or render failed."
    aside = [row["title"] for row in alive if row["missing"]]
    alive = [row for row in alive if not row["missing"]]
    if not alive:
        return "No model has every picture of this run, so their means cannot be compared: fits or renders failed."
    ranked = sorted(alive, key=lambda row: -row["scores"]["psnr_db"].mean)
    best = ranked[0]
    psnr = best["scores"]["psnr_db"]
    text = f"{best['title']} comes closest to the references: {_mean_in_words(best, 'dB PSNR on average')} over "
    text += f"{psnr.count} picture{'s' if psnr.count > 1 else ''}"
    if best["bytes"] is not None:
        text += f", with {storage(best['bytes'])} a material"
        others = [row for row in ranked[1:] if row["bytes"] is not None and row["bytes"] < best["bytes"]]
        if others:
            small = others[0]
            gap = psnr.mean - small["scores"]["psnr_db"].mean
            text += f". {small['title']} needs {storage(small['bytes'])} and "
            text += f"loses {gap:.1f} dB" if math.isfinite(gap) else f"comes to {_mean_in_words(small)}"
    quick = [row for row in alive if row["seconds"] is not None]
    if len(quick) > 1:
        fastest = min(quick, key=lambda row: row["seconds"])
        text += f". The fastest fit is {fastest['title']}, {duration(fastest['seconds'])} a material"
        text += f", with {_mean_in_words(fastest)}"
    names = [row["name"] for row in alive if math.isfinite(row["scores"]["psnr_db"].mean)]
    hardest = {m.title: _mean_over(m, names) for m in materials}
    hardest = {title: value for title, value in hardest.items() if not math.isnan(value)}
    if len(hardest) > 1:
        low, high = min(hardest, key=hardest.__getitem__), max(hardest, key=hardest.__getitem__)
        text += f". Hardest for all is {low} ({hardest[low]:.1f} dB over the models)"
        text += f", easiest {high} ({hardest[high]:.1f} dB)"
    front = pareto_front(
        {row["name"]: (row["bytes"], row["scores"]["psnr_db"].mean) for row in alive if row["bytes"] is not None}, True
    )
    if len(front) > 2:
        text += f". {len(front)} of {len(alive)} models are worth their bytes: no smaller one is as good"
    if aside:
        text += f". Set aside, because failures left {'it' if len(aside) == 1 else 'them'} fewer pictures: "
        text += ", ".join(aside)
    return text + "."


def _mean_in_words(row: Mapping[str, Any], unit: str = "dB") -> str:
    psnr = row["scores"]["psnr_db"]
    if math.isinf(psnr.mean):
        return "no finite mean PSNR, equal to the reference on some picture"
    return f"{'at least ' if math.isinf(psnr.error) else ''}{psnr.mean:.1f} {unit}"


def _mean_over(material: Material, models: Sequence[str]) -> float:
    values = [score_of(material.scores, model).mean for model in models]
    values = [value for value in values if not math.isnan(value)]
    return sum(values) / len(values) if values else float("nan")


def atlas_script(materials: Sequence[Material], models: Sequence[ModelFacts], scenes: Sequence[SceneFacts]) -> str:
    """``window.ATLAS``: numbers of the whole run, in columns, rounded to what is shown, for index and compare page.

    ``values[measure]`` is flat: scene, then material, then model (models, then the noise floor last); ``best`` are the
    places of the best PSNRs (:func:`brdfatlas.measures.ranking.best_rows`).
    """
    names = [model.name for model in models] + [NOISE_FLOOR]
    keys = [measure.key for measure in MEASURES] + ["psnr_se_db"]
    values: dict[str, list[float | None]] = {key: [None] * (len(scenes) * len(materials) * len(names)) for key in keys}
    scene_place = {scene.name: i for i, scene in enumerate(scenes)}
    model_place = {name: i for i, name in enumerate(names)}
    for j, material in enumerate(materials):
        for row in material.errors.to_dict("records"):
            s, k = scene_place.get(str(row["scene"])), model_place.get(str(row["model"]))
            if s is None or k is None or row["status"] != "ok":
                continue
            place = (s * len(materials) + j) * len(names) + k
            for key in keys:
                values[key][place] = _rounded(row.get(key))
    reasons = {
        f"{f['material']}/{f['model']}": f["reason"]
        for f in list_failures(materials, {m.name: m.title for m in models})
    }
    content = {
        "materials": [
            {
                "name": m.name,
                "title": m.title,
                "standin": m.standin,
                "class": str(m.facts.get("class") or ""),
                "diffuseness": _rounded(m.facts.get("diffuseness")),
            }
            for m in materials
        ],
        "models": [
            {
                "name": m.name,
                "title": m.title,
                "paper": m.paper,
                "status": m.status.split(":")[0],
                "reciprocal": m.reciprocal,
            }
            for m in models
        ],
        "scenes": [{"name": s.name, "title": s.label, "exposure": s.exposure, "gamma": s.gamma} for s in scenes],
        "measures": [
            {"key": m.key, "title": m.label, "higher": m.higher_is_better, "digits": m.digits} for m in MEASURES
        ],
        "seconds": [[_rounded((m.fits.get(model.name) or {}).get("seconds")) for model in models] for m in materials],
        "bytes": [[m.stored_bytes(model.name) for model in models] for m in materials],
        "best": sorted(
            (scene_place[row.scene] * len(materials) + j) * len(names) + model_place[row.model]
            for j, material in enumerate(materials)
            for row in best_rows(material.errors, names[:-1], measure="psnr_db").itertuples()
            if row.scene in scene_place
        ),
        "reasons": reasons,
        "values": values,
    }
    return as_script("ATLAS", content)


def _rounded(value: Any) -> float | None:
    if value is None or isinstance(value, str):
        return None
    value = float(value)
    if math.isnan(value):
        return None
    return value if math.isinf(value) else float(f"{value:.4g}")
