"""The picture of README.md, docs/images/grid.webp: `python scripts/draw_grid.py`, some minutes.

For each of four built-in stand-ins, from above: the material, the recommended fit (lowest dE00), and the closest
material of an engine (Mitsuba, MaterialX or glTF hold it exactly), of the models of at most 40 bytes. All under one
light.
"""

import sys
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

import brdfatlas
from brdfatlas.constants import REFERENCE
from brdfatlas.pipeline.standins import make_standin
from brdfatlas.rendering.images import tone_map

MATERIALS = ("nickel", "gold-metallic-paint", "red-specular-plastic", "pink-felt")
BUDGET = 40  # bytes
SIZE, TEXT, LEFT = 160, 22, 104


def columns(size: int, samples: int):
    """(material, [(words, pixels)]) of each material."""
    small = [name for name in brdfatlas.MODELS if brdfatlas.MODELS[name].bytes <= BUDGET]
    for material in MATERIALS:
        found = brdfatlas.recommend(make_standin(material), models=small, size=size, samples=samples, progress=print)
        engines = [row for row in found.rows if brdfatlas.MODELS[row.model].targets and row.model in found.renders]
        engine = min(engines, key=lambda row: row.de00)
        rows = [(REFERENCE, "stand-in")]
        rows += [(row.model, f"{row.model}  {row.de00:.2f}") for row in (found.winner, engine)]
        pixels = [np.rint(255 * tone_map(found.renders[name].mean, *found.tone)).astype(np.uint8) for name, _ in rows]
        yield material, [(words, picture) for (_, words), picture in zip(rows, pixels)]


def main(path: Path) -> None:
    canvas = Image.new("RGB", (LEFT + SIZE * len(MATERIALS), TEXT + 3 * (SIZE + TEXT)), "white")
    draw, font = ImageDraw.Draw(canvas), ImageFont.load_default(13)
    for number, words in enumerate(
        ("material", f"recommended\n<= {BUDGET} bytes\n(model, dE00)", "for engines\n(model, dE00)")
    ):
        draw.text((6, TEXT + number * (SIZE + TEXT) + 6), words, fill="black", font=font)
    for number, (material, rows) in enumerate(columns(SIZE, 64)):
        x = LEFT + number * SIZE
        draw.text((x + 4, 3), material, fill="black", font=font)
        for row, (words, pixels) in enumerate(rows):
            y = TEXT + row * (SIZE + TEXT)
            canvas.paste(Image.fromarray(pixels), (x, y))
            draw.text((x + 4, y + SIZE + 3), words, fill="black", font=font)
    path.parent.mkdir(parents=True, exist_ok=True)
    canvas.save(path, quality=88, method=6)


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "docs/images/grid.webp"))
