"""The index: what the run found, which model it recommends, and the numbers that its scripts read."""

import itertools
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd
import yaml

from brdfatlas.constants import REFERENCE_AGAIN
from brdfatlas.export.targets import stem_of
from brdfatlas.files import read_record, write_text
from brdfatlas.measures.ranking import best_rows
from brdfatlas.measures.summary import BUDGETS, LEADING, MEASURES, PSNR, Measure, Summary, score_of
from brdfatlas.reports.data import (
    FAMILIES,
    Material,
    ModelFacts,
    SceneFacts,
    fits_frame,
    model_facts,
    parameters_frame,
    stack,
    summarise_run,
    write_tsv,
)
from brdfatlas.reports.fit_files import files_of
from brdfatlas.reports.formats import digits, storage
from brdfatlas.reports.pages import as_script, render_page

#: Above so many materials the recommendation has a row a class, which opens into its materials.
FEW_MATERIALS = 12
#: Conditions that a reader may set on the recommendation, in the order of the bits of ``ATLAS.recommended``.
SWITCHES = ("reciprocal", "published", "energy")
#: Measures that the leaderboard shows before a reader chooses others.
SHOWN = ("de00_mean", "flip_mean", "psnr_db")


def write_index(
    output: str | Path,
    *,
    run_file: str | Path,
    materials: Sequence[Material],
    listings: Sequence[str | Path],
    data: str | Path,
    models: Sequence[str],
    scenes: Sequence[SceneFacts],
    **links: bool,
) -> None:
    """Write the index, the tables of the whole run and ``atlas.js``, which index and compare page read.

    ``run_file`` is the record of the run; ``listings``: for each of ``materials`` the list of its fits' files
    (:mod:`.fit_files`).
    """
    output, data = Path(output), Path(data)
    run = read_record(run_file)
    facts = {name: model_facts(name) for name in models}
    summary = summarise_run(materials, facts)
    rows, tables = run_tables(run, materials, summary)
    for name, frame in tables.items():
        write_tsv(data / f"{name}.tsv", frame)
    script = atlas_script(materials, summary, scenes, listings)
    write_text(data / "atlas.js", as_script("ATLAS", script))
    versions = list((run.get("versions") or {}).items())
    versions += [(key, run[key]) for key in ("revision", "machine") if run.get(key)]
    render_page(
        "index.html.j2",
        output,
        root="",
        here="index",
        **links,
        findings=findings(materials, summary),
        standins=sum(material.standin for material in materials),
        reconstructed=sum(material.reconstructed for material in materials),
        materials=materials,
        models=facts,
        scenes=scenes,
        rows=rows,
        measures=MEASURES,
        shown=SHOWN,
        pictures=len(summary.errors[["material", "scene"]].drop_duplicates()) - sum(len(m.unjudged) for m in materials),
        budgets=BUDGETS,
        few=len(materials) <= FEW_MATERIALS,
        failures=list_failures(materials, facts),
        left_out=run.get("left_out") or [],
        versions=versions,
        config=yaml.safe_dump(run.get("config") or {}, sort_keys=False, allow_unicode=True),
        options=yaml.safe_dump(run.get("models") or {}, sort_keys=False, allow_unicode=True),
        inputs=run.get("inputs") or [],
        data_links=[(f"{name}.tsv", f"data/{name}.tsv") for name in tables],
    )


def run_tables(
    run: Mapping[str, Any], materials: Sequence[Material], summary: Summary
) -> tuple[list[dict[str, Any]], dict[str, pd.DataFrame]]:
    """The rows of the leaderboard, and every table of the run by name."""
    rows = model_rows(summary)
    return rows, {
        "materials": materials_frame(materials),
        "recommended": recommended_frame(summary),
        "models": models_frame(rows),
        "errors": summary.errors,
        "brdf": stack([material.brdf_errors for material in materials]),
        "fits": stack([fits_frame(material) for material in materials]),
        "parameters": stack([parameters_frame(material) for material in materials]),
        "left_out": pd.DataFrame(run.get("left_out") or [], columns=["name", "path", "reason"]),
    }


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


