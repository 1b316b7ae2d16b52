"""The supplement as PDF, in the manner of the papers' supplements: an overview, then the pages of every material.

Typst sets each material by itself from JPEG and SVG, so a changed material costs its own pages only; pypdf joins them.
All dates are fixed: the same run gives the same bytes.
"""

import datetime
import io
import json
import math
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib
import typst
from PIL import Image
from pypdf import PdfReader, PdfWriter
from pypdf.annotations import Link
from pypdf.generic import Fit

from brdfatlas.constants import REFERENCE, REFERENCE_AGAIN
from brdfatlas.figures.pareto import pareto_figure
from brdfatlas.figures.pictures import picture_file
from brdfatlas.files import atomic_path, read_record
from brdfatlas.measures.summary import BUDGETS, MEASURES, Measure, Summary, score_of
from brdfatlas.reports.data import Material, ModelFacts, SceneFacts, model_facts, read_material, summarise_run
from brdfatlas.reports.formats import digits, integer, number, plain, seconds, storage, with_error
from brdfatlas.reports.index_page import FEW_MATERIALS, findings, list_failures, model_rows
from brdfatlas.reports.material_page import Entry, make_entries, material_lede
from brdfatlas.reports.pages import TEMPLATES

TEMPLATE = TEMPLATES / "supplement.typ"
#: The date of every document: a constant, so that equal runs give equal files.
EPOCH = datetime.datetime(2000, 1, 1, tzinfo=datetime.UTC)
#: The figures' font comes with Matplotlib: the same on every machine.
FONTS = Path(matplotlib.get_data_path()) / "fonts" / "ttf"
TITLE = "BRDF atlas: supplement"
A4 = (595.276, 841.89)
#: Where columns of the contents begin, points.
MARGINS = (39.7, 311.8)
#: Measures of the tables.
TABLE = ("de00_mean", "de00_p95", "flip_mean", "psnr_db", "psnr_tonemapped_db", "ssim")
#: Width of a page's content and the height that both grids of tiles may take, mm; a tile's caption has four lines.
WIDTH, HEIGHT, CAPTION = 182, 226, 10.3
STANDINS = (
    "{0} of {1} materials are stand-ins, not measurements: each is the median of five published fits. Their numbers "
)
STANDINS += "cannot be compared with published ones."
RECONSTRUCTIONS = "{0} of {1} materials are reconstructions of measurements: means are over both kinds."


def typeset(data: Mapping[str, Any], files: Mapping[str, bytes] | None = None) -> bytes:
    """The template filled with ``data``; ``files`` are the pictures it names."""
    content = json.dumps(data, ensure_ascii=True, allow_nan=False).encode("ascii")
    with tempfile.TemporaryDirectory() as folder:
        for name, source in {"main.typ": TEMPLATE.read_bytes(), "data.json": content, **(files or {})}.items():
            (Path(folder) / name).write_bytes(source)
        main = str(Path(folder) / "main.typ")
        return typst.compile(
            main, root=folder, format="pdf", timestamp=EPOCH, ignore_system_fonts=True, font_paths=[FONTS]
        )


def jpeg(path: str | Path, size: int = 256, quality: int = 86) -> bytes:
    """A picture as JPEG on white, at most ``size`` pixels wide: what a page of paper can show."""
    with Image.open(path) as image:
        flat = image.convert("RGBA")
        canvas = Image.new("RGB", flat.size, "white")
        canvas.paste(flat, mask=flat.getchannel("A"))
        canvas.thumbnail((size, size), Image.Resampling.LANCZOS)
        stream = io.BytesIO()
        canvas.save(stream, "JPEG", quality=quality, optimize=True)
        return stream.getvalue()


class Files:
    """Pictures of one document by the names that the template knows them by; each is stored once."""

    def __init__(self) -> None:
        self.content: dict[str, bytes] = {}
        self._names: dict[Path, str] = {}

    def add(self, path: Path) -> str:
        """The name of a picture; empty where the run made none."""
        if not path.is_file():
            return ""
        if path not in self._names:
            svg = path.suffix == ".svg"
            self._names[path] = name = f"p{len(self.content)}{'.svg' if svg else '.jpg'}"
            self.content[name] = path.read_bytes() if svg else jpeg(path)
        return self._names[path]


