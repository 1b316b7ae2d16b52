"""What the report knows of a run: its files read, checked and put in order. Nothing here draws."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from brdfatlas.constants import REFERENCE_AGAIN
from brdfatlas.files import read_json
from brdfatlas.measures import tsv
from brdfatlas.measures.ranking import count_missing
from brdfatlas.measures.tsv import read_tsv
from brdfatlas.models import MODELS

FIT_COLUMNS = [
    *("material", "model", "standin", "status", "reason", "seconds", "iterations", "converged"),
    *("objective", "objective_name", "seed", "bytes", "reciprocity_error", "max_albedo", "bad_cells", "options"),
]
#: The measured table rendered with another seed: what remains of a measure when nothing but the noise differs.
NOISE_FLOOR = REFERENCE_AGAIN


@dataclass(frozen=True)
class Measure:
    """A column of the error tables: how it is called, its unit, the better direction and the decimals worth printing;
    None where values span decades and significant digits tell more."""

    key: str
    title: str
    unit: str
    higher_is_better: bool
    digits: int | None
    description: str

    @property
    def label(self) -> str:
        return f"{self.title} ({self.unit})" if self.unit else self.title


MEASURES = (
    Measure(
        "psnr_db",
        "PSNR",
        "dB",
        True,
        1,
        "10 log10(max² / MSE) of linear RGB over the pixels that the material covers directly",
    ),
    Measure("psnr_tonemapped_db", "PSNR, tone-mapped", "dB", True, 1, "PSNR of the tone-mapped 8-bit pictures"),
    Measure("de00_mean", "ΔE00 mean", "", False, 2, "mean CIEDE2000 colour difference over the material"),
    Measure("de00_p95", "ΔE00 95 %", "", False, 2, "95th percentile of the CIEDE2000 colour difference"),
    Measure("flip_mean", "FLIP mean", "", False, 3, "mean of the FLIP difference, made for flipping between pictures"),
    Measure("ssim", "SSIM", "", True, 4, "structural similarity of the tone-mapped pictures"),
    Measure("rmse", "RMSE", "", False, None, "root mean square error of linear RGB"),
    Measure("rel_mse", "relative MSE", "", False, None, "mean squared error relative to the squared reference"),
)
BRDF_MEASURES = (
    Measure(
        "objective_compressive", "compressive objective", "", False, 5, "the weighted objective of Bagher et al. 2016"
    ),
    Measure("loew_e2", "Löw E2", "", False, 5, "mean squared difference of ln(1 + ρ cos θi), Löw et al. 2012"),
    Measure(
        "cosine_weighted", "cosine-weighted", "", False, 5, "root mean square of (ρ − ρ*) cos θi, Ngan et al. 2005"
    ),
    Measure("log_deviation", "log deviation", "", False, 4, "mean |log1p(f cos) − log1p(g cos)| for cosines above 0.1"),
)


@dataclass(frozen=True)
class ModelFacts:
    """What the report says about a model, from its class."""

    name: str
    title: str
    paper: str
    citation: str
    doi: str
    equations: str
    formula: str
    bytes: int
    free_parameters: int
    variable_size: bool
    status: str
    reciprocal: bool
    parameters: tuple[dict[str, Any], ...] = ()
    options: tuple[dict[str, Any], ...] = ()

    @property
    def ours(self) -> bool:
        return self.status.lower().startswith("ours")


@dataclass(frozen=True)
class SceneFacts:
    """A scene of the run and what a reader should know of it."""

    name: str
    title: str = ""
    exposure: float = 1.0
    gamma: float = 2.2

    @property
    def label(self) -> str:
        return self.name.replace("_", " ")


def scene_facts(scenes: Mapping[str, Mapping[str, Any]]) -> list[SceneFacts]:
    """Scenes of a run from their definitions: title (what there is to see), exposure and gamma of the tone map."""
    return [
        SceneFacts(name, str(scene.get("title") or ""), float(scene.get("exposure", 1)), float(scene.get("gamma", 2.2)))
        for name, scene in scenes.items()
    ]


@dataclass(frozen=True)
class Material:
    """One material with everything the run found about it."""

    facts: Mapping[str, Any]
    fits: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    errors: pd.DataFrame = field(default_factory=pd.DataFrame)
    brdf_errors: pd.DataFrame = field(default_factory=pd.DataFrame)

    @property
    def name(self) -> str:
        return str(self.facts["name"])

    @property
    def title(self) -> str:
        return str(self.facts.get("title") or self.name)

    @property
    def standin(self) -> bool:
        return bool(self.facts.get("standin"))

    @cached_property
    def scores(self) -> dict[str, dict[str, "Score"]]:
        """Means over the scenes, by model and measure."""
        return score_models(self.errors)

    @cached_property
    def missing(self) -> dict[str, int]:
        """Scenes that a model lacks and another has, by model."""
        return count_missing(self.errors, [name for name in dict.fromkeys(self.errors["model"]) if name != NOISE_FLOOR])

    def stored_bytes(self, model: str) -> int | None:
        """What the fit of a model stores, which a model of variable size decides by the material; None if it
        failed."""
        record = self.fits.get(model) or {}
        return record.get("bytes") if record.get("status") == "ok" else None


def model_facts(name: str) -> ModelFacts:
    """Facts of a registered model. KeyError if nobody knows it."""
    model = MODELS[name]
    paper = model.paper
    return ModelFacts(
        name=name,
        title=model.title,
        paper=paper.short,
        citation=f"{paper.authors}: {paper.title}. {paper.venue}, {paper.year}.",
        doi=paper.doi,
        equations=model.equations,
        formula=model.formula,
        bytes=model.bytes,
        free_parameters=model.free_parameters,
        variable_size=model.variable_size,
        status=model.status,
        reciprocal=model.reciprocal,
        parameters=tuple(
            {
                "name": item.name,
                "shape": " × ".join(map(str, item.shape)) or "1",
                "range": _range(item.low, item.high),
                "unit": item.unit,
                "dtype": item.dtype,
                "bytes": item.bytes,
                "description": item.description,
            }
            for item in model.parameters
        ),
        options=tuple(
            {
                "name": key,
                "default": option.default,
                "choices": ", ".join(map(str, option.choices)),
                "description": option.description,
            }
            for key, option in model.options.items()
        ),
    )


def _range(low: float, high: float) -> str:
    if math.isinf(low) and math.isinf(high):
        return "any"
    left = "−∞" if math.isinf(low) else f"{low:.4g}"
    right = "∞" if math.isinf(high) else f"{high:.4g}"
    return f"{left} … {right}"


def write_tsv(path: str | Path, frame: pd.DataFrame) -> None:
    """Write a table of the report, numbers with every digit that matters."""
    tsv.write_tsv(path, frame, digits=9)


def read_material(
    facts: str | Path,
    fits: Sequence[str | Path] = (),
    errors: str | Path | None = None,
    brdf_errors: str | Path | None = None,
) -> Material:
    """One material from the files of a run; ``fits`` are the JSON files of its models."""
    found = {}
    for path in fits:
        record = read_json(path)
        found[str(record.get("entry") or record.get("model") or Path(path).stem)] = record
    return Material(
        read_json(facts),
        found,
        read_tsv(errors) if errors else pd.DataFrame(columns=["material", "model", "scene", "status"]),
        read_tsv(brdf_errors) if brdf_errors else pd.DataFrame(columns=["material", "model"]),
    )


def read_run(files: Mapping[str, Mapping[str, Any]]) -> list[Material]:
    """Materials in order from their files: name -> {facts, fits, errors, brdf}."""
    return [read_material(item["facts"], item["fits"], item["errors"], item["brdf"]) for item in files.values()]


def physics_of(record: Mapping[str, Any] | None) -> dict[str, float | None]:
    """The physics checks of a fit's report, None where there are none: reciprocity_error, max_albedo (the largest of
    the colour channels) and bad_cells, a share."""
    found = (record or {}).get("physics") or {}
    albedo = found.get("max_albedo")
    return {
        "reciprocity_error": found.get("reciprocity_error"),
        "max_albedo": max(albedo) if albedo and None not in albedo else None,
        "bad_cells": found.get("bad_cells"),
    }


def fits_frame(material: Material) -> pd.DataFrame:
    """One row a model: how the fit of this material went and what it violates."""
    rows = []
    for model, record in material.fits.items():
        rows.append(
            {
                "material": material.name,
                "model": model,
                "standin": int(material.standin),
                "status": record.get("status", ""),
                "reason": _one_line(record.get("reason") or record.get("message") or ""),
                "seconds": record.get("seconds"),
                "iterations": record.get("iterations"),
                "converged": record.get("converged"),
                "objective": record.get("objective"),
                "objective_name": record.get("objective_name", ""),
                "seed": record.get("seed"),
                "bytes": record.get("bytes"),
                **physics_of(record),
                "options": "; ".join(f"{key}={value}" for key, value in (record.get("options") or {}).items()),
            }
        )
    return pd.DataFrame(rows, columns=FIT_COLUMNS)


def parameters_frame(material: Material) -> pd.DataFrame:
    """Every small parameter of every fit of this material: material, model, parameter, index, value."""
    rows = [
        (material.name, model, name, index, value)
        for model, record in material.fits.items()
        for name, values in (record.get("parameters") or {}).items()
        for index, value in _flat(values)
    ]
    return pd.DataFrame(rows, columns=["material", "model", "parameter", "index", "value"])


def _flat(value: Any, index: str = "") -> list[tuple[str, float]]:
    if isinstance(value, list | tuple):
        return [item for i, entry in enumerate(value, 1) for item in _flat(entry, f"{index},{i}" if index else str(i))]
    if isinstance(value, int | float):
        return [(index, value)]
    return []


def _one_line(text: Any) -> str:
    return " ".join(str(text).split())


def published_row(folder: str | Path | None, model: str, material: str) -> dict[str, float]:
    """The published parameters and psnr_db of a model on a material; empty where nothing was published."""
    if folder is None:
        return {}
    path = Path(folder) / f"{model}.csv"
    row: dict[str, float] = {}
    if path.is_file():
        frame = pd.read_csv(path, comment="#", dtype={"material": str}, keep_default_na=False)
        rows = frame[frame["material"] == material]
        if len(rows):
            row = {k: float(v) for k, v in rows.iloc[0].items() if k != "material" and str(v) not in ("", "nan")}
    captions = Path(folder) / "psnr.csv"
    if "psnr_db" not in row and captions.is_file():
        frame = pd.read_csv(captions, comment="#", dtype={"material": str}, keep_default_na=False)
        rows = frame[frame["material"] == material]
        if len(rows) and model in frame and str(rows.iloc[0][model]) not in ("", "nan"):
            row["psnr_db"] = float(rows.iloc[0][model])
    return row


@dataclass(frozen=True)
class Score:
    """Mean of a measure with the Monte Carlo standard error of that mean and how many pictures it is over."""

    mean: float
    error: float
    count: int


NO_SCORE = Score(float("nan"), float("nan"), 0)


def score_models(errors: pd.DataFrame) -> dict[str, dict[str, Score]]:
    """model -> measure -> mean over all its good pictures. PSNR carries the standard error of the mean; it is infinite
    where a picture has a lower bound only, and so has the mean."""
    found: dict[str, dict[str, Score]] = {}
    for model, rows in errors[errors["status"] == "ok"].groupby("model", sort=False):
        found[str(model)] = {}
        for measure in MEASURES:
            if measure.key not in rows:
                continue
            values = rows[measure.key].to_numpy(float)
            known = ~np.isnan(values)
            count = int(known.sum())
            if count == 0:
                continue
            spread = float("nan")
            if measure.key == "psnr_db" and "psnr_se_db" in rows:
                spread = float(np.sqrt(np.nansum(rows["psnr_se_db"].to_numpy(float)[known] ** 2))) / count
            found[str(model)][measure.key] = Score(float(values[known].mean()), spread, count)
    return found


def score_of(scores: Mapping[str, Mapping[str, Score]], model: str, measure: str = "psnr_db") -> Score:
    """The score of a model; nan over 0 pictures where there is none."""
    return scores.get(model, {}).get(measure, NO_SCORE)


def best_models(scores: Mapping[str, Mapping[str, Score]], models: Sequence[str], measure: Measure) -> list[str]:
    """The models with the best mean of a measure, ties included; empty where there is no number."""
    means = {model: score_of(scores, model, measure.key).mean for model in models}
    means = {model: mean for model, mean in means.items() if not math.isnan(mean)}
    if not means:
        return []
    best = max(means.values()) if measure.higher_is_better else min(means.values())
    return [model for model, mean in means.items() if mean == best]


def pareto_front(points: Mapping[str, tuple[float, float]], higher_is_better: bool) -> list[str]:
    """Names whose (cost, value) no other point beats in both; by rising cost. Not-a-number points take no part."""
    alive = [
        (cost, value, name) for name, (cost, value) in points.items() if not (math.isnan(cost) or math.isnan(value))
    ]
    sign = -1 if higher_is_better else 1
    front, best = [], math.inf
    for _cost, value, name in sorted(alive, key=lambda item: (item[0], sign * item[1])):
        if sign * value < best:
            best = sign * value
            front.append(name)
    return front
