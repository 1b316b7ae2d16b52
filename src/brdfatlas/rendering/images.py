"""Rendered images with their independent batches, in ordinary multi-channel EXR files. No Mitsuba needed."""

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from brdfatlas.files import atomic_path

_PREFIX = "brdfatlas:"
EXR = b"v/1\x01"
#: A picture of 16,384 x 8,192; a header that states more lies.
MOST_PIXELS = 2**27


class ImageError(ValueError):
    """A file that cannot be used as an image; the message is one line that names the file and the fault."""


@dataclass(frozen=True, eq=False)
class Render:
    """A picture of a material under a scene.

    ``mean``: (h, w, 3) float32, linear radiance. ``batches``: (n, h, w, 3) float32, means of n independent batches of
    samples; their average is ``mean``. ``mask``: (h, w) bool, pixels that the material covers wholly and directly.
    ``meta``: how it was made; ``meta["status"]`` is "ok", or "failed" for a fit that does not exist.
    """

    mean: np.ndarray
    batches: np.ndarray
    mask: np.ndarray
    meta: Mapping[str, str] = field(default_factory=dict)


def _deviations(render: Render) -> np.ndarray:
    """Batches minus mean, rounded to 12 bits of significand (error <= 2^-12 of the noise): these compress well, and
    vanish where there is no noise."""
    bits = (render.batches - render.mean).astype(np.float32).view(np.uint32)
    return ((bits + np.uint32(0x800)) & np.uint32(0xFFFFF000)).view(np.float32)


def save_render(path: str | os.PathLike, render: Render) -> None:
    """Write an EXR, whole or not at all: channels R, G, B, mask and ``batchNN.R/G/B`` (a batch's deviation from the
    mean, to 12 bits), and every entry of ``meta`` as a string attribute ``brdfatlas:KEY``."""
    import OpenEXR

    channels = {name: np.ascontiguousarray(render.mean[..., c], np.float32) for c, name in enumerate("RGB")}
    channels["mask"] = render.mask.astype(np.float32)
    for number, batch in enumerate(_deviations(render)):
        channels |= {f"batch{number:02d}.{name}": np.ascontiguousarray(batch[..., c]) for c, name in enumerate("RGB")}
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    header |= {_PREFIX + key: str(value) for key, value in render.meta.items()}
    with atomic_path(path) as temporary:
        OpenEXR.File(header, channels).write(str(temporary))


def save_picture(path: str | os.PathLike, render: Render) -> None:
    """Write a render as ``path`` says: .png, by its own tone map, or else EXR (:func:`save_render`)."""
    if Path(path).suffix.lower() != ".png":
        return save_render(path, render)
    from PIL import Image, PngImagePlugin

    notes = PngImagePlugin.PngInfo()
    notes.add_text("Software", "brdfatlas")
    for key, value in render.meta.items():
        notes.add_itxt(_PREFIX + key, str(value))
    exposure, gamma = float(render.meta["exposure"]), float(render.meta["gamma"])
    pixels = np.rint(tone_map(render.mean, exposure, gamma) * 255).astype(np.uint8)
    with atomic_path(path) as temporary:
        Image.fromarray(pixels).save(temporary, "PNG", pnginfo=notes)


def _open(path: str | os.PathLike) -> tuple[dict, dict[str, np.ndarray]]:
    import OpenEXR

    path = Path(path)
    if not path.is_file():
        raise ImageError(f"{path}: {'not a regular file' if path.exists() else 'no such image'}")
    try:
        with path.open("rb") as file:
            if file.read(4) != EXR:  # OpenEXR says that it cannot open the file
                raise ValueError("another kind of file; `brdfatlas render -o NAME.exr` writes one")
        with OpenEXR.File(str(path), header_only=True) as file:
            if len(file.parts) > 1:
                raise ValueError(f"{len(file.parts)} pictures in one file; save the one that counts alone")
            (left, top), (right, bottom) = file.header()["dataWindow"]
        if (int(right) - int(left) + 1) * (int(bottom) - int(top) + 1) > MOST_PIXELS:
            raise ValueError(f"more than {MOST_PIXELS:,} pixels")
        with OpenEXR.File(str(path), separate_channels=True) as file:
            channels = {name: np.array(channel.pixels) for name, channel in file.channels().items()}
            return dict(file.header()), channels
    except Exception as error:
        raise ImageError(
            f"{path}: not a readable EXR ({str(error).splitlines()[0] if str(error) else 'damaged'})"
        ) from None


def _rgb(channels: Mapping[str, np.ndarray], prefix: str = "") -> np.ndarray:
    return np.stack([channels[prefix + name] for name in "RGB"], -1).astype(np.float32)


def load_render(path: str | os.PathLike) -> Render:
    """Read what :func:`save_render` wrote. ImageError names a file that is missing, damaged or of another kind."""
    header, channels = _open(path)
    try:
        names = sorted({name.split(".")[0] for name in channels if name.startswith("batch")})
        mean, mask = _rgb(channels), channels["mask"] > 0.5
        batches = np.stack([mean + _rgb(channels, f"{name}.") for name in names])
    except (KeyError, ValueError):
        raise ImageError(f"{path}: an EXR, but not a render of brdfatlas (mask or batches are missing)") from None
    meta = {key.removeprefix(_PREFIX): value for key, value in header.items() if key.startswith(_PREFIX)}
    return Render(mean, batches, mask, meta)


def read_meta(path: str | os.PathLike) -> dict[str, str]:
    """The ``meta`` of a render without decoding its pixels; empty if the file is missing or is no EXR."""
    import OpenEXR

    if not Path(path).is_file():
        return {}
    try:
        with OpenEXR.File(str(path), header_only=True) as file:
            header = dict(file.header())
    except Exception:
        return {}
    return {key.removeprefix(_PREFIX): value for key, value in header.items() if key.startswith(_PREFIX)}


def load_exr(path: str | os.PathLike) -> np.ndarray:
    """R, G, B of any EXR as (h, w, 3) float32; a file with a single luminance channel becomes grey."""
    _, channels = _open(path)
    if all(name in channels for name in "RGB"):
        return _rgb(channels)
    if {"RY", "BY"} & channels.keys():  # its luminance alone would be a grey picture
        raise ImageError(f"{path}: colour as luminance and chroma (Y, RY, BY); save it as R, G, B")
    if "Y" in channels:
        return np.repeat(channels["Y"][..., None], 3, -1).astype(np.float32)
    raise ImageError(f"{path}: no channels R, G, B (found: {', '.join(sorted(channels))})")


def tone_map(linear: np.ndarray, exposure: float, gamma: float) -> np.ndarray:
    """Display values in [0, 1] of linear radiance: pow(1 - exp2(-exposure x), 1 / gamma), Bagher et al. 2016."""
    return np.clip(1 - np.exp2(-exposure * np.maximum(linear, 0)), 0, 1) ** (1 / gamma)