def write_material_pdf(
    output: str | Path,
    *,
    material_file: str | Path,
    fit_files: Sequence[str | Path],
    errors_file: str | Path,
    brdf_errors_file: str | Path,
    pictures: str | Path,
    assets: str | Path,
    models: Sequence[str],
    scenes: Sequence[SceneFacts],
    published: str | Path | None = None,
) -> None:
    """Write the pages of one material: renders and colour differences, the same with the reference in every slot, so
    that paging flips; lobes, functions and numbers; parameters."""
    pictures, files = Path(pictures), Files()
    material = read_material(material_file, fit_files, errors_file, brdf_errors_file)
    summary = summarise_run([material], {name: model_facts(name) for name in models})
    entries = make_entries(material, summary, scenes, published)
    scene = scenes[0]
    reference = files.add(picture_file(pictures, scene.name, REFERENCE))
    renders = [_tile("reference", reference, "", "no picture")]
    errors = []
    unjudged = material.unjudged_told(scenes)
    for entry in entries:
        why = entry.reason or unjudged
        row = entry.rows.get(scene.name, {})
        psnr = f"{digits(row.get('psnr_db'), 1)} dB"
        delta = f"ΔE00 {digits(row.get('de00_mean'), 2)}"
        render, error = (files.add(picture_file(pictures, scene.name, entry.name, kind)) for kind in ("render", "de00"))
        renders.append(_tile(entry.title, render, f"{delta} · {psnr}", why))
        errors.append(_tile(entry.title, error, delta, why))
    columns = tile_columns(len(renders), len(errors))
    flipped = [tile | ({"picture": reference} if tile["picture"] else {}) for tile in renders]
    data = {
        "kind": "material",
        "title": material.title,
        "standin": material.standin,
        "lede": material_lede(material, summary, scenes),
        "scene": scene.title or scene.label,
        "columns": columns,
        "tile": round((WIDTH - columns) / columns, 1),
        "pages": [renders, flipped],
        "errors": errors,
        "bar": files.add(Path(assets) / "bar-de00.svg"),
        "lobes": files.add(pictures / "lobes.svg"),
        "functions": files.add(pictures / "functions.svg"),
        "table": _material_table(material, summary, entries, scenes),
        "remarks": _footnotes(summary.models.values()),
        "parameters": parameter_lines(entries),
    }
    _write(output, typeset(data, files.content))


def tile_columns(renders: int, errors: int) -> int:
    """The fewest columns (largest pictures) with which both grids of square tiles fit one page."""
    for columns in range(4, 13):
        height = WIDTH / columns + CAPTION
        if height * (math.ceil(renders / columns) + math.ceil(errors / columns)) <= HEIGHT:
            return columns
    return 12


def _tile(title: str, picture: str, value: str, reason: str) -> dict[str, str]:
    return {"title": title, "picture": picture, "value": value, "reason": reason or "no picture", "alt": title}


def parameter_lines(entries: Sequence[Entry]) -> list[dict[str, Any]]:
    """For each model its parameters: symbol, meaning, unit, bounds, values (a star on a bound) and published ones."""
    found = []
    for entry in entries:
        rows = []
        for item in entry.parameters:
            values = ", ".join(f"{text}*" if bound else text for text, bound in item["values"])
            if not values:
                values = "–" if entry.reason else f"{item['shape']} numbers"
            theirs = ", ".join(item["published"])
            cells = [plain(item["name"]), item["description"], item["unit"] or "–", item["range"], values, theirs]
            rows.append(cells)
        if rows:
            found.append({"title": entry.title, "rows": rows})
    return found


def _shown(measure: Measure, mean: float, error: float) -> str:
    return with_error(mean, error, measure.digits) if measure.key == "psnr_db" else digits(mean, measure.digits)


