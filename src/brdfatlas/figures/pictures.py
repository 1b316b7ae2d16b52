"""Pictures for the report: renders, error maps, colour bars, and linear light for the page that compares.

A folder for each scene and model of a material, renders/{scene}/{model}/ (:func:`picture_file`), because names may hold
any separator but this one:

    render.webp   tone-mapped render (also of "reference")
    de00.webp     CIEDE2000, cividis, 0.1 to 30, logarithmic: fits differ by decades
    flip.webp     FLIP, magma (the colour map of FLIP's authors), 0.01 to 1, logarithmic
    diff.webp     signed difference of luminance, blue (too dark) - white - red (too bright)
    hdr.js        linear radiance, for the page that compares

Ranges are fixed for all, so that maps of different models, scenes and materials compare by eye; what lies outside the
material is transparent in maps. The difference is that of exposed luminance, ln 2 exposure (Y_fit - Y_reference), 1
being the display's white; its colour runs as sign(d) sqrt|d| from -1 to 1, so that a hundredth of white is still seen.

**hdr.js** calls ``ATLAS_HDR("material/scene/model", count, text)`` with a lossless WebP (figures.scripts): a page from
file:// may not read the pixels of a picture file. A channel of a pixel has a whole level,

    radiance = 2^(level / STEPS),    0 below the smallest float32,
    level = s of the reference;    level = level of the reference + COARSE s of a fit,

so that the reference is right within 1/192 stop (0.4 %), however bright. The s of a fit's green is rounded to the
nearest, those of red and blue are that of green and the rounded rest: green, and the ratios of red and blue to it, are
right within 1/24 stop (2.9 %), red and blue within 1/12 (5.9 %). That moves colours by half a dE00 on average at most;
rounding each channel by itself takes more bytes and moves hues further. A fit shares the paths of its reference, so its
s is small and has little noise, which is what makes the file small; half the step would add two fifths to it. An image
of h x w radiances is stored opaque and 2h high, because browsers multiply colours by alpha: s + 128 as 16 bits, the low
bytes in the upper half, the high bytes below (no colour management: `colorSpaceConversion: "none"`).
"""

import io
import os
from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from pathlib import Path

import numpy as np
from PIL import Image

from brdfatlas.constants import LUMINANCE, REFERENCE, REFERENCE_AGAIN
from brdfatlas.figures.scripts import read_script, write_script
from brdfatlas.files import atomic_path, digests, write_json, write_text
from brdfatlas.measures.errors import Tone, View, box_around, delta_e, to_8_bit
from brdfatlas.measures.flip import flip
from brdfatlas.rendering.images import Render, load_render, tone_map

#: Ends of the logarithmic scales of maps; values outside are shown as the nearer end.
DE00_RANGE, FLIP_RANGE = (0.1, 30.0), (0.01, 1.0)
#: The animation of a material, in its folder (reports.animation).
ANIMATION = "animation.webp"
CONVERGENCE = "convergence.webp"
KINDS = ("render", "de00", "flip", "diff")
#: Levels of a stop in the hdr.js of a reference, and how many of them a step of a fit takes.
STEPS, COARSE = 96, 8
#: Below the smallest float32, above the largest: what :func:`hdr_levels` clips to, in stops.
STOPS = (-200, 127)


def picture_file(folder: str | os.PathLike, scene: str, model: str, kind: str = "render") -> Path:
    """The file of one picture of a material; ``folder``: the material's, ``kind``: one of :data:`KINDS`."""
    return Path(folder) / "renders" / scene / model / f"{kind}.webp"


@cache
def colour_table(name: str) -> np.ndarray:
    """A matplotlib colour map as (256, 3) uint8."""
    import matplotlib

    return to_8_bit(matplotlib.colormaps[name](np.arange(256))[:, :3])


