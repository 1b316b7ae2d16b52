"""The page of one material: the recommended fit beside the reference, every fit to take away, pictures, functions,
numbers."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from urllib.parse import quote

import pandas as pd

from brdfatlas.constants import REFERENCE, REFERENCE_AGAIN
from brdfatlas.export.targets import stem_of
from brdfatlas.figures.pictures import ANIMATION, CONVERGENCE, picture_file
from brdfatlas.files import read_record
from brdfatlas.fits import known_details
from brdfatlas.measures.summary import BRDF_MEASURES, BUDGETS, LEADING, MEASURES, PSNR, Summary, best_by_noise, best_of
from brdfatlas.reports.data import (
    Material,
    ModelFacts,
    SceneFacts,
    fits_frame,
    model_facts,
    parameters_frame,
    physics_of,
    published_row,
    read_material,
    summarise_run,
    write_tsv,
)
from brdfatlas.reports.fit_files import ENDINGS, files_of
from brdfatlas.reports.formats import digits, integer, number, storage
from brdfatlas.reports.pages import Picture, find_picture, render_page, write_thumbnail

#: Kinds of pictures of the grid: name, button, what its values are, caption.
KINDS = (
    (
        "render",
        "Render",
        "ΔE00",
        "The same tone map, sampling density and random numbers for all, so that only the model differs. The mean "
        "ΔE00 is given below each picture.",
    ),
    (
        "de00",
        "ΔE00",
        "ΔE00",
        "CIEDE2000 colour difference to the reference at a fixed exposure, on one scale for all models and scenes; "
        "about 1 is just visible.",
    ),
    (
        "diff",
        "Signed difference",
        "PSNR",
        "Luminance of the fit minus luminance of the reference, as displayed: red is too bright, blue too dark. One "
        "scale for all models and scenes.",
    ),
    (
        "flip",
        "FLIP",
        "FLIP",
        "FLIP: the difference that an observer sees when flipping between the two pictures. One scale for all models "
        "and scenes.",
    ),
)
#: Figures of all models, in the order of the page.
FIGURES = ("functions.svg", "lobes.svg")
#: Arrays of more numbers are not printed; they are in the fit's file.
PRINTED = 24


@dataclass
class Entry:
    """A model on a material page, or the reference rendered with another seed."""

    name: str
    title: str
    facts: ModelFacts | None
    fit: Mapping[str, Any] | None
    rows: dict[str, dict[str, Any]]
    brdf: dict[str, Any] | None
    reason: str = ""
    best: set[tuple[str, str]] = field(default_factory=set)
    stem: str = ""
    files: list[tuple[str, str, str]] = field(default_factory=list)
    published: Mapping[str, float] = field(default_factory=dict)
    parameters: list[dict[str, Any]] = field(default_factory=list)
    bounds: str = ""

    @property
    def physics(self) -> Mapping[str, Any]:
        return physics_of(self.fit)

    @property
    def noise(self) -> bool:
        return self.facts is None


#: What the page says of a material, where its description has it.
FACTS = ("class", "source", "sha256", "albedo", "range", "format", "kind", "origin", "instrument", "note", "shares")
FACTS += ("warnings",)


def write_material_page(
    output: str | Path,
    *,
    material_file: str | Path,
    fit_files: Sequence[str | Path],
    errors_file: str | Path,
    brdf_errors_file: str | Path,
    listing: str | Path,
    pictures: str | Path,
    data: str | Path,
    materials: Sequence[str],
    models: Sequence[str],
    scenes: Sequence[SceneFacts],
    published: str | Path | None = None,
    animation: str | Path | None = None,
    **links: bool,
) -> None:
    """Write the page of one material, its tables in ``data`` and its thumbnail in ``pictures``.

    ``listing``: the files of its fits (:mod:`.fit_files`); ``pictures``: the folder of its pictures (figures.pictures);
    ``animation``: the note beside animation.webp there, if any; ``materials`` is the order of pages. The page needs
    nothing of other materials: it is out when its material is.
    """
    output, pictures, data = Path(output), Path(pictures), Path(data)
    material = read_material(material_file, fit_files, errors_file, brdf_errors_file)
    summary = summarise_run([material], {name: model_facts(name) for name in models})
    entries = make_entries(material, summary, scenes, published)
    _add_files(entries, material.name, listing)
    write_thumbnail(pictures, scenes, models)
    place = list(materials).index(material.name)
    by_name = {entry.name: entry for entry in entries}
    budgets = [(b, by_name.get(n or "")) for b, n in zip(BUDGETS, summary.recommend([material.name]), strict=True)]
    chosen = next(entry for budget, entry in budgets if budget.key == "any")
    render_page(
        "material.html.j2",
        output,
        root="../",
        here="material",
        **links,
        material=material,
        facts=dict.fromkeys(FACTS, "") | dict(material.facts),
        swatch=_swatch(material.facts.get("albedo")),
        lede=material_lede(material, summary, scenes),
        previous=materials[place - 1] if place else "",
        following=materials[place + 1] if place + 1 < len(materials) else "",
        scenes=scenes,
        unjudged=material.unjudged_told(scenes),
        entries=entries,
        noise=make_entry(material, REFERENCE_AGAIN, None, scenes),
        chosen=chosen,
        budgets=budgets,
        kinds=KINDS,
        animation=animation_told(output, pictures, animation, by_name),
        **_pictured(output, pictures, scenes, entries, chosen),
        measures=MEASURES,
        brdf_measures=BRDF_MEASURES,
        remarks=_remarks(entries),
        script=page_data(material, summary, entries, scenes),
        data_links=_write_tables(data, material, entries, summary),
    )


def _add_files(entries: Sequence[Entry], material: str, listing: str | Path) -> None:
    """Say which files of each fit there are to take away."""
    endings = files_of(listing, material, [entry.name for entry in entries])
    for entry, found in zip(entries, endings, strict=True):
        entry.stem = stem_of(material, entry.name)
        base = f"{quote(material)}/fits/{quote(entry.stem)}"
        entry.files = [(end, f"{base}{end}", ENDINGS[end]) for end in found]


def _pictured(
    page: Path, pictures: Path, scenes: Sequence[SceneFacts], entries: Sequence[Entry], chosen: Entry | None
) -> dict[str, Any]:
    """What the page shows of the pictures that are there."""
    hero = (REFERENCE, chosen.name) if chosen else ()
    return {
        "hero": [find_picture(page, picture_file(pictures, scenes[0].name, name)) for name in hero],
        "size": _picture_size(page, pictures, scenes, [entry.name for entry in entries]),
        "bars": _bars(page),
        "figures": [(name, f"{quote(pictures.name)}/{name}") for name in FIGURES if (pictures / name).is_file()],
        "curves": (pictures / "curves.js").is_file(),
        "diagnostics": diagnostics(page, pictures, entries),
    }


def _write_tables(data: Path, material: Material, entries: Sequence[Entry], summary: Summary) -> list[tuple[str, str]]:
    """The tables of a material below ``data``; returns their titles and addresses from its page."""
    tables = {
        "image errors": ("errors.tsv", material.errors),
        "BRDF-space errors": ("brdf.tsv", material.brdf_errors),
        "fits": ("fits.tsv", fits_frame(material)),
        "parameters": ("parameters.tsv", parameters_frame(material)),
        "published parameters": ("published.tsv", _published_frame(material, entries, summary)),
    }
    for file, frame in tables.values():
        write_tsv(data / "materials" / material.name / file, frame)
    return [(title, f"../data/materials/{quote(material.name)}/{file}") for title, (file, _) in tables.items()]


def animation_told(
    page: Path, pictures: Path, note: str | Path | None, entries: Mapping[str, Entry]
) -> tuple[Picture, str, list[Entry]] | None:
    """The animation of the material, the name of its scene and the models beside the reference; None without one."""
    picture = find_picture(page, pictures / ANIMATION) if note else None
    if note is None or picture is None:
        return None
    told = read_record(note, "scene", "models")
    return picture, str(told["scene"]).replace("_", " "), [entries[name] for name in told["models"] if name in entries]


def make_entries(
    material: Material, summary: Summary, scenes: Sequence[SceneFacts], published: str | Path | None
) -> list[Entry]:
    """Every model on a material, best first by ΔE00, with the best of every column marked and its parameters."""
    order = summary.order(LEADING, material.name)
    entries = [
        make_entry(material, name, summary.models[name], scenes) for name in order if name not in material.absent
    ]
    mark_best(material, entries)
    for entry in entries:
        entry.published = published_row(published, entry.name, material.name)
        entry.parameters = parameter_table(entry)
        entry.bounds = bounds_text(known_details(entry.fit or {}))
    return entries


def material_lede(material: Material, summary: Summary, scenes: Sequence[SceneFacts]) -> str:
    """What happened to a material, from its own errors: the best and the worst model, how many are close."""
    names = set(summary.complete(material.name))
    ranked = [name for name in summary.order(LEADING, material.name) if name in names]
    told_of = material.unjudged_told(scenes)
    unjudged = f" {told_of[0].upper()}{told_of[1:]}." if told_of else ""
    if not ranked:
        return f"No model has every picture of {material.title} in this run.{unjudged}"

    def told(name: str) -> str:
        return digits(summary.value(name, LEADING, material.name), LEADING.digits)

    best, worst = ranked[0], ranked[-1]
    count = len(scenes) - len(material.unjudged)
    over = f", mean over {count} scenes" if count > 1 else ""
    size = storage(summary.cost(best, "bytes", material.name))
    text = f"{summary.models[best].title} comes closest to the reference (ΔE00 {told(best)}{over}; {size})"
    if worst != best:
        text += f"; {summary.models[worst].title} is farthest from it (ΔE00 {told(worst)})"
    limit = 1.0
    close = sum(summary.value(name, LEADING, material.name) < limit for name in ranked)
    text += f". {close} of {len(ranked)} models stay below a ΔE00 of 1, which is just visible"
    failed = len(summary.models) - len(ranked) - len(material.absent)
    if failed:
        text += f". {failed} lack{'s' if failed == 1 else ''} pictures: the reason is given below"
    for reason in dict.fromkeys(material.absent.values()):
        titles = [summary.models[name].title for name, why in material.absent.items() if why == reason]
        text += f". Left out: {', '.join(titles)} ({reason})"
    return f"{text}.{unjudged}"


def make_entry(material: Material, name: str, facts: ModelFacts | None, scenes: Sequence[SceneFacts]) -> Entry:
    """A model on a material, from the rows of its tables; measures that a table lacks are NaN."""
    rows = material.errors[material.errors["model"] == name]
    by_scene = {str(row["scene"]): row for row in rows.to_dict("records")}
    for row in by_scene.values():
        for key in (*(measure.key for measure in MEASURES), "psnr_se_db"):
            row.setdefault(key, float("nan"))
    brdf = material.brdf_errors[material.brdf_errors["model"] == name].to_dict("records")
    for row in brdf:
        for measure in BRDF_MEASURES:
            row.setdefault(measure.key, float("nan"))
    fit = material.fits.get(name)
    if fit is not None:
        fit = dict.fromkeys(("bytes", "seconds", "iterations", "converged", "seed")) | dict(fit)
    reason = ""
    if fit is not None and fit.get("status") != "ok":
        reason = f"fit failed: {' '.join(str(fit.get('reason') or 'no reason given').split())}"
    mine = set(by_scene) - set(material.unjudged)
    bad = [scene for scene in scenes if scene.name in mine and by_scene[scene.name]["status"] != "ok"]
    if not reason and bad:
        told = [f"{scene.label} ({by_scene[scene.name].get('reason') or 'no reason given'})" for scene in bad]
        reason = f"cannot be judged: {', '.join(told)}"
    title = facts.title if facts else "reference, other seed"
    return Entry(name, title, facts, fit, by_scene, brdf[0] if brdf else None, reason)


def mark_best(material: Material, entries: Sequence[Entry]) -> None:
    """Mark the best of every picture and measure (:func:`best_by_noise`)."""
    by_name = {entry.name: entry for entry in entries}
    for measure in MEASURES:
        for row in best_by_noise(material.errors, list(by_name), measure, material.pairs).itertuples():
            by_name[row.model].best.add((row.scene, measure.key))
    for measure in BRDF_MEASURES:
        for name in best_of({e.name: e.brdf[measure.key] for e in entries if e.brdf and not e.reason}, measure):
            by_name[name].best.add(("brdf", measure.key))


def page_data(
    material: Material, summary: Summary, entries: Sequence[Entry], scenes: Sequence[SceneFacts]
) -> dict[str, Any]:
    """What the page's script draws: the models best first, and their values a scene."""

    def value(entry: Entry, scene: SceneFacts, key: str) -> float | str | None:
        found = entry.rows.get(scene.name, {}).get(key)
        # JSON has no infinity
        return "Infinity" if found == math.inf else number_or_none(math.nan if found is None else found)

    keys = (LEADING.key, "flip_mean", "psnr_db", "psnr_se_db")
    return {
        "material": material.name,
        "scenes": [scene.name for scene in scenes],
        "models": [
            {
                "name": entry.name,
                "title": entry.title,
                "family": entry.facts.family if entry.facts else "",
                "de00": number_or_none(summary.value(entry.name, LEADING, material.name)),
                "bytes": number_or_none(summary.cost(entry.name, "bytes", material.name)),
                "reason": entry.reason,
                "values": {key: [value(entry, scene, key) for scene in scenes] for key in keys},
            }
            for entry in entries
        ],
        "front": summary.front("bytes", LEADING, material.name),
    }