def recommended_frame(summary: Summary) -> pd.DataFrame:
    """One row a material and budget: the recommended model without further conditions, its ΔE00, bytes and seconds."""
    rows = []
    for material in summary.classes:
        for budget, model in zip(BUDGETS, summary.recommend([material]), strict=True):
            found = summary.candidate(model, material) if model else None
            numbers = (found.de00, found.bytes, found.seconds) if found else (math.nan,) * 3
            rows.append((material, budget.key, model or "", *numbers))
    return pd.DataFrame(rows, columns=["material", "budget", "model", "de00_mean", "bytes", "seconds"])


def model_rows(summary: Summary) -> list[dict[str, Any]]:
    """The leaderboard, best first by ΔE00, the reference with another seed last: scores, median storage and time, wins
    and failures, the best of each column, and where each range lies between the ends of its column."""
    best = {measure.key: summary.best(measure) for measure in MEASURES}
    wins = {measure.key: summary.wins(measure) for measure in (LEADING, PSNR)}
    places = {measure.key: _places(summary, measure) for measure in MEASURES}
    rows = []
    for name in [*summary.order(), *([REFERENCE_AGAIN] if summary.noise else [])]:
        noise = name == REFERENCE_AGAIN
        mine = summary.fits[summary.fits["model"] == name]
        rows.append(
            {
                "name": name,
                "title": "reference, other seed" if noise else summary.models[name].title,
                "facts": None if noise else summary.models[name],
                "noise": noise,
                "bytes": None if noise else summary.cost(name, "bytes"),
                "seconds": None if noise else summary.cost(name, "seconds"),
                "scores": {measure.key: score_of(summary.scores, name, measure.key) for measure in MEASURES},
                "places": {key: found.get(name) for key, found in places.items()},
                "wins": {key: None if noise else found[name] for key, found in wins.items()},
                "missing": 0 if noise else summary.missing[name],
                "failures": int((mine["status"] == "failed").sum()),
                "best": {key for key, names in best.items() if name in names},
            }
        )
    return rows


def _places(summary: Summary, measure: Measure) -> dict[str, tuple[float, float, float]]:
    """Model -> where low, median and high of a measure lie between the ends of its column, in per cent; errors on a
    logarithmic scale."""
    scores = {name: score_of(summary.scores, name, measure.key) for name in summary.models}
    ends = [v for s in scores.values() for v in (s.low, s.high) if math.isfinite(v)]
    log = not measure.higher_is_better and any(v > 0 for v in ends)
    ends = [v for v in ends if v > 0] if log else ends
    if not ends:
        return {}
    low, high = min(ends), max(ends)

    def place(value: float) -> float:
        value = min(max(value, low), high)
        share = (
            math.log(value / low) / math.log(high / low) if log and high > low else (value - low) / (high - low or 1)
        )
        return round(100 * share, 1)

    return {n: (place(s.low), place(s.median), place(s.high)) for n, s in scores.items() if not math.isnan(s.median)}


def models_frame(rows: Sequence[Mapping[str, Any]]) -> pd.DataFrame:
    """The leaderboard as plain numbers."""
    return pd.DataFrame(
        [
            {
                "model": row["name"],
                "status": row["facts"].status if row["facts"] else "reference, other seed",
                "family": row["facts"].family if row["facts"] else "",
                "paper": row["facts"].citation if row["facts"] else "",
                "bytes": row["bytes"],
                "free_parameters": numbers_of(row["facts"]),
                "fit_seconds_median": row["seconds"],
                **{f"{key}_median": value.median for key, value in row["scores"].items()},
                **{f"{key}_low": value.low for key, value in row["scores"].items()},
                **{f"{key}_high": value.high for key, value in row["scores"].items()},
                **{f"{key}_mean": value.mean for key, value in row["scores"].items()},
                "psnr_se_of_mean_db": row["scores"]["psnr_db"].error,
                "pictures": row["scores"]["psnr_db"].count,
                "pictures_missing": row["missing"],
                "pictures_best_de00": row["wins"]["de00_mean"],
                "pictures_best_psnr": row["wins"]["psnr_db"],
                "failures": row["failures"],
            }
            for row in rows
        ]
    )


def numbers_of(facts: ModelFacts | None) -> int | None:
    """How many numbers a fit has; None where the material decides."""
    return facts.free_parameters if facts and not facts.variable_size else None


