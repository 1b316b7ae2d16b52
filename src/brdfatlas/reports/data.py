"""What the report knows of a run: its files read, checked and put in order. Nothing here draws."""

import contextlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import pandas as pd

from brdfatlas.constants import ABSENT, REFERENCE_AGAIN
from brdfatlas.files import read_record
from brdfatlas.fits import known_details, report_faults
from brdfatlas.measured import RECONSTRUCTED
from brdfatlas.measures import tsv
from brdfatlas.measures.summary import Summary
from brdfatlas.measures.tsv import BRDF, ERRORS, PAIRS, read_tsv
from brdfatlas.models import MODELS, load_model

FIT_COLUMNS = [
    *("material", "model", "standin", "status", "reason", "seconds", "iterations", "converged"),
    *("objective", "objective_name", "seed", "bytes", "reciprocity_error", "max_albedo", "bad_cells"),
    *("golden_section_calls", "options"),
]


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
    family: str = "analytic"
    targets: tuple[str, ...] = ()
    source: str = ""
    parameters: tuple[dict[str, Any], ...] = ()
    options: tuple[dict[str, Any], ...] = ()
    #: whether its parameters are given, not fitted
    given: bool = False

    @property
    def ours(self) -> bool:
        return self.status.lower().startswith("ours")

    @property
    def short_status(self) -> str:
        return self.status.split(":")[0]


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
    #: entries of given parameters that have none for this material -> why
    absent: Mapping[str, str] = field(default_factory=dict)
    #: standard errors of the differences between models of a picture
    pairs: pd.DataFrame = field(default_factory=pd.DataFrame)

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
    def unjudged(self) -> dict[str, str]:
        """Scenes in which nothing can be judged, not even the reference rendered again, and why: where the reference
        is black. No model lacks these pictures, and no mean is over them."""
        if "scene" not in self.errors:
            return {}
        judged = set(self.errors.loc[self.errors["status"] == "ok", "scene"])
        again = self.errors[(self.errors["model"] == REFERENCE_AGAIN) & ~self.errors["scene"].isin(judged)]
        return {str(row["scene"]): str(row.get("reason") or "no reason given") for row in again.to_dict("records")}

    def unjudged_told(self, scenes: Sequence[SceneFacts]) -> str:
        """These scenes and the reasons in words; "" if there are none."""
        found = self.unjudged
        told = ", ".join(f"{scene.label} ({found[scene.name]})" for scene in scenes if scene.name in found)
        return f"cannot be judged: {told}" if told else ""

    @property
    def reconstructed(self) -> bool:
        """Whether the file is somebody's reconstruction of a measurement, a fit or a network's table, say."""
        return self.facts.get("kind") == RECONSTRUCTED

    def stored_bytes(self, model: str) -> int | None:
        """What the fit of a model stores, which a model of variable size decides by the material; None if it
        failed."""
        record = self.fits.get(model) or {}
        return record.get("bytes") if record.get("status") == "ok" else None


def model_facts(name: str) -> ModelFacts:
    """Facts of a registered model. KeyError if nobody knows it."""
    model, entry = MODELS[name], MODELS.entry(name)
    given, plain, paper = entry.parameters, load_model(entry.model, entry.source).options, model.paper
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
        family=family_of(model),
        targets=tuple(model.targets),
        source=f"{type(model).__module__.replace('.', '/')}.py" if "brdfatlas." in type(model).__module__ else "",
        parameters=tuple(
            {
                "name": item.name,
                "shape": " × ".join(map(str, item.shape)) or "1",
                "range": _range(item.low, item.high),
                "low": item.low,
                "high": item.high,
                "count": item.count,
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
                "default": plain.get(key, option).default,  # of the class; an entry's options stand in their own column
                "choices": ", ".join(map(str, option.choices)),
                "description": option.description,
            }
            for key, option in model.options.items()
            if not given
        ),
        given=bool(given),
    )