def number_or_none(value: float) -> float | None:
    return None if not math.isfinite(value) else float(f"{value:.5g}")


def _remarks(entries: Sequence[Entry]) -> list[tuple[str, list[str]]]:
    """What a reader must know before using the numbers, each thing said once with the models it holds for."""
    remarks: dict[str, list[str]] = {}
    for entry in entries:
        chosen = (entry.fit or {}).get("options") or {}
        told = {option["name"]: option for option in entry.facts.options} if entry.facts else {}
        for key, value in chosen.items():
            if key in told and value != told[key]["default"]:
                remarks.setdefault(f"option {key} = {value}: {told[key]['description']}", []).append(entry.title)
        if entry.fit and entry.fit.get("status") == "ok":
            why = " ".join(str(entry.fit.get("message") or "").split())
            if entry.fit.get("converged") is False:
                text = f"did not converge{f' ({why})' if why else ''}; the best parameters found are shown"
                remarks.setdefault(text, []).append(entry.title)
            elif why:
                remarks.setdefault(why, []).append(entry.title)
    return list(remarks.items())


def parameter_table(entry: Entry) -> list[dict[str, Any]]:
    """A row a parameter of a model: name, meaning, unit, bounds, fitted values beside published ones, and whether a
    value lies on a bound. Long arrays have their size instead of values."""
    fitted = (entry.fit or {}).get("parameters") or {}
    theirs = {_parameter_of(key): value for key, value in entry.published.items()}
    rows = []
    for item in entry.facts.parameters if entry.facts else ():
        name = item["name"]
        values = list(_numbers(fitted.get(name, [])))
        ends = [end for end in (item["low"], item["high"]) if math.isfinite(end)]
        printed = [(number(v), any(math.isclose(v, end, rel_tol=1e-6) for end in ends)) for v in values]
        places = sorted(place for found, place in theirs if found == name.lower() and place >= 0)
        published = [number(theirs[name.lower(), place]) for place in places]
        rows.append(item | {"values": printed, "published": published})
    return rows


