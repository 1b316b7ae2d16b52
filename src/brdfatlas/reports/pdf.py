"""The supplement as PDF: an overview with contents, two pages a material, in the manner of the papers' supplements.

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

import numpy as np
import typst
from PIL import Image
from pypdf import PdfReader, PdfWriter
from pypdf.annotations import Link
from pypdf.generic import Fit

from brdfatlas.constants import REFERENCE
from brdfatlas.figures.pictures import picture_file
from brdfatlas.files import atomic_path, read_json
from brdfatlas.reports.data import (
    MEASURES,
    NOISE_FLOOR,
    Material,
    ModelFacts,
    SceneFacts,
    model_facts,
    pareto_front,
    read_material,
    score_of,
)
from brdfatlas.reports.formats import digits, integer, number, storage, with_error
from brdfatlas.reports.index_page import findings, list_failures, run_tables
from brdfatlas.reports.material_page import Entry, make_entry, mark_best, material_lede
from brdfatlas.reports.pages import TEMPLATES

TEMPLATE = TEMPLATES / "supplement.typ"
#: The date of every document: a constant, so that equal runs give equal files.
EPOCH = datetime.datetime(2000, 1, 1, tzinfo=datetime.UTC)
TITLE = "BRDF atlas: supplement"
A4 = (595.276, 841.89)
#: Measures of the table on a material's second page.
TABLE = ("psnr_db", "psnr_tonemapped_db", "de00_mean", "de00_p95", "flip_mean", "ssim")


def typeset(data: Mapping[str, Any], files: Mapping[str, bytes] | None = None) -> bytes:
    """The template filled with ``data``; ``files`` are the pictures it names."""
    content = json.dumps(data, ensure_ascii=True, allow_nan=False).encode("ascii")
    with tempfile.TemporaryDirectory() as folder:
        for name, source in {"main.typ": TEMPLATE.read_bytes(), "data.json": content, **(files or {})}.items():
            (Path(folder) / name).write_bytes(source)
        main = str(Path(folder) / "main.typ")
        return typst.compile(main, root=folder, format="pdf", timestamp=EPOCH, ignore_system_fonts=True)


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
) -> None:
    """Write the two pages of one material: renders and colour differences; lobes, functions and numbers."""
    pictures = Path(pictures)
    material = read_material(material_file, fit_files, errors_file, brdf_errors_file)
    facts = {name: model_facts(name) for name in models}
    entries = [make_entry(material, name, facts[name], scenes) for name in models]
    mark_best(material, entries, scenes)
    files: dict[str, bytes] = {}

    def add(path: Path) -> str:
        if not path.is_file():
            return ""
        name = f"p{len(files)}{'.svg' if path.suffix == '.svg' else '.jpg'}"
        files[name] = path.read_bytes() if path.suffix == ".svg" else jpeg(path)
        return name

    scene = scenes[0]
    renders = [_tile("reference", add(picture_file(pictures, scene.name, REFERENCE)), "", "no picture")]
    errors = []
    for entry in entries:
        row = entry.rows.get(scene.name, {})
        psnr = f"{with_error(row.get('psnr_db'), row.get('psnr_se_db'))} dB"
        renders.append(_tile(entry.title, add(picture_file(pictures, scene.name, entry.name)), psnr, entry.reason))
        delta = digits(row.get("de00_mean"), 2)
        errors.append(
            _tile(entry.title, add(picture_file(pictures, scene.name, entry.name, "de00")), delta, entry.reason)
        )
    columns = tile_columns(len(renders), len(errors))
    drawn = [
        (entry.title, pictures / kind / f"{entry.name}.svg") for kind in ("functions", "factors") for entry in entries
    ]
    functions = [{"title": title, "picture": add(path)} for title, path in drawn if path.is_file()]
    data = {
        "kind": "material",
        "title": material.title,
        "standin": material.standin,
        "lede": material_lede(material, entries, scenes),
        "scene": scene.title or scene.label,
        "columns": columns,
        "tile": round((182 - columns) / columns, 1),
        "renders": renders,
        "errors": errors,
        "bar": add(Path(assets) / "bar-de00.svg"),
        "lobes": add(pictures / "lobes.svg"),
        "functions": functions,
        "table": _material_table(material, entries, scenes),
        "table_size": 7.0 if len(entries) * len(scenes) < 40 else 6.2,
        "remarks": _footnotes(facts.values()),
    }
    _write(output, typeset(data, files))


def tile_columns(renders: int, errors: int) -> int:
    """The fewest columns (largest pictures) with which both grids of square tiles fit one page."""
    for columns in range(4, 13):
        height = 182 / columns + 3.2
        if height * (math.ceil(renders / columns) + math.ceil(errors / columns)) <= 225:
            return columns
    return 12


def _tile(title: str, picture: str, value: str, reason: str) -> dict[str, str]:
    return {"title": title, "picture": picture, "value": value, "reason": reason or "no picture", "alt": title}


def _material_table(material: Material, entries: Sequence[Entry], scenes: Sequence[SceneFacts]) -> dict[str, Any]:
    measures = [measure for measure in MEASURES if measure.key in TABLE]
    over = "mean over scenes" if len(scenes) > 1 else scenes[0].label
    head = [f"Model ({over})", *(measure.label for measure in measures), "Bytes", "Seconds", "Albedo ≤"]
    means = {
        measure.key: {
            e.name: score_of(material.scores, e.name, measure.key).mean
            for e in entries
            if not material.missing.get(e.name)
        }
        for measure in measures
    }
    rows = []
    for entry in entries:
        cells, best = [entry.title], []
        for place, measure in enumerate(measures, 1):
            found = score_of(material.scores, entry.name, measure.key)
            psnr = measure.key == "psnr_db"
            cells.append(
                with_error(found.mean, found.error, measure.digits) if psnr else digits(found.mean, measure.digits)
            )
            alive = [value for value in means[measure.key].values() if not math.isnan(value)]
            best_mean = (max if measure.higher_is_better else min)(alive, default=None)
            if found.mean == best_mean and entry.name in means[measure.key]:
                best.append(place)
        fit = entry.fit or {}
        cells += [integer(fit.get("bytes")), number(fit.get("seconds")), digits(entry.physics["max_albedo"], 3)]
        rows.append(
            {"cells": [entry.title + " (failed)", *cells[1:]] if entry.reason else cells, "best": best, "kind": ""}
        )
    if NOISE_FLOOR in material.scores:
        floor = [score_of(material.scores, NOISE_FLOOR, measure.key) for measure in measures]
        cells = [digits(score.mean, measure.digits) for score, measure in zip(floor, measures, strict=True)]
        rows.append({"cells": ["noise floor (reference, other seed)", *cells, "", "", ""], "best": [], "kind": "floor"})
    return {"head": head, "rows": rows}


def _footnotes(facts: Sequence[ModelFacts] | Any) -> list[str]:
    notes = [f"{item.title}: {item.status}." for item in facts if item.status]
    flagged = [item.title for item in facts if not item.reciprocal]
    return notes + ([f"Not reciprocal, as published: {', '.join(flagged)}."] if flagged else [])


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
    data, files = overview(read_json(run_file), materials, models, scenes)
    front = 2
    while True:  # the contents hold page numbers, which depend on how long the contents are
        starts = [front + sum(counts[:i]) for i in range(len(counts))]
        data["contents"] = [
            {"name": m.name, "title": m.title, "standin": m.standin, "page": str(start + 1)}
            for m, start in zip(materials, starts, strict=True)
        ]
        first = PdfReader(io.BytesIO(typeset(data, files)))
        if len(first.pages) <= front:
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
    wanted = {str(start + 1): start for start in starts}
    for place, page in enumerate(front.pages):
        if place == 0:
            continue
        lines: list[tuple[float, float, str]] = []

        def visit(text, _cm, tm, _font, _size, lines=lines):
            if text.strip():
                lines.append((tm[5], tm[4], text.strip()))

        page.extract_text(visitor_text=visit)
        for y, x, text in lines:
            target = wanted.get(text.split()[-1])
            if target is not None:
                half = A4[0] / 2 if len(materials) > 40 else A4[0]
                left = 40 if x < half else half
                rect = (left, y - 2.5, left + half - 50, y + 9)
                writer.add_annotation(place, Link(rect=rect, target_page_index=target, fit=Fit.fit()))


def overview(
    run: Mapping[str, Any], materials: Sequence[Material], models: Sequence[str], scenes: Sequence[SceneFacts]
) -> tuple[dict[str, Any], dict[str, bytes]]:
    """What the first pages say: findings, the table of models, error against cost, failures."""
    facts = [model_facts(name) for name in models]
    rows, _tables = run_tables(run, materials, facts)
    standins = sum(material.standin for material in materials)
    measures = [measure for measure in MEASURES if measure.key in TABLE]
    cells = []
    for row in rows:
        scores = row["scores"]
        best = [4 + place for place, measure in enumerate(measures) if row["best"].get(measure.key)]
        values = [
            with_error(scores[m.key].mean, scores[m.key].error, m.digits)
            if m.key == "psnr_db"
            else digits(scores[m.key].mean, m.digits)
            for m in measures
        ]
        about = [row["facts"].paper, storage(row["bytes"]), number(row["seconds"])] if row["facts"] else ["", "", ""]
        cells.append({"cells": [row["title"], *about, *values], "best": best, "kind": "floor" if row["floor"] else ""})
    failures = [
        f"{f['title']}, {f['model_title']}: {f['reason']}"
        for f in list_failures(materials, {f.name: f.title for f in facts})
    ]
    failures += [f"left out: {item['name']}: {item['reason']}" for item in run.get("left_out") or []]
    figure = pareto_figure([row for row in rows if not row["floor"]])
    data = {
        "kind": "overview",
        "title": TITLE,
        "standins": f"{standins} of {len(materials)} materials are stand-ins, not measurements: the median of five "
        "published fits. Compare nothing here with a paper."
        if standins
        else "",
        "findings": findings(materials, rows),
        "about": f"{len(materials)} materials, {len(models)} models, "
        f"{len(scenes)} scene{'s' * (len(scenes) != 1)}; brdfatlas "
        f"{(run.get('versions') or {}).get('brdfatlas', '')}, revision {run.get('revision', 'unknown')}.",
        "pareto": "pareto.svg" if figure else "",
        "table": {"head": ["Model", "Paper", "Storage", "Fit (s)", *(m.label for m in measures)], "rows": cells},
        "remarks": _footnotes(facts),
        "failures": failures,
        "contents": [],
    }
    return data, {"pareto.svg": figure} if figure else {}


def spread(heights: Sequence[float], gap: float) -> list[float]:
    """Descending ``heights`` moved apart to at least ``gap``, about their own middle, in the same order."""
    placed: list[float] = []
    for height in heights:
        placed.append(min(height, placed[-1] - gap) if placed else height)
    shift = sum(h - p for h, p in zip(heights, placed, strict=True)) / max(len(placed), 1)
    return [p + shift for p in placed]


def pareto_figure(rows: Sequence[Mapping[str, Any]]) -> bytes:
    """Mean PSNR against bytes and against seconds of one fit, as SVG; empty if there is nothing to draw. The line is
    over the models that have every picture."""
    import matplotlib

    matplotlib.use("svg")
    from matplotlib.figure import Figure

    finite = [row for row in rows if math.isfinite(row["scores"]["psnr_db"].mean)]
    if not finite:
        return b""
    with matplotlib.rc_context(
        {"svg.hashsalt": "brdfatlas", "font.size": 7, "axes.spines.top": False, "axes.spines.right": False}
    ):
        figure = Figure(figsize=(7.2, 2.9), layout="constrained")
        for axes, key, label in zip(
            figure.subplots(1, 2), ("bytes", "seconds"), ("bytes of one fit", "seconds of one fit"), strict=True
        ):
            points = {row["title"]: (row[key], row["scores"]["psnr_db"].mean) for row in finite if row[key]}
            if not points:
                continue
            axes.set_xscale("log")
            complete = {row["title"] for row in finite if not row["missing"]}
            front = pareto_front({name: point for name, point in points.items() if name in complete}, True)
            steps = np.reshape([points[name] for name in front], (-1, 2)).T
            axes.step(*steps, where="post", color="0.5", lw=0.8, ls=":")
            order = sorted(points, key=lambda name: points[name][1], reverse=True)
            for name in order:
                axes.plot(*points[name], "o", ms=4, color="#0072b2", mfc="#0072b2" if name in front else "white")
            low, high = axes.get_ylim()
            heights = [(points[name][1] - low) / (high - low) for name in order]
            # Names stand in a column at the right, each with a line to its point: models lie close together.
            for name, height in zip(order, spread(heights, 0.043), strict=True):
                axes.annotate(
                    name.replace("$", r"\$"), points[name], (1.04, height), textcoords="axes fraction", fontsize=5.5,
                    va="center", annotation_clip=False, weight="bold" if name in front else "normal",
                    arrowprops={"arrowstyle": "-", "lw": 0.3, "color": "0.6", "shrinkA": 1, "shrinkB": 2},
                )  # fmt: skip
            axes.set_xlabel(label)
            axes.set_ylabel("mean PSNR (dB)")
            axes.grid(color="0.92", lw=0.5)
        stream = io.BytesIO()
        figure.savefig(stream, format="svg", metadata={"Date": None, "Creator": "brdfatlas"})
        return stream.getvalue()


def _write(path: str | Path, content: bytes) -> None:
    with atomic_path(path) as temporary:
        temporary.write_bytes(content)
