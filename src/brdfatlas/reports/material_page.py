"""The page of one material, in the order of Dupuy et al. 2015, Bilgili et al. 2011 and Bagher et al. 2016."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from urllib.parse import quote

import pandas as pd

from brdfatlas.constants import REFERENCE
from brdfatlas.figures.pictures import picture_file
from brdfatlas.measures.ranking import best_rows
from brdfatlas.reports.data import (
    BRDF_MEASURES,
    MEASURES,
    NOISE_FLOOR,
    Material,
    Measure,
    ModelFacts,
    SceneFacts,
    fits_frame,
    model_facts,
    parameters_frame,
    physics_of,
    published_row,
    read_material,
    score_of,
    write_tsv,
)
from brdfatlas.reports.formats import digits
from brdfatlas.reports.pages import Picture, find_picture, render_page, write_hdr_scripts, write_thumbnail

#: Sections of difference pictures on a material page: id, title, ending of the picture's name, caption.
ERROR_SECTIONS = (
    (
        "de00",
        "CIE ΔE00",
        "-de00",
        "CIEDE2000 colour difference of each fit to the reference at a fixed exposure, over the material's pixels. "
        "The scale is the same for every model of a scene. About 1 is just noticeable.",
    ),
    (
        "difference",
        "Signed difference",
        "-diff",
        "Luminance of the fit minus luminance of the reference, as displayed: red is too bright, blue too dark. "
        "The scale is the same for every model of a scene, as in the difference images of Bilgili et al. 2011.",
    ),
    (
        "flip",
        "FLIP",
        "-flip",
        "FLIP: the difference that an observer sees when flipping between the two pictures; 0 is none, 1 the largest.",
    ),
)


@dataclass
class Entry:
    """A model on a material page, or the noise floor."""

    name: str
    title: str
    facts: ModelFacts | None
    fit: Mapping[str, Any] | None
    rows: dict[str, dict[str, Any]]
    brdf: dict[str, Any] | None
    reason: str = ""
    mean: float = float("nan")
    floor: bool = False
    best: dict[tuple[str, str], bool] = field(default_factory=dict)
    best_in: set[str] = field(default_factory=set)
    pictures: dict[tuple[str, str], Picture] = field(default_factory=dict)
    published: dict[str, float] = field(default_factory=dict)
    table: list[tuple[str, float | None, float | None]] = field(default_factory=list)

    @property
    def physics(self) -> Mapping[str, Any]:
        return physics_of(self.fit)

    @property
    def page(self) -> bool:
        return self.facts is not None


def write_material_page(
    output: str | Path,
    *,
    material_file: str | Path,
    fit_files: Sequence[str | Path],
    errors_file: str | Path,
    brdf_errors_file: str | Path,
    pictures: str | Path,
    data: str | Path,
    materials: Sequence[str],
    models: Sequence[str],
    scenes: Sequence[SceneFacts],
    published: str | Path | None = None,
    **links: bool,
) -> None:
    """Write the page of one material, its tables in ``data`` and its thumbnail in ``pictures``.

    ``pictures`` is the folder of the material's pictures (see figures.pictures);
    ``materials`` is the order of pages. The page needs nothing of other materials: it is out when its material is.
    """
    output, pictures, data = Path(output), Path(pictures), Path(data)
    material = read_material(material_file, fit_files, errors_file, brdf_errors_file)
    facts = {name: model_facts(name) for name in models}
    entries = [make_entry(material, name, facts[name], scenes) for name in models]
    floor = make_entry(material, NOISE_FLOOR, None, scenes)
    floor.title, floor.floor, floor.reason = "noise floor (reference, other seed)", True, "not in this run"
    reference = Entry(REFERENCE, "reference", None, None, {}, None)
    for entry in [*entries, reference]:
        entry.pictures = _pictures(output, pictures, entry.name, scenes)
    mark_best(material, entries, scenes)
    for entry in entries:
        entry.published = published_row(published, entry.name, material.name)
        entry.table = _beside(entry.published, (entry.fit or {}).get("parameters") or {})

    tables = {
        "image errors": ("errors.tsv", material.errors),
        "BRDF-space errors": ("brdf.tsv", material.brdf_errors),
        "fits": ("fits.tsv", fits_frame(material)),
        "parameters": ("parameters.tsv", parameters_frame(material)),
        "published": ("published.tsv", _published_frame(material, entries)),
    }
    for ending, frame in tables.values():
        write_tsv(data / "materials" / material.name / ending, frame)
    write_thumbnail(pictures, scenes, models)
    write_hdr_scripts(pictures, material.name, scenes, models)

    functions = _named_pictures(output, pictures, "functions", entries)
    factors = _named_pictures(output, pictures, "factors", entries)
    convergence = _named_pictures(output, pictures, "convergence", entries)
    weights = find_picture(output, pictures / "weights.svg")
    lobes = find_picture(output, pictures / "lobes.svg")
    slices = find_picture(output, pictures / "slices.webp")
    sections = [("renders", "Renderings")]
    error_sections = [
        item for item in ERROR_SECTIONS if any((s.name, item[2]) in e.pictures for e in entries for s in scenes)
    ]
    sections += [(item[0], item[1]) for item in error_sections]
    sections += [("lobes", "Lobes")] if lobes else []
    sections += [("functions", "Functions")] if functions else []
    sections += [("numbers", "Numbers")]
    with_published = [entry for entry in entries if entry.published]
    sections += [("published", "Published")] if with_published else []
    parameter_tables = [
        (entry, rows) for entry in entries if not entry.table and (rows := parameter_rows(entry)) and entry.facts
    ]
    sections += [("parameters", "Parameters")] if parameter_tables else []
    sections += [("factors", "Factors")] if factors or slices else []
    place = list(materials).index(material.name)
    render_page(
        "material.html.j2",
        output,
        root="../",
        here="material",
        **links,
        material=material,
        facts={"class": "", "source": "", "sha256": "", "albedo": None, "range": None} | dict(material.facts),
        swatch=_swatch(material.facts.get("albedo")),
        lede=material_lede(material, entries, scenes),
        previous=materials[place - 1] if place else "",
        following=materials[place + 1] if place + 1 < len(materials) else "",
        scenes=scenes,
        entries=entries,
        reference=reference,
        floor=floor,
        sections=sections,
        error_sections=error_sections,
        bars=_bars(output),
        lobes=lobes,
        functions=functions,
        factors=factors,
        slices=slices,
        convergence=convergence,
        weights=weights,
        extra=other_figures(
            output,
            pictures,
            {"lobes.svg", "weights.svg", *(p.href.rsplit("/")[-1] for _, p in functions + factors + convergence)},
        ),
        measures=MEASURES,
        brdf_measures=BRDF_MEASURES,
        published=with_published,
        parameter_tables=parameter_tables,
        remarks=_remarks(entries),
        data_links=[
            (name, f"../data/materials/{quote(material.name)}/{ending}") for name, (ending, _frame) in tables.items()
        ],
    )


def material_lede(material: Material, entries: Sequence[Entry], scenes: Sequence[SceneFacts]) -> str:
    """One sentence on what happened to a material, from its own errors."""
    alive = [entry for entry in entries if not math.isnan(entry.mean) and not material.missing.get(entry.name)]
    alive.sort(key=lambda entry: -entry.mean)
    failed = [entry for entry in entries if entry.reason]
    if not alive:
        return f"No model has every picture of {material.title} in this run."
    best, worst = alive[0], alive[-1]
    over = f"mean over {len(scenes)} scenes" if len(scenes) > 1 else f"scene {scenes[0].label}"
    text = f"{best.title} comes closest to the reference, {digits(best.mean, 1)} dB PSNR ({over})"
    if worst is not best:
        text += f"; {worst.title} stays farthest, {digits(worst.mean, 1)} dB"
    spread = [entry for entry in alive[1:] if entry.mean > best.mean - 1]
    if spread:
        text += (
            f"; {len(spread)} other{'s' if len(spread) > 1 else ''} lie within 1 dB of the best"
            if len(spread) > 1
            else "; one other lies within 1 dB of the best"
        )
    if failed:
        text += f". {len(failed)} of {len(entries)} models failed, with reasons below"
    return text + "."


def make_entry(material: Material, name: str, facts: ModelFacts | None, scenes: Sequence[SceneFacts]) -> Entry:
    rows = material.errors[material.errors["model"] == name]
    by_scene = {str(row["scene"]): row for row in rows.to_dict("records")}
    for row in by_scene.values():
        for measure in MEASURES:
            row.setdefault(measure.key, float("nan"))
        row.setdefault("psnr_se_db", float("nan"))
    brdf = material.brdf_errors[material.brdf_errors["model"] == name].to_dict("records")
    for row in brdf:
        for measure in BRDF_MEASURES:
            row.setdefault(measure.key, float("nan"))
    fit = material.fits.get(name)
    fit = (
        None
        if fit is None
        else {"bytes": None, "seconds": None, "iterations": None, "converged": None, "seed": None} | dict(fit)
    )
    reason = ""
    if fit is not None and fit.get("status") != "ok":
        reason = f"fit failed: {' '.join(str(fit.get('reason') or 'no reason given').split())}"
    bad = [scene.label for scene in scenes if scene.name in by_scene and by_scene[scene.name]["status"] != "ok"]
    if not reason and bad:
        reason = f"render failed: {', '.join(bad)}"
    mean = score_of(material.scores, name).mean
    return Entry(name, facts.title if facts else name, facts, fit, by_scene, brdf[0] if brdf else None, reason, mean)


def mark_best(material: Material, entries: Sequence[Entry], scenes: Sequence[SceneFacts]) -> None:
    """Mark the best of every picture and measure: PSNR by :func:`best_rows`, others by value."""
    by_name = {entry.name: entry for entry in entries}
    for row in best_rows(material.errors, list(by_name)).itertuples():
        by_name[row.model].best[row.scene, "psnr_db"] = True
        by_name[row.model].best_in.add(row.scene)
    for measure in MEASURES:
        for scene in scenes if measure.key != "psnr_db" else ():
            values = {e.name: e.rows[scene.name][measure.key] for e in entries if scene.name in e.rows}
            for name in _best_of(values, measure):
                by_name[name].best[scene.name, measure.key] = True
    for measure in BRDF_MEASURES:
        for name in _best_of({e.name: e.brdf[measure.key] for e in entries if e.brdf and not e.reason}, measure):
            by_name[name].best["brdf", measure.key] = True


def _best_of(values: Mapping[str, float], measure: Measure) -> list[str]:
    alive = {name: value for name, value in values.items() if not math.isnan(value)}
    if not alive:
        return []
    best = (max if measure.higher_is_better else min)(alive.values())
    return [name for name, value in alive.items() if value == best]


def _remarks(entries: Sequence[Entry]) -> list[tuple[Entry, str]]:
    """What a reader must know of a row before using its numbers."""
    remarks = []
    for entry in entries:
        if entry.facts and entry.facts.status:
            remarks.append((entry, entry.facts.status))
        chosen = (entry.fit or {}).get("options") or {}
        defaults = {option["name"]: option["default"] for option in entry.facts.options} if entry.facts else {}
        changed = {key: value for key, value in chosen.items() if key in defaults and value != defaults[key]}
        if changed:
            told = {option["name"]: option["description"] for option in entry.facts.options} if entry.facts else {}
            remarks += [(entry, f"option {key} = {value}: {told[key]}") for key, value in changed.items()]
        if entry.fit and entry.fit.get("status") == "ok":
            why = " ".join(str(entry.fit.get("message") or "").split())
            if entry.fit.get("converged") is False:
                remarks.append((entry, f"did not converge{f' ({why})' if why else ''}; its best parameters are shown"))
            elif why:
                remarks.append((entry, why))
    return remarks


def _beside(published: Mapping[str, float], ours: Mapping[str, Any]) -> list[tuple[str, float | None, float | None]]:
    """Published parameters beside ours: kd_r beside kd[0], n_2 beside n[1]."""
    rows: list[tuple[str, float | None, float | None]] = []
    for key, value in published.items():
        if key == "psnr_db":
            continue
        name, _, index = key.rpartition("_")
        place = {"r": 0, "g": 1, "b": 2}.get(index, int(index) - 1 if index.isdigit() else None)
        values = ours.get(name, ours.get(name.lower()))
        mine = None
        if (
            isinstance(values, list)
            and place is not None
            and place < len(values)
            and isinstance(values[place], int | float)
        ):
            mine = float(values[place])
        rows.append((key, value, mine))
    return rows


def _published_frame(material: Material, entries: Sequence[Entry]) -> pd.DataFrame:
    rows = []
    for entry in entries:
        if entry.published:
            rows.append(
                (material.name, entry.name, "psnr_db", entry.published.get("psnr_db", float("nan")), entry.mean)
            )
            rows += [(material.name, entry.name, *row) for row in entry.table]
    return pd.DataFrame(rows, columns=["material", "model", "parameter", "published", "ours"])


def parameter_rows(entry: Entry) -> list[tuple[str, list[float]]]:
    """Parameters that fit a line each; longer ones are drawn, and are in the fit's file."""
    rows = []
    for name, values in ((entry.fit or {}).get("parameters") or {}).items():
        flat = list(_numbers(values))
        if 0 < len(flat) <= 24:
            rows.append((name, flat))
    return rows