def bounds_text(details: Mapping[str, Any]) -> str:
    """Which bounds a fit has reached, from :func:`.fits.known_details`; "" if none. ``bound``: how many values of a
    factor lie at its lower bound; ``bounds``: parameters at an end of their range."""
    bound, listed = details["bound"], details["bounds"]
    found = []
    if bound.get("held"):
        found.append(
            f"{integer(bound['held'])} of {integer(bound['count'])} values of {bound['factor']} lie at the lower "
            f"bound, {number(bound['value'])} of the largest value"
        )
    if listed:
        found.append(f"at a bound: {', '.join(map(str, listed))}")
    text = "; ".join(found)
    return f"{text[0].upper()}{text[1:]}." if text else ""


def _parameter_of(key: str) -> tuple[str, int]:
    """A published column such as kd_r or n_2 as (parameter, index), in lower case; index -1 for one that is none."""
    name, _, index = key.rpartition("_")
    place = {"r": 0, "g": 1, "b": 2}.get(index, int(index) - 1 if index.isdigit() else -1)
    return name.lower(), place


def _published_frame(material: Material, entries: Sequence[Entry], summary: Summary) -> pd.DataFrame:
    """Published parameters and PSNRs, by the names of the published tables, beside ours."""
    rows = []
    for entry in entries:
        fitted = {name.lower(): list(_numbers(v)) for name, v in ((entry.fit or {}).get("parameters") or {}).items()}
        for key, value in entry.published.items():
            name, index = _parameter_of(key)
            values = fitted.get(name, [])
            ours = values[index] if 0 <= index < len(values) else float("nan")
            if key == "psnr_db":
                ours = summary.value(entry.name, PSNR, material.name)
            rows.append((material.name, entry.name, key, value, ours))
    return pd.DataFrame(rows, columns=["material", "model", "parameter", "published", "ours"])


