"""The page of the ablation: models fitted under several objectives, as in Figs. 7 and 15 of Bagher et al. 2016."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from brdfatlas.constants import REFERENCE
from brdfatlas.figures.pictures import picture_file
from brdfatlas.files import read_json
from brdfatlas.measures.tsv import read_tsv
from brdfatlas.reports.data import SceneFacts, model_facts, write_tsv
from brdfatlas.reports.pages import Picture, find_picture, render_page

#: Measures of the table of means: key, heading, decimals.
SHOWN = (("psnr_db", "PSNR (dB)", 1), ("de00_mean", "ΔE00", 2), ("flip_mean", "FLIP", 3))
#: What an option of the objective is in the words of the paper.
WORDS = {
    ("power", 0): "no compressive weight",
    ("max_angle", 80): "angles up to 80°",
    ("measure", "pairs"): "measure of direction pairs",
}


@dataclass(frozen=True)
class Variant:
    """One objective: its name and, in words, how it differs from the published one."""

    name: str
    words: str

    @property
    def label(self) -> str:
        return self.name.replace("_", " ")


def describe(name: str, options: Mapping[str, Any]) -> Variant:
    """A variant with its options in words; "as published" without any."""
    words = [WORDS.get((key, value), f"{key} = {value}") for key, value in options.items()]
    return Variant(name, ", ".join(words) or "as published")


def split_variants(frame: pd.DataFrame, variants: Mapping[str, Mapping[str, Any]]) -> pd.DataFrame:
    """Error rows of the names "model.variant" with model and variant in columns of their own; others are dropped."""
    frame = frame[frame["model"].isin(list(variants))].reset_index(drop=True)
    split = {name: (entry["model"], name.removeprefix(entry["model"] + ".")) for name, entry in variants.items()}
    pairs = [split[name] for name in frame["model"]]
    frame.insert(frame.columns.get_loc("model") + 1, "variant", [variant for _, variant in pairs])
    return frame.assign(model=[model for model, _ in pairs])


def write_ablation(
    output: str | Path,
    *,
    facts: Sequence[str | Path],
    errors: Sequence[str | Path],
    brdf: Sequence[str | Path],
    pictures: str | Path,
    tables: Sequence[str | Path],
    variants: Mapping[str, Mapping[str, Any]],
    scenes: Sequence[SceneFacts],
    **links: bool,
) -> None:
    """Write the page and its two tables (image errors, BRDF-space errors).

    ``facts``, ``errors``, ``brdf``: a file a material; ``pictures``: the folder with a folder a material;
    ``variants``: "model.variant" -> its model and options (:func:`brdfatlas.pipeline.configuration.read_variants`).
    ValueError without a material.
    """
    if not facts:
        raise ValueError("config: ablation.materials: none of them is a material of this run")
    output = Path(output)
    materials = [read_json(path) for path in facts]
    frames = [split_variants(read_tsv(paths), variants) for paths in (errors, brdf)]
    for path, frame in zip(tables, frames, strict=True):
        write_tsv(path, frame)
    images = frames[0]
    models = list(dict.fromkeys(entry["model"] for entry in variants.values()))
    first = models[0]
    objectives = [
        describe(name.removeprefix(f"{first}."), entry["options"])
        for name, entry in variants.items()
        if entry["model"] == first
    ]
    rows = {(r["material"], r["model"], r["variant"], r["scene"]): r for r in images.to_dict("records")}
    render_page(
        "ablation.html.j2",
        output,
        root="",
        here="ablation",
        **links,
        materials=materials,
        standins=sum(bool(item["standin"]) for item in materials),
        models=[model_facts(name) for name in models],
        objectives=objectives,
        scenes=scenes,
        rows=rows,
        pictures=_pictures(output, Path(pictures), materials, variants, scenes),
        means=mean_rows(images, models, [item.name for item in objectives]),
        measures=SHOWN,
        data_links=[(Path(path).name, f"data/{Path(path).name}") for path in tables],
    )


def mean_rows(images: pd.DataFrame, models: Sequence[str], objectives: Sequence[str]) -> list[dict[str, Any]]:
    """Means over materials and scenes, a row a (model, objective): count, failed, each of SHOWN, and the difference
    of mean PSNR to the model's first objective over the renders that both have."""
    found = []
    keys = ["material", "scene"]
    for model in models:
        parts = {v: images[(images["model"] == model) & (images["variant"] == v)].set_index(keys) for v in objectives}
        base = parts[objectives[0]]["psnr_db"]
        for variant, part in parts.items():
            good = part[part["status"] == "ok"]
            row: dict[str, Any] = {"model": model, "variant": variant, "count": len(good)}
            row |= {"failed": len(part) - len(good), "difference": (good["psnr_db"] - base).mean()}
            found.append(row | {key: good[key].mean() for key, _, _ in SHOWN})
    return found


def _pictures(
    page: Path,
    folder: Path,
    materials: Sequence[Mapping[str, Any]],
    variants: Mapping[str, Any],
    scenes: Sequence[SceneFacts],
) -> dict[tuple[str, str, str], Picture | None]:
    """(material, scene, "reference" or "model.variant") -> its picture."""
    return {
        (item["name"], scene.name, name): find_picture(page, picture_file(folder / item["name"], scene.name, name))
        for item in materials
        for scene in scenes
        for name in (REFERENCE, *variants)
    }
