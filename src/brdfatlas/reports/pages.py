"""What all pages share: templates, pictures as pages refer to them, style, scripts, thumbnails."""

import json
import os
import re
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any
from urllib.parse import quote

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from PIL import Image

import brdfatlas
from brdfatlas.constants import REFERENCE
from brdfatlas.figures.pictures import picture_file
from brdfatlas.files import atomic_path, write_text
from brdfatlas.reports.data import SceneFacts
from brdfatlas.reports.formats import FILTERS
from brdfatlas.reports.mathml import mathml

HERE = Path(__file__).parent
ASSETS = HERE / "assets"
TEMPLATES = HERE / "templates"
#: Parts of the report that a run may lack; pages link to those that are there.
LINKS = {"pdf": False, "viewer": False, "standings": False}


@dataclass(frozen=True)
class Picture:
    """A picture as a page refers to it."""

    href: str
    width: int
    height: int
    alt: str = ""


@cache
def environment() -> Environment:
    """Templates with escaping on for every one of them; an unknown name is an error, not an empty string."""
    templates = Environment(
        loader=FileSystemLoader(TEMPLATES),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    templates.filters.update(FILTERS)
    templates.filters["mathml"] = mathml
    templates.filters["path"] = lambda name: quote(str(name), safe="")
    return templates


def render_page(template: str, output: str | Path, *, root: str, here: str, **values: Any) -> None:
    """Fill a template and write the page whole."""
    chosen = {"root": root, "here": here, "version": brdfatlas.__version__} | LINKS | values
    write_text(output, environment().get_template(template).render(chosen))


def write_assets(folder: str | Path) -> list[Path]:
    """Copy style, scripts and icon beside the pages; returns the files written."""
    written = []
    for source in sorted(ASSETS.iterdir()):
        if source.is_file() and not source.name.startswith("."):
            target = Path(folder) / source.name
            with atomic_path(target) as temporary:
                shutil.copyfile(source, temporary)
            written.append(target)
    return written


def find_picture(page: Path, path: Path, alt: str = "") -> Picture | None:
    """The picture with its size as ``page`` refers to it; None where the run made none."""
    if not path.is_file():
        return None
    href = quote(Path(os.path.relpath(path, page.parent)).as_posix())
    width, height = picture_size(path)
    return Picture(href, width, height, alt)


def picture_size(path: str | Path) -> tuple[int, int]:
    """Width and height in pixels: pages reserve the room before a lazy picture arrives."""
    path = Path(path)
    if path.suffix == ".svg":
        return svg_size(path.read_text(encoding="utf-8", errors="replace")[:4000])
    with Image.open(path) as image:
        return image.size


def svg_size(head: str) -> tuple[int, int]:
    box = re.search(r'viewBox="\s*[-\d.e]+[ ,]+[-\d.e]+[ ,]+([\d.e]+)[ ,]+([\d.e]+)', head)
    if box:
        return max(1, round(float(box[1]))), max(1, round(float(box[2])))
    return 640, 400


def as_script(name: str, content: Any) -> str:
    """``window.NAME = content`` for a script file. JSON with Infinity is JavaScript; < is written so that no name can
    end a script element, wherever the text may be put."""
    text = json.dumps(content, separators=(",", ":"), ensure_ascii=True).replace("<", "\\u003c")
    return f"window.{name}={text};\n"


def write_thumbnail(
    pictures: str | Path, scenes: Sequence[SceneFacts], models: Sequence[str], size: int = 112
) -> Path | None:
    """A small picture of the reference for the index, from its first scene; None if there is no picture at all."""
    for model in (REFERENCE, *models):
        for scene in scenes:
            source = picture_file(pictures, scene.name, model)
            if source.is_file():
                target = Path(pictures) / "thumb.webp"
                with Image.open(source) as image, atomic_path(target) as temporary:
                    small = image.convert("RGB")
                    small.thumbnail((size, size), Image.Resampling.LANCZOS)
                    small.save(temporary, "WEBP", quality=82, method=6)
                return target
    return None


def write_compare(output: str | Path, **links: bool) -> None:
    """Write the compare page; it reads ``data/atlas.js`` and, when a picture is chosen, its HDR script."""
    render_page("compare.html.j2", output, root="", here="compare", **links)