def apply_colours(values: np.ndarray, table: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Values in [0, 1] (clipped) through a (256, 3) table, opaque where ``mask``; (h, w, 4) uint8."""
    opaque = np.insert(table, 3, 255, axis=1).view(np.uint32)[:, 0]
    shown = np.where(mask, opaque[to_8_bit(np.where(mask, values, 0))], 0)
    return shown.astype(np.uint32)[..., None].view(np.uint8)


def log_place(values: np.ndarray, ends: tuple[float, float]) -> np.ndarray:
    """Where values lie on a logarithmic scale between its ends, in [0, 1]; 0 goes to 0."""
    low, high = ends
    return np.log(np.clip(values, low, high) / low) / np.log(high / low)


def signed_root(difference: np.ndarray) -> np.ndarray:
    """[-1, 1] to [0, 1] by sign(d) sqrt|d|, clipped; 0 goes to 1/2."""
    return 0.5 + 0.5 * np.sign(difference) * np.sqrt(np.minimum(np.abs(difference), 1.0))


def luminance_difference(reference: np.ndarray, image: np.ndarray, exposure: float) -> np.ndarray:
    """ln 2 exposure (Y_image - Y_reference) of (h, w, 3) linear radiance, not clipped; (h, w), 1 is white."""
    return np.log(2.0) * exposure * ((image.astype(np.float64) - reference) @ LUMINANCE)


def hdr_levels(radiance: np.ndarray, base: np.ndarray | None = None) -> np.ndarray:
    """The levels (h, w, 3) int that stand for linear radiance in a hdr.js; ``base``: those of the reference, for a fit.
    Values that are negative or not finite become 0."""
    value = np.nan_to_num(radiance.astype(np.float64), posinf=0.0)
    stops = np.log2(np.clip(value, 2.0 ** STOPS[0], 2.0 ** STOPS[1]))
    if base is None:
        return np.rint(STEPS * stops).astype(int)
    apart = (STEPS * stops - base) / COARSE
    green = apart[..., 1:2]
    return base + COARSE * (np.rint(green) + np.rint(apart - green)).astype(int)


def radiance_of(levels: np.ndarray) -> np.ndarray:
    """The linear radiance of levels, float32."""
    return np.exp2(levels / STEPS).astype(np.float32)


def hdr_file(folder: str | os.PathLike, scene: str, model: str) -> Path:
    """The script that carries the linear radiance of one picture."""
    return picture_file(folder, scene, model).with_name("hdr.js")


def write_hdr(
    folder: str | os.PathLike, scene: str, model: str, levels: np.ndarray, base: np.ndarray | None = None
) -> Path:
    """Write :func:`hdr_levels` (h, w, 3) of a picture of a material, whose name ``folder`` has, as its hdr.js;
    ``base``: as there."""
    steps = (levels if base is None else (levels - base) // COARSE) + 128
    stored, path = io.BytesIO(), hdr_file(folder, scene, model)
    pixels = np.concatenate([steps & 255, steps >> 8 & 255]).astype(np.uint8)
    # Method 4 takes twice as long for 1 % less, method 6 twenty times for 4 % less; quality 75 a seventh more for none.
    Image.fromarray(pixels).save(stored, "WEBP", quality=50, method=3, lossless=True)
    write_script(path, "ATLAS_HDR", [f"{Path(folder).name}/{scene}/{model}"], stored.getvalue())
    return path


def read_hdr(folder: str | os.PathLike, scene: str, model: str) -> np.ndarray:
    """The linear radiance that the page shows of a picture, (h, w, 3) float32: what its script does."""

    def steps(name: str) -> np.ndarray:
        with Image.open(io.BytesIO(read_script(hdr_file(folder, scene, name)))) as image:
            low, high = np.split(np.asarray(image.convert("RGB")).astype(np.uint16), 2)
        return (low + 256 * high - 128).astype(np.int16).astype(int)

    levels = steps(REFERENCE)
    return radiance_of(levels if model == REFERENCE else levels + COARSE * steps(model))


def write_webp(path: str | os.PathLike, pixels: np.ndarray) -> None:
    """Write (h, w, 3 or 4) uint8 as WebP; whole or not at all. Maps, which have alpha, are mostly noise: with less
    quality, at which a colour is off by 1 to 2 % of its scale on average."""
    with atomic_path(path) as temporary:
        Image.fromarray(pixels).save(temporary, "WEBP", quality=85 if pixels.shape[2] == 3 else 60, method=4)


class Scene:
    """A reference with what the pictures of all models need of it alone."""

    def __init__(self, reference: Render, tone: Tone) -> None:
        self.reference, self.mask, self.tone = reference, reference.mask, tone
        self.base = hdr_levels(reference.mean)
        self.box = box_around(self.mask)
        self.view = View(reference.mean[self.box], self.mask[self.box], tone)

    def pictures(self, image: Render, kinds: Iterable[str] = KINDS) -> dict[str, np.ndarray]:
        """The pictures of one model by their kind, uint8."""
        seen = self.view.beside(image.mean[self.box])
        makers = {
            "render": lambda: self.render(image),
            "de00": lambda: self.de00(seen),
            "flip": lambda: self.flip(seen),
            "diff": lambda: self.diff(image),
        }
        return {kind: makers[kind]() for kind in kinds}

    def render(self, image: Render) -> np.ndarray:
        return to_8_bit(tone_map(image.mean, *self.tone))

    def de00(self, seen: View) -> np.ndarray:
        delta = np.zeros(self.mask.shape, np.float32)
        delta[self.mask] = delta_e(self.view.lab, seen.lab)
        return apply_colours(log_place(delta, DE00_RANGE), colour_table("cividis"), self.mask)

    def flip(self, seen: View) -> np.ndarray:
        found = np.zeros(self.mask.shape, np.float32)
        found[self.box] = flip(self.view.seen, seen.seen)
        return apply_colours(log_place(found, FLIP_RANGE), colour_table("magma"), self.mask)

    def diff(self, image: Render) -> np.ndarray:
        signed = luminance_difference(self.reference.mean, image.mean, self.tone.exposure)
        return apply_colours(signed_root(signed), colour_table("RdBu_r"), self.mask)


def material_pictures(
    models: Sequence[str],
    tones: Mapping[str, Tone],
    renders: str | os.PathLike,
    folder: str | os.PathLike,
) -> list[str]:
    """Write all pictures of one material into ``folder``, which has its name; returns the files below it, sorted.

    ``renders`` holds {model}/{scene}.exr. A model that failed gets none, and pictures that an earlier run left for
    it are removed. The noise floor ("reference_again") gets its map of ΔE00 only.
    """
    renders, folder, written = Path(renders), Path(folder), []
    for scene, tone in tones.items():
        reference = load_render(renders / REFERENCE / f"{scene}.exr")
        pictured = Scene(reference, tone)
        for model in dict.fromkeys([REFERENCE, *models, REFERENCE_AGAIN]):
            image = reference if model == REFERENCE else load_render(renders / model / f"{scene}.exr")
            pictures = {}
            if image.meta.get("status", "ok") == "ok" and np.isfinite(image.mean).all():
                kinds = {REFERENCE: ("render",), REFERENCE_AGAIN: ("de00",)}.get(model, KINDS)
                pictures = pictured.pictures(image, kinds)
            for kind in KINDS:
                path = picture_file(folder, scene, model, kind)
                if kind in pictures:
                    write_webp(path, pictures[kind])
                    written.append(path)
                else:
                    path.unlink(missing_ok=True)
            if pictures and model != REFERENCE_AGAIN:
                base = pictured.base
                levels = (base,) if model == REFERENCE else (hdr_levels(image.mean, base), base)
                written.append(write_hdr(folder, scene, model, *levels))
            else:
                hdr_file(folder, scene, model).unlink(missing_ok=True)
    return sorted(path.relative_to(folder).as_posix() for path in written)


def pictures_job(
    models: Sequence[str],
    tones: Mapping[str, Sequence[float]],
    renders: str | os.PathLike,
    folder: str | os.PathLike,
    listing: str | os.PathLike,
) -> None:
    """Write the pictures of one material and a list of them, {"pictures": {file: SHA-256}}, which changes with any of
    them; ``tones``: scene -> (exposure, gamma)."""
    named = {scene: Tone(*tone) for scene, tone in tones.items()}
    written = material_pictures(models, named, renders, folder)
    write_json(listing, {"pictures": digests(folder, written)})


def colour_bar(table: np.ndarray, ticks: Iterable[tuple[float, str]], title: str) -> str:
    """A horizontal colour bar as SVG text: ``ticks`` are (place in [0, 1], label). Grey reads on light and dark."""
    from xml.sax.saxutils import escape

    left, width, top, height = 24, 312, 22, 14
    stops = "".join(
        f'<stop offset="{i / 255:.4f}" stop-color="#{r:02x}{g:02x}{b:02x}"/>'
        for i, (r, g, b) in enumerate(table)
        if i % 15 == 0
    )
    marks = "".join(
        f'<path d="M{left + place * width:.1f} {top + height}v4" stroke="#767676"/>'
        f'<text x="{left + place * width:.1f}" y="{top + height + 17}" text-anchor="middle">{escape(label)}</text>'
        for place, label in ticks
    )
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 360 58" width="360" height="58" role="img">'
        f"<title>{escape(title)}</title>"
        f'<defs><linearGradient id="scale">{stops}</linearGradient></defs>'
        f'<g font-family="sans-serif" font-size="12" fill="#767676">'
        f'<text x="{left}" y="15">{escape(title)}</text>'
        f'<rect x="{left}" y="{top}" width="{width}" height="{height}" fill="url(#scale)" stroke="#767676"/>'
        f"{marks}</g></svg>\n"
    )


def write_bars(folder: str | os.PathLike) -> None:
    """Write bar-de00.svg, bar-flip.svg and bar-diff.svg: the scales of the three kinds of maps."""
    folder = Path(folder)
    de00, flip = (
        [(float(log_place(np.array(value), ends)), f"{value:g}") for value in values]
        for values, ends in (
            ((0.1, 0.3, 1, 3, 10, 30), DE00_RANGE),
            ((0.01, 0.03, 0.1, 0.3, 1), FLIP_RANGE),
        )
    )
    steps = (-1, -0.5, -0.2, -0.05, 0, 0.05, 0.2, 0.5, 1)
    diff = [(float(signed_root(np.array(d))), f"{d:+g}".replace("-", "−") if d else "0") for d in steps]
    write_text(folder / "bar-de00.svg", colour_bar(colour_table("cividis"), de00, "CIE ΔE00, logarithmic"))
    write_text(folder / "bar-flip.svg", colour_bar(colour_table("magma"), flip, "FLIP, logarithmic"))
    title = "luminance, fit − reference (1 = white)"
    write_text(folder / "bar-diff.svg", colour_bar(colour_table("RdBu_r"), diff, title))