def _material_table(
    material: Material, summary: Summary, entries: Sequence[Entry], scenes: Sequence[SceneFacts]
) -> dict[str, Any]:
    measures = [measure for measure in MEASURES if measure.key in TABLE]
    over = "mean over scenes" if len(scenes) > 1 else scenes[0].label
    head = [f"Model ({over})", *(measure.label for measure in measures), "Bytes", "Seconds", "Albedo ≤"]
    scores = summary.by_material[material.name]
    best = {measure.key: summary.best(measure, material.name) for measure in measures}
    rows = []
    for entry in entries:
        found = [score_of(scores, entry.name, measure.key) for measure in measures]
        cells = [_shown(measure, score.mean, score.error) for measure, score in zip(measures, found, strict=True)]
        marked = [place for place, measure in enumerate(measures, 1) if entry.name in best[measure.key]]
        fit = entry.fit or {}
        cells += [integer(fit.get("bytes")), number(fit.get("seconds")), digits(entry.physics["max_albedo"], 3)]
        title = f"{entry.title} (failed)" if entry.reason else entry.title
        rows.append({"cells": [title, *cells], "best": marked, "kind": ""})
    if REFERENCE_AGAIN in scores:
        noise = [score_of(scores, REFERENCE_AGAIN, measure.key) for measure in measures]
        cells = [digits(score.mean, measure.digits) for score, measure in zip(noise, measures, strict=True)]
        rows.append({"cells": ["reference, other seed", *cells, "", "", ""], "best": [], "kind": "noise"})
    return {"head": head, "rows": rows, "size": 7.0 if len(rows) < 36 else 6.2}


def _footnotes(facts: Sequence[ModelFacts] | Any) -> list[str]:
    notes: dict[str, list[str]] = {}
    for item in facts:
        if item.status:
            notes.setdefault(item.status, []).append(item.title)
        if not item.reciprocal:
            notes.setdefault("not reciprocal, as published", []).append(item.title)
    return [f"{', '.join(titles)}: {text}." for text, titles in notes.items()]


def write_supplement(
    output: str | Path,
    *,
    run_file: str | Path,
    materials: Sequence[Material],
    parts: Sequence[str | Path],
    models: Sequence[str],
    scenes: Sequence[SceneFacts],
) -> None:
    """Write the overview and join it with the materials' PDFs ``parts`` (same order), numbered, linked, bookmarked."""
    readers = [PdfReader(part) for part in parts]
    counts = [len(reader.pages) for reader in readers]
    data, files = overview(read_record(run_file), materials, models, scenes)
    front = 2
    while True:  # the contents hold page numbers, which depend on how long the contents are
        starts = [front + sum(counts[:i]) for i in range(len(counts))]
        contents = [
            {"name": m.name, "title": m.title, "standin": m.standin, "page": str(start + 1)}
            for m, start in zip(materials, starts, strict=True)
        ]
        data["contents"] = contents if len(materials) >= FEW_MATERIALS else []
        first = PdfReader(io.BytesIO(typeset(data, files)))
        if len(first.pages) == front:
            break
        front = len(first.pages)
    writer = PdfWriter()
    for reader in (first, *readers):
        for page in reader.pages:
            writer.add_page(page)
    stamps = PdfReader(io.BytesIO(typeset({"kind": "stamps", "title": TITLE, "count": len(writer.pages)})))
    for page, stamp in zip(writer.pages, stamps.pages, strict=True):
        page.merge_page(stamp)
        page.compress_content_streams()  # merging leaves them unpacked, ten times as large
    writer.add_outline_item(title="Overview", page_number=0)
    for material, start in zip(materials, starts, strict=True):
        title = material.title + (" (stand-in)" if material.standin else "")
        writer.add_outline_item(title=title, page_number=start)
    _link_contents(writer, first, materials, starts)
    date = EPOCH.strftime("D:%Y%m%d%H%M%SZ")
    writer.add_metadata({"/Title": TITLE, "/Creator": "brdfatlas", "/CreationDate": date, "/ModDate": date})
    writer.compress_identical_objects(remove_unreferenced=True)
    stream = io.BytesIO()
    writer.write(stream)
    _write(output, stream.getvalue())