#: Families of models, as charts colour them, by the folder of the class; a model from outside goes by its size.
FAMILIES = ("engine", "analytic", "tabulated", "factored", "ours")
FAMILY_OF_FOLDER = {
    "engine": "engine",
    "dupuy2015": "tabulated",
    "factorised": "factored",
    "bagher2016": "factored",
    "single_lobe": "analytic",
    "three_lobe": "analytic",
}
SMALL = 64


def family_of(model: Any) -> str:
    """One of FAMILIES."""
    if model.status.lower().startswith("ours"):
        return "ours"
    folder = type(model).__module__.split(".")[-2:-1]
    known = FAMILY_OF_FOLDER.get(folder[0]) if folder else None
    return known or ("analytic" if model.free_parameters <= SMALL else "tabulated")


def _range(low: float, high: float) -> str:
    if math.isinf(low) and math.isinf(high):
        return "any"
    left = "−∞" if math.isinf(low) else f"{low:.4g}"
    right = "∞" if math.isinf(high) else f"{high:.4g}"
    return f"{left} … {right}".replace("-", "−")


def write_tsv(path: str | Path, frame: pd.DataFrame) -> None:
    """Write a table of the report, numbers with every digit that matters."""
    tsv.write_tsv(path, frame, digits=9)


def _fit_record(path: str | Path) -> Mapping[str, Any]:
    """The report of a fit. ValueError naming the file where a part that pages show is not of its type."""
    record = read_record(path, "status")
    with contextlib.suppress(TypeError, AttributeError):
        numbers = [*physics_of(record).values(), golden_section_calls(record)]
        if not report_faults(record) and all(isinstance(number, int | float | None) for number in numbers):
            return record
    raise ValueError(f"{path}: not the report of a fit that a run writes")


def read_material(
    facts: str | Path,
    fits: Sequence[str | Path] = (),
    errors: str | Path | None = None,
    brdf_errors: str | Path | None = None,
) -> Material:
    """One material from the files of a run; ``fits`` are the JSON files of its models. The job that writes ``errors``
    writes pairs.tsv beside it."""
    pairs = Path(errors).with_name("pairs.tsv") if errors else None
    found, absent = {}, {}
    for path in fits:
        record = _fit_record(path)
        name = str(record.get("entry") or record.get("model") or Path(path).stem)
        if record.get("status") == ABSENT:
            absent[name] = str(record["reason"])
        else:
            found[name] = record
    return Material(
        read_record(facts, "name"),
        found,
        read_tsv(errors, ERRORS) if errors else pd.DataFrame(columns=ERRORS),
        read_tsv(brdf_errors, BRDF) if brdf_errors else pd.DataFrame(columns=BRDF),
        absent,
        read_tsv(pairs, PAIRS) if pairs and pairs.is_file() else pd.DataFrame(),
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


def golden_section_calls(record: Mapping[str, Any]) -> int | None:
    """How often the line search of an alternating fit was called, over its channels; None where none is counted."""
    channels = known_details(record)["channels"]
    counts = [item["golden_section_calls"] for item in channels if "golden_section_calls" in item]
    return sum(counts) if counts else None


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
                "golden_section_calls": golden_section_calls(record),
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


def summarise_run(materials: Sequence[Material], models: Mapping[str, ModelFacts]) -> Summary:
    """The summary of a run, or of one material of it."""
    return Summary(
        models,
        stack([material.errors for material in materials]),
        stack([fits_frame(material) for material in materials]),
        {material.name: str(material.facts.get("class") or "") for material in materials},
        stack([material.pairs for material in materials]),
    )


def stack(frames: Sequence[pd.DataFrame]) -> pd.DataFrame:
    """One table of many; the columns of the first where none has a row."""
    filled = [frame for frame in frames if not frame.empty]
    return pd.concat(filled, ignore_index=True) if filled else frames[0].copy()


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