def _numbers(value: Any) -> Iterable[float]:
    if isinstance(value, list | tuple):
        for item in value:
            yield from _numbers(item)
    elif isinstance(value, int | float) and not isinstance(value, bool):
        yield float(value)


def other_figures(page: Path, folder: Path, placed: set[str]) -> list[tuple[str, Picture]]:
    """Curves of the material that have no place of their own on the page, by the words of their file names."""
    drawn = [(path.stem.replace("-", " ").replace("_", " "), path) for path in sorted(folder.glob("*.svg"))]
    return [(title, found) for title, path in drawn if path.name not in placed and (found := find_picture(page, path))]


def _pictures(page: Path, folder: Path, model: str, scenes: Sequence[SceneFacts]) -> dict[tuple[str, str], Picture]:
    found = {}
    for scene in scenes:
        for suffix in ("", *(item[2] for item in ERROR_SECTIONS)):
            picture = find_picture(page, picture_file(folder, scene.name, model, suffix[1:] or "render"))
            if picture:
                found[scene.name, suffix] = picture
    return found


def _named_pictures(page: Path, folder: Path, kind: str, entries: Sequence[Entry]) -> list[tuple[Entry, Picture]]:
    drawn = ((entry, find_picture(page, folder / kind / f"{entry.name}.svg")) for entry in entries)
    return [(entry, picture) for entry, picture in drawn if picture]


def _bars(page: Path) -> dict[str, Picture]:
    """Colour bars of the difference pictures, by the ending of the pictures' names."""
    texts = {
        "-de00": "Colour scale of the CIEDE2000 difference",
        "-diff": "Colour scale of the signed difference, too dark to too bright",
        "-flip": "Colour scale of FLIP, 0 to 1",
    }
    folder = page.parent.parent / "assets"
    drawn = {suffix: find_picture(page, folder / f"bar{suffix}.svg", text) for suffix, text in texts.items()}
    return {suffix: picture for suffix, picture in drawn.items() if picture}


def _swatch(albedo: Any) -> str:
    """The albedo as a CSS colour, through the sRGB curve."""
    if not albedo:
        return "transparent"

    def encode(x: float) -> int:
        x = min(max(float(x), 0.0), 1.0)
        return round(255 * (12.92 * x if x <= 0.0031308 else 1.055 * x ** (1 / 2.4) - 0.055))

    return "rgb({} {} {})".format(*(encode(v) for v in albedo[:3]))