def parameter_rows(entry: Entry) -> list[tuple[str, list[float]]]:
    """Parameters that fit a line each; longer ones are drawn, and are in the fit's file."""
    rows = []
    for name, values in ((entry.fit or {}).get("parameters") or {}).items():
        flat = list(_numbers(values))
        if 0 < len(flat) <= PRINTED:
            rows.append((name, flat))
    return rows


def _numbers(value: Any) -> Iterable[float]:
    if isinstance(value, list | tuple):
        for item in value:
            yield from _numbers(item)
    elif isinstance(value, int | float) and not isinstance(value, bool):
        yield float(value)


def diagnostics(page: Path, folder: Path, entries: Sequence[Entry]) -> list[tuple[str, str, Picture]]:
    """Drawn figures of the fits, folded on the page: title, caption, picture; what an own model drew comes last."""
    found: list[tuple[str, str, Picture]] = []

    def add(path: Path, title: str, caption: str) -> None:
        picture = find_picture(page, path)
        if picture:
            found.append((title, caption, picture))

    add(
        folder / "samples.svg",
        "Samples",
        "Where the material was measured, over θh and θd, and how far the nearest sample is from each cell of the grid "
        "(mean over φd); white: outside the hull of the samples, unmeasured.",
    )
    add(
        folder / "slices.webp",
        "Slices",
        "The BRDF at φd = 90°, θh to the right and θd upwards, of the reference and the fits, under the compressive "
        "tone map (Bagher et al. 2016, Fig. 5).",
    )
    add(
        folder / "weights.svg",
        "Weights",
        "Weights of the objective over θh and θd at φd = 90°, each relative to its maximum, green channel (Bagher et "
        "al. 2016, Fig. 3).",
    )
    for entry in entries:
        for kind, text in (("functions", "Its functions."), ("factors", "Its factors in red, green and blue.")):
            add(folder / kind / f"{entry.name}.svg", entry.title, text)
    for entry in entries:
        text = "Objective over the iterations of every start, one plot per colour channel."
        add(folder / "convergence" / f"{entry.name}.svg", entry.title, text)
    add(
        folder / CONVERGENCE,
        "Eight starts",
        "Animation: D, F and G of every start of the independent factors, one picture per iteration, green channel. "
        "Starts that are far from the best, or meet another, are not followed to the end.",
    )
    placed = {"samples.svg", "lobes.svg", "weights.svg", "functions.svg"}
    for path in sorted(folder.glob("*.svg")):
        if path.name not in placed:
            add(path, path.stem.replace("-", " ").replace("_", " ").capitalize(), "")
    return found