def list_failures(materials: Sequence[Material], facts: Mapping[str, ModelFacts]) -> list[dict[str, Any]]:
    """Every failed fit or render with its reason, and the scenes in which no model can be judged (``model`` is "")."""
    found = []
    for material in materials:
        about = {"material": material.name, "title": material.title, "standin": material.standin}
        failed = set()
        for model, record in material.fits.items():
            if record.get("status") != "ok":
                failed.add(model)
                reason = " ".join(str(record.get("reason") or "no reason given").split())
                title = facts[model].title if model in facts else model
                found.append(about | {"model": model, "model_title": title, "reason": reason})
        unjudged = material.unjudged
        for reason in dict.fromkeys(unjudged.values()):
            told = ", ".join(scene for scene, why in unjudged.items() if why == reason)
            reason = f"cannot be judged: {told} ({reason})"
            found.append(about | {"model": "", "model_title": "every model", "reason": reason})
        bad = material.errors[(material.errors["status"] != "ok") & ~material.errors["scene"].isin(unjudged)]
        for model, rows in bad.groupby("model"):
            if model not in failed and model in facts:
                told = (f"{row['scene']} ({row.get('reason') or 'no reason given'})" for _, row in rows.iterrows())
                reason = f"cannot be judged: {', '.join(told)}"
                found.append(about | {"model": model, "model_title": facts[model].title, "reason": reason})
    return found


def findings(materials: Sequence[Material], summary: Summary) -> str:
    """What this run says, from its own numbers: the best model, a small one, what an engine can load, the hardest and
    the easiest material, all by ΔE00."""
    ranked = [name for name in summary.order() if name in summary.complete()]
    failed = {item["model"] for item in list_failures(materials, summary.models)}
    if not ranked:
        one = "No model has a picture in this run: every fit or render failed, or the references are black."
        why = "fits or renders failed" if failed else "no row has parameters for every material"
        other = f"No model has every picture of this run, so the models cannot be compared: {why}."
        return other if any(summary.scores.get(name) for name in summary.models) else one
    names = list(summary.classes)

    def told(name: str) -> str:
        return f"{digits(summary.value(name), LEADING.digits)} at {storage(summary.cost(name, 'bytes'))} per material"

    best = ranked[0]
    count = len(summary.pictured(best))
    over = f"the median over {count} materials" if count > 1 else "on one material"
    text = f"{summary.models[best].title} comes closest to the references (ΔE00 {told(best)}, {over})"
    chosen = dict(zip([budget.key for budget in BUDGETS], summary.recommend(names), strict=True))
    small = chosen["1k"]
    if small and small != best:
        text += f"; of the models within 1 kB, {summary.models[small].title} is best (ΔE00 {told(small)})"
    engine = chosen["engine"]
    if engine and engine not in (best, small):
        text += f"; of those that an engine can load, {summary.models[engine].title} (ΔE00 {told(engine)})"
    titles = {material.name: material.title for material in materials}
    hard = {name: value for name, value in summary.difficulty().items() if not math.isnan(value)}
    if len(hard) > 1:
        low, high = min(hard, key=hard.__getitem__), max(hard, key=hard.__getitem__)
        text += f". The hardest material is {titles[high]} (median ΔE00 over the models {digits(hard[high], 2)})"
        text += f", the easiest {titles[low]} ({digits(hard[low], 2)})"
    text += "."
    aside = [name for name in summary.models if summary.missing[name]]
    for why, names in (
        ("of failed fits or renders", [name for name in aside if name in failed]),
        ("some materials have no parameters for them", [name for name in aside if name not in failed]),
    ):
        if names:
            text += f" Not ranked because {why}: {', '.join(summary.models[name].title for name in names)}."
    return text


