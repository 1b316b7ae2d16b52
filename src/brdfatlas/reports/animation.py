"""Animations of one material: the environment turns once about the vertical, the reference beside two of its fits; and
the starts of the independent factors on the way to their ends."""

import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from brdfatlas.constants import REFERENCE
from brdfatlas.figures.convergence import convergence_frames
from brdfatlas.files import atomic_path, write_json
from brdfatlas.fits import load_fit
from brdfatlas.formats.reader import read
from brdfatlas.measured import Measured
from brdfatlas.measures.errors import to_8_bit
from brdfatlas.measures.summary import BUDGETS, LEADING
from brdfatlas.models import MODELS
from brdfatlas.rendering import use_variant
from brdfatlas.rendering.images import tone_map
from brdfatlas.rendering.jobs import render_turning
from brdfatlas.rendering.scenes import PreparedScene, prepare_scene
from brdfatlas.reports.data import Material, model_facts, read_material, summarise_run

#: Height of the line with the names below the pictures, pixels.
LABEL = 20
#: Seconds of one turn of the environment.
TURN = 4.5


def animated_models(material: Material, models: Sequence[str], chosen: str = "") -> list[str]:
    """The recommended model of any size and a second one: ``chosen``, or the recommended model of at most 64 bytes, or
    else the next by ΔE00. Fewer where fits failed."""
    summary = summarise_run([material], {name: model_facts(name) for name in models})
    complete = [name for name in summary.order(LEADING, material.name) if name in summary.complete(material.name)]
    recommended = dict(zip([budget.key for budget in BUDGETS], summary.recommend([material.name]), strict=True))
    wanted = [recommended["any"], chosen, recommended["64"], *complete]
    return list(dict.fromkeys(name for name in wanted if name in complete))[:2]


def turning_frames(
    scene: PreparedScene, measured: Measured, tables: Mapping[str, np.ndarray | None], count: int, **settings: int
) -> Iterator[np.ndarray]:
    """``count`` pictures, (size, size x tables, 3) uint8, of all tables beside each other along the same paths, the
    environment turned by 360 / count degrees more each time. ``settings``: samples, batches, seed."""
    exposure, gamma = (float(scene.definition[key]) for key in ("exposure", "gamma"))
    turns = [360 * number / count for number in range(count)]
    for renders in render_turning(scene, measured, tables, turns, **settings):
        yield np.concatenate([to_8_bit(tone_map(image, exposure, gamma)) for image in renders.values()], 1)


def write_animation(
    path: str | os.PathLike, frames: Iterable[np.ndarray], names: Sequence[str], seconds: float = TURN
) -> None:
    """Write frames (h, w, 3) uint8 as an endless WebP of so many ``seconds``, with a line of ``names`` below equal
    parts of its width."""
    pictures = []
    for frame in frames:
        height, width = frame.shape[:2]
        picture = Image.new("RGB", (width, height + LABEL * bool(names)), "white")
        picture.paste(Image.fromarray(frame))
        draw = ImageDraw.Draw(picture)
        for place, name in enumerate(names):
            centre = (width * (place + 0.5) / len(names), height + LABEL / 2)
            draw.text(centre, name, "black", ImageFont.load_default(12), anchor="mm")
        pictures.append(picture)
    with atomic_path(path) as temporary:
        options = {"save_all": True, "append_images": pictures[1:], "loop": 0, "quality": 80, "method": 2}
        pictures[0].save(temporary, "WEBP", duration=round(1000 * seconds / len(pictures)), **options)


def animation_job(
    binary: str | os.PathLike,
    files: Mapping[str, Any],
    fits: str | os.PathLike,
    models: Sequence[str],
    scene: tuple[str, Mapping[str, Any]],
    settings: Mapping[str, Any],
    output: str | os.PathLike,
    listing: str | os.PathLike,
    *,
    source: str = "scenes",
    threads: int = 1,
) -> None:
    """Draw the animation of a material and note what it shows, {"scene": name, "models": [names]}, in ``listing``.

    ``files``: facts, fits, errors, brdf, as :func:`read_material` takes them; ``fits``: the folder of {model}.npz;
    ``scene``: its name and definition; ``settings``: frames, size, samples, batches, seed, variant and model.
    """
    material = read_material(files["facts"], files["fits"], files["errors"], files["brdf"])
    shown = animated_models(material, models, settings["model"])
    tables = {REFERENCE: None} | {name: load_fit(Path(fits) / f"{name}.npz").table() for name in shown}
    use_variant(settings["variant"], threads)
    prepared = prepare_scene(*scene, settings["size"], source=source)
    counts = {key: settings[key] for key in ("samples", "batches", "seed")}
    frames = turning_frames(prepared, read(binary), tables, settings["frames"], **counts)
    write_animation(output, frames, [REFERENCE, *(model_facts(name).title for name in shown)])
    write_json(listing, {"scene": scene[0], "models": shown})


def convergence_job(binary: str | os.PathLike, entry: str, output: str | os.PathLike, *, seconds: float = 6.0) -> None:
    """Draw how the starts of an entry of ``independent_g`` come to their ends on a material, green channel. FitError
    for one without green light."""
    runs = MODELS[entry].convergence(read(binary))
    write_animation(output, convergence_frames(runs), [], seconds)