def _picture_size(
    page: Path, folder: Path, scenes: Sequence[SceneFacts], models: Sequence[str]
) -> tuple[int, int] | None:
    """Width and height of the renders; None where the run made none."""
    for name in (REFERENCE, *models):
        picture = find_picture(page, picture_file(folder, scenes[0].name, name))
        if picture:
            return picture.width, picture.height
    return None


def _bars(page: Path) -> dict[str, Picture]:
    """Colour bars of the difference pictures, by their kind."""
    texts = {
        "de00": "Colour scale of the CIEDE2000 difference",
        "diff": "Colour scale of the signed difference, too dark to too bright",
        "flip": "Colour scale of FLIP, 0 to 1",
    }
    folder = page.parent.parent / "assets"
    drawn = {kind: find_picture(page, folder / f"bar-{kind}.svg", text) for kind, text in texts.items()}
    return {kind: picture for kind, picture in drawn.items() if picture}


def _swatch(albedo: Any) -> str:
    """The albedo as a CSS colour, through the sRGB curve."""
    if not albedo:
        return "transparent"

    def encode(x: float) -> int:
        x = min(max(float(x), 0.0), 1.0)
        return round(255 * (12.92 * x if x <= 0.0031308 else 1.055 * x ** (1 / 2.4) - 0.055))

    return "rgb({} {} {})".format(*(encode(v) for v in albedo[:3]))