def atlas_script(
    materials: Sequence[Material], summary: Summary, scenes: Sequence[SceneFacts], listings: Sequence[str | Path]
) -> dict[str, Any]:
    """``window.ATLAS``: numbers of the whole run, in columns, rounded to what is shown, for index and compare page.

    ``values[measure]`` is flat: scene, then material, then model (models, then the reference with another seed last);
    ``best`` are the places of the best PSNRs (:func:`brdfatlas.measures.ranking.best_rows`); ``recommended[switches]``
    and ``of_class[switches]`` hold a list of models' places (-1: none) a budget, for each material and class;
    ``stems`` is how the names of a fit's files begin; ``unjudged``: material/scene that no model is judged by, and why.
    """
    models = list(summary.models)
    names = [*models, REFERENCE_AGAIN]
    classes = list(dict.fromkeys(filter(None, summary.classes.values())))
    members = {name: [m for m, found in summary.classes.items() if found == name] for name in classes}
    place_of = {name: i for i, name in enumerate(models)}

    def recommended(groups: Sequence[Sequence[str]]) -> list[list[list[int]]]:
        return [
            [[place_of[name] if name else -1 for name in summary.recommend(group, **conditions)] for group in groups]
            for conditions in switch_settings()
        ]

    files = [files_of(listing, m.name, models) for m, listing in zip(materials, listings, strict=True)]
    kinds = list(dict.fromkeys(tuple(found) for row in files for found in row))
    return {
        "materials": [
            {key: getattr(m, key) for key in ("name", "title", "standin")}
            | {"class": summary.classes[m.name], "diffuseness": rounded(m.facts.get("diffuseness"))}
            for m in materials
        ],
        "models": [
            {"name": name, "status": m.short_status}
            | {key: getattr(m, key) for key in ("title", "paper", "family", "reciprocal")}
            for name, m in summary.models.items()
        ],
        "order": [place_of[name] for name in summary.order()],
        "families": [f for f in FAMILIES if any(m.family == f for m in summary.models.values())],
        "classes": classes,
        "scenes": [{"name": s.name, "title": s.label, "exposure": s.exposure, "gamma": s.gamma} for s in scenes],
        "measures": [
            {"key": m.key, "title": m.label, "higher": m.higher_is_better, "digits": m.digits} for m in MEASURES
        ],
        "budgets": [{"key": b.key, "title": b.title} for b in BUDGETS],
        "recommended": recommended([[m.name] for m in materials]),
        "of_class": recommended([members[name] for name in classes]),
        "endings": kinds,
        "stems": [[stem_of(m.name, model) for model in models] for m in materials],
        "files": [[kinds.index(tuple(found)) for found in row] for row in files],
        "seconds": [[rounded((m.fits.get(model) or {}).get("seconds")) for model in models] for m in materials],
        "bytes": [[m.stored_bytes(model) for model in models] for m in materials],
        "best": _best_places(materials, scenes, models),
        "reasons": {f"{f['material']}/{f['model']}": f["reason"] for f in list_failures(materials, summary.models)}
        | {f"{m.name}/{model}": reason for m in materials for model, reason in m.absent.items()},
        "unjudged": {f"{m.name}/{scene}": why for m in materials for scene, why in m.unjudged.items()},
        "absent": [f"{m.name}/{model}" for m in materials for model in m.absent],
        "values": _value_columns(materials, scenes, names),
    }


def switch_settings() -> list[dict[str, bool]]:
    """Every setting of SWITCHES; the i-th has those bits of i that are on, the first switch in the lowest."""
    bits = itertools.product((False, True), repeat=len(SWITCHES))
    return [dict(zip(SWITCHES, reversed(setting), strict=True)) for setting in bits]


def _best_places(materials: Sequence[Material], scenes: Sequence[SceneFacts], models: Sequence[str]) -> list[int]:
    scene_place = {scene.name: i for i, scene in enumerate(scenes)}
    model_place = {name: i for i, name in enumerate(models)}
    return sorted(
        (scene_place[row.scene] * len(materials) + j) * (len(models) + 1) + model_place[row.model]
        for j, material in enumerate(materials)
        for row in best_rows(material.errors, models, measure=PSNR.key, pairs=material.pairs).itertuples()
        if row.scene in scene_place
    )


def _value_columns(
    materials: Sequence[Material], scenes: Sequence[SceneFacts], names: Sequence[str]
) -> dict[str, list[float | None]]:
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
                values[key][place] = rounded(row.get(key))
    return values


def rounded(value: Any) -> float | None:
    """A number for a script, six significant digits: it is rounded once more where it is shown; None where there is
    none."""
    if value is None or isinstance(value, str):
        return None
    value = float(value)
    if math.isnan(value):
        return None
    return value if math.isinf(value) else float(f"{value:.6g}")