def _link_contents(writer: PdfWriter, front: PdfReader, materials: Sequence[Material], starts: Sequence[int]) -> None:
    """A link over each line of the contents: its place is that of the material's page number in the text."""
    if len(materials) < FEW_MATERIALS:
        return
    wanted = {str(start + 1): start for start in starts}
    for place, page in enumerate(front.pages):
        if place < 2:
            continue
        lines: list[tuple[float, float, str]] = []

        def visit(text, cm, tm, _font, _size, lines=lines):
            x, y = (tm[4] * cm[i] + tm[5] * cm[2 + i] + cm[4 + i] for i in (0, 1))
            # what begins at a margin is a title, which may end in a number
            if text.strip() and y > 0 and min(abs(x - margin) for margin in MARGINS) > 1:
                lines.append((y, x, text.strip()))

        page.extract_text(visitor_text=visit)
        for y, x, text in lines:
            target = wanted.pop(text.split()[-1], None)
            if target is not None:
                half = A4[0] / 2 if len(materials) > 40 else A4[0]
                left = 40 if x < half else half
                rect = (left, y - 2.5, left + half - 50, y + 9)
                writer.add_annotation(place, Link(rect=rect, target_page_index=target, fit=Fit.fit()))


def overview(
    run: Mapping[str, Any], materials: Sequence[Material], models: Sequence[str], scenes: Sequence[SceneFacts]
) -> tuple[dict[str, Any], dict[str, bytes]]:
    """What the first two pages say: findings, recommendation, error against cost; the models, failures."""
    summary = summarise_run(materials, {name: model_facts(name) for name in models})
    rows = model_rows(summary)
    standins = sum(material.standin for material in materials)
    reconstructed = sum(material.reconstructed for material in materials)
    failures = [f"{f['title']}, {f['model_title']}: {f['reason']}" for f in list_failures(materials, summary.models)]
    failures += [f"left out: {item['name']}: {item['reason']}" for item in run.get("left_out") or []]
    figure = pareto_figure(summary)
    version = (run.get("versions") or {}).get("brdfatlas", "")
    data = {
        "kind": "overview",
        "title": TITLE,
        "standins": " ".join(
            words.format(count, len(materials))
            for words, count in ((STANDINS, standins), (RECONSTRUCTIONS, reconstructed))
            if count
        ),
        "findings": findings(materials, summary),
        "about": f"{len(materials)} materials, {len(models)} models, {len(scenes)} scene{'s' * (len(scenes) != 1)}; "
        f"brdfatlas {version}, revision {run.get('revision', 'unknown')}.",
        "recommended": _recommended_table(materials, summary),
        "pareto": "pareto.svg" if figure else "",
        "table": _models_table(rows),
        "remarks": _footnotes(summary.models.values()),
        "failures": failures,
        "contents": [],
    }
    return data, {"pareto.svg": figure} if figure else {}


def _recommended_table(materials: Sequence[Material], summary: Summary) -> dict[str, Any]:
    """The recommendation for each material, or for each class where there are many: a cell holds model, ΔE00, bytes
    and seconds."""
    groups = {m.title: [m.name] for m in materials}
    if len(materials) > FEW_MATERIALS:
        groups = {}
        for name, found in summary.classes.items():
            groups.setdefault(found or "unknown", []).append(name)
        groups = {f"{name} ({len(members)})": members for name, members in groups.items()}
    rows = []
    for title, members in groups.items():
        cells = []
        for model in summary.recommend(members):
            found = summary.candidate(model, group=members) if model else None
            numbers = f"{digits(found.de00, 2)} · {storage(found.bytes)} · {seconds(found.seconds)}" if found else ""
            cells.append({"model": summary.models[model].title if model else "none", "numbers": numbers})
        rows.append({"title": title, "cells": cells})
    return {"head": [budget.title for budget in BUDGETS], "rows": rows}


def _models_table(rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Medians over the materials, best first."""
    measures = [measure for measure in MEASURES if measure.key in TABLE]
    cells = []
    for row in rows:
        values = [digits(row["scores"][measure.key].median, measure.digits) for measure in measures]
        about = [row["facts"].paper, storage(row["bytes"]), number(row["seconds"])] if row["facts"] else ["", "", ""]
        best = [4 + place for place, measure in enumerate(measures) if measure.key in row["best"]]
        cells.append({"cells": [row["title"], *about, *values], "best": best, "kind": "noise" if row["noise"] else ""})
    head = ["Model (median over materials)", "Paper", "Storage", "Fit (s)", *(measure.label for measure in measures)]
    return {"head": head, "rows": cells, "size": 7.2 if len(cells) < 40 else 6.2}


def _write(path: str | Path, content: bytes) -> None:
    with atomic_path(path) as temporary:
        temporary.write_bytes(content)
