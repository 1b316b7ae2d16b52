"""Environments: lat-long images of radiance, made here, from Mitsuba's sky model, or read from light probes.

Mitsuba's convention: the texel (row j, column i) of an image (h, w, 3) looks along (sin p sin t, cos t, -cos p sin t)
with t = pi j / (h - 1) and p = 2 pi (i + 1/2) / w; y is up, between texels radiance is bilinear.
"""

import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from brdfatlas.files import digits
from brdfatlas.rendering.images import MOST_PIXELS, load_exr

HDR_SUFFIXES = (".hdr", ".rgbe", ".pfm", ".exr")
#: Least and most of the largest radiance: its square, times that of a highlight, is within float32.
DARKEST, BRIGHTEST = 1e-12, 1e12


class ProbeError(ValueError):
    """An environment that cannot be used; the message is one line that names file and key."""


def texel_directions(width: int, height: int, supersampling: int = 1) -> np.ndarray:
    """Unit vectors (height, width, s * s, 3) of ``supersampling``^2 points in each texel's cell."""
    offset = (np.arange(supersampling) + 0.5) / supersampling - 0.5
    phi = (np.arange(width)[:, None] + 0.5 + offset) / width * 2 * np.pi
    theta = np.clip((np.arange(height)[:, None] + offset) / (height - 1), 0, 1) * np.pi
    theta, phi = theta[:, None, :, None], phi[None, :, None, :]
    parts = np.broadcast_arrays(np.sin(phi) * np.sin(theta), np.cos(theta), -np.cos(phi) * np.sin(theta))
    return np.stack(parts, -1).reshape(height, width, supersampling**2, 3)


def _render(function: Callable[[np.ndarray], np.ndarray], width: int, supersampling: int = 0) -> np.ndarray:
    """The image of ``function``, whose texels are means of ``supersampling``^2 points: 4 if not stated, fewer in wide
    images, whose texels are small and would take minutes."""
    height = width // 2
    supersampling = supersampling or min(4, -(-4096 // width))
    image = np.empty((height, width, 3))
    directions = texel_directions(width, height, supersampling)
    for row in range(0, height, 16):
        image[row : row + 16] = function(directions[row : row + 16]).mean(2)
    return image


def _smoothstep(low: float, high: float, x: np.ndarray) -> np.ndarray:
    t = np.clip((x - low) / (high - low), 0, 1)
    return t * t * (3 - 2 * t)


def studio(direction: np.ndarray) -> np.ndarray:
    """A dim room with soft panels and a few small lights, more than 10^4 times as bright as the darkest wall."""
    x, y, z = np.moveaxis(direction, -1, 0)
    azimuth, elevation = np.degrees(np.arctan2(x, z)), np.degrees(np.arcsin(np.clip(y, -1, 1)))
    room = 0.06 + 0.16 * _smoothstep(-0.3, 1.0, y) + 0.05 * _smoothstep(-0.3, -1.0, y)
    room = room * (1 - 0.35 * (_smoothstep(-8, -6, elevation) - _smoothstep(-2, 0, elevation)))
    rgb = room[..., None] * np.array([0.90, 0.96, 1.10])
    # azimuth and elevation of the centre, half widths in degrees; radiance
    panels = (
        (-80, 28, 17, 26, (1.5, 1.55, 1.7)),
        (72, 22, 11, 30, (1.9, 1.7, 1.4)),
        (170, 30, 40, 12, (0.9, 0.95, 1.05)),
        (0, -48, 50, 6, (0.35, 0.33, 0.30)),
    )
    for a, e, wide, high, radiance in panels:
        across, along = np.abs(np.mod(azimuth - a + 180, 360) - 180), np.abs(elevation - e)
        inside = (1 - _smoothstep(wide - 1.5, wide, across)) * (1 - _smoothstep(high - 1.5, high, along))
        rgb = rgb * (1 - inside[..., None]) + inside[..., None] * np.array(radiance)
    # azimuth (0 = +z, towards the built-in cameras; 90 = +x), elevation, radius in degrees; radiance
    lights = (
        (-38, 42, 2.6, (900, 830, 740)),
        (52, 30, 2.0, (420, 470, 560)),
        (8, 74, 3.2, (160, 160, 160)),
        (118, 12, 2.4, (300, 220, 130)),
        (-112, 20, 2.2, (140, 200, 320)),
        (20, -34, 1.8, (70, 60, 52)),
    )
    for azimuth, elevation, radius, radiance in lights:
        a, e = np.radians(azimuth), np.radians(elevation)
        centre = np.array([np.sin(a) * np.cos(e), np.sin(e), np.cos(a) * np.cos(e)])
        distance = np.degrees(2 * np.arcsin(np.clip(np.linalg.norm(direction - centre, axis=-1) / 2, 0, 1)))
        rgb = rgb + (1 - _smoothstep(0.75 * radius, radius, distance))[..., None] * np.array(radiance, float)
    return rgb


def overcast(direction: np.ndarray) -> np.ndarray:
    """The CIE overcast sky, three times as bright at the zenith as at the horizon, with soft clouds; grey ground."""
    x, y, z = np.moveaxis(direction, -1, 0)
    up = np.maximum(y, 0)
    clouds = 1 + 0.10 * np.sin(3 * x + 1.3) * np.sin(4 * z + 0.4) + 0.06 * np.sin(7 * x - 5 * z) * up
    sky = (1 + 2 * up) / 3 * clouds
    tint = np.stack([0.93 + 0.05 * (1 - up), 0.97 + 0.01 * (1 - up), 1.05 - 0.05 * (1 - up)], -1)
    ground = 0.16 * np.array([1.0, 0.95, 0.88])
    share = _smoothstep(-0.03, 0.0, y)[..., None]
    return sky[..., None] * tint * share + ground * (1 - share)


def hall(direction: np.ndarray) -> np.ndarray:
    """A stone hall: two rows of tall windows on each long wall, a rose window at each end, skylights."""
    low, high = np.array([-5.0, -2.2, -11.0]), np.array([5.0, 6.5, 11.0])
    direction = np.where(np.abs(direction) < 1e-9, 1e-9, direction)
    reach = np.where(direction > 0, high / direction, low / direction)
    axis = reach.argmin(-1)
    p = direction * reach.min(-1)[..., None]
    x, y, z = np.moveaxis(p, -1, 0)
    stone = 0.16 * (0.75 + 0.25 * _smoothstep(-2.2, 6.5, y)) * (1 + 0.12 * np.sin(2.3 * y) * np.sin(1.1 * (x + z)))
    rgb = stone[..., None] * np.array([1.0, 0.86, 0.70])

    def pane(across: np.ndarray, low_edge: float, high_edge: float, period: float, half: float) -> np.ndarray:
        """1 inside a row of windows with round tops, spaced by ``period``."""
        u = np.abs(np.mod(across, period) - period / 2)
        top = high_edge - half
        body = (u < half) & (y > low_edge) & (y < top)
        arch = (np.hypot(u, y - top) < half) & (y >= top)
        bars = (np.abs(np.mod(y, 0.6) - 0.3) < 0.035) | (u < 0.04)
        return (body | arch) & ~bars

    sky = np.array([26.0, 31.0, 40.0])
    sun = np.array([95.0, 82.0, 62.0])
    long_wall, end_wall, ceiling, ground = axis == 0, axis == 2, (axis == 1) & (y > 0), (axis == 1) & (y < 0)
    lower, upper = pane(z, -0.4, 2.6, 2.2, 0.5), pane(z, 3.6, 5.6, 2.2, 0.42)
    light = np.where((x > 0)[..., None], sun, sky)
    rgb = np.where((long_wall & (lower | upper))[..., None], light, rgb)
    rose, spokes = np.hypot(x, y - 3.2), np.abs(np.sin(6 * np.arctan2(y - 3.2, x)))
    glass = np.stack([30 + 22 * np.sin(3 * rose), 22 + 8 * np.cos(4 * rose), 34 - 14 * np.sin(3 * rose)], -1)
    rgb = np.where((end_wall & (rose < 2.1) & (rose > 0.35) & (spokes > 0.16))[..., None], glass, rgb)
    skylight = (np.abs(np.mod(z, 3.6) - 1.8) < 0.55) & (np.abs(x) < 1.1)
    rgb = np.where((ceiling & skylight)[..., None], 1.4 * sky, rgb)
    tiles = 0.75 + 0.25 * (np.mod(np.floor(x / 1.2) + np.floor(z / 1.2), 2) > 0)
    return np.where(ground[..., None], (0.10 * tiles)[..., None] * np.array([1.0, 0.9, 0.78]), rgb)


def sunsky(width: int, turbidity: float, sun_elevation: float) -> np.ndarray:
    """Mitsuba's ``sunsky`` as a lat-long image, the sun at azimuth 0 (+z) before any turn.

    The sun keeps its irradiance; its disc of half a degree is spread over the texels that it touches. Below the horizon
    there is a dim ground.
    """
    import drjit as dr
    import mitsuba as mi

    e = np.radians(sun_elevation)
    # The emitter has z up; (x, y, z) here is (x, -z, y) there.
    sun = [0.0, -float(np.cos(e)), float(np.sin(e))]
    shared = {"type": "sunsky", "turbidity": float(turbidity), "albedo": 0.25, "sun_direction": sun}
    emitter = mi.load_dict(shared)
    jit = dr.is_jit_v(mi.Float)

    def radiance(direction: np.ndarray) -> np.ndarray:
        flat = direction.reshape(-1, 3)
        local = np.stack([flat[:, 0], -flat[:, 2], flat[:, 1]], -1).astype(np.float32)
        if jit:
            si = dr.zeros(mi.SurfaceInteraction3f, len(local))
            si.wi = -mi.Vector3f(np.ascontiguousarray(local.T))
            values = np.array(emitter.eval(si)).T
        else:
            values = np.empty((len(local), 3))
            si = dr.zeros(mi.SurfaceInteraction3f)
            for row, d in enumerate(local):
                si.wi = mi.Vector3f(*(-d).tolist())
                values[row] = emitter.eval(si)
        ground = np.broadcast_to(np.array([0.022, 0.020, 0.017]), values.shape)
        below = (flat[:, 1] < 0)[:, None]
        return np.where(below, ground, np.nan_to_num(values)).reshape(direction.shape)

    # Points 0.09 degrees apart: the sun's disc holds about 30 of them.
    return _render(radiance, width, -(-4096 // width) if jit else 1)


def read_probe(path: str, mapping: str, width: int, key: str) -> np.ndarray:
    """Read a light probe: a lat-long image as it is, an angular map resampled to ``width``.

    Raises ProbeError with one line that names ``key`` and the file: missing, not an HDR format, truncated, not
    finite, negative, black, or of another aspect than its mapping.
    """
    file = Path(path)
    if not path:
        raise ProbeError(f"{key}: kind file needs the path of a light probe (.hdr, .pfm or .exr)")
    if not file.is_file():
        fault = "not a regular file" if file.exists() else "no such file"
        raise ProbeError(f"{key}: {path}: {fault}; correct the path or leave the scene out")
    if file.suffix.lower() not in HDR_SUFFIXES:
        raise ProbeError(f"{key}: {path}: not a high-dynamic-range format ({', '.join(HDR_SUFFIXES)})")
    try:
        image = {".exr": load_exr, ".pfm": read_pfm}.get(file.suffix.lower(), read_rgbe)(file)
    except (ValueError, OSError) as error:
        reason = " ".join(str(error).replace(f"{path}: ", "").split())
        raise ProbeError(f"{key}: {path}: cannot be read, truncated or damaged ({reason})") from None
    height = image.shape[0]
    if not np.isfinite(image).all():
        raise ProbeError(f"{key}: {path}: holds NaN or Inf")
    if image.size and image.min() < 0:
        raise ProbeError(f"{key}: {path}: holds negative radiance")
    if image.size and image.max() <= 0:
        raise ProbeError(f"{key}: {path}: is black")
    expected = 2 if mapping == "latlong" else 1
    if min(image.shape[:2]) < 4 or abs(image.shape[1] / height / expected - 1) > 0.03:
        raise ProbeError(
            f"{key}: {path}: {image.shape[1]} x {height} is not a {mapping} image, which is {expected} times "
            "as wide as high; is mapping right?"
        )
    return image if mapping == "latlong" else from_angular_map(image, width)


def _size(width: int, height: int) -> tuple[int, int]:
    """A stated size if a picture can have it. ValueError if not."""
    if width < 1 or height < 1 or width * height > MOST_PIXELS:
        raise ValueError(f"{width} x {height} pixels; a probe has 1 to {MOST_PIXELS:,}")
    return width, height


def read_pfm(file: Path) -> np.ndarray:
    """A PFM as (h, w, 3) float32: "PF" or "Pf", width, height, scale (negative: little-endian), rows from the bottom.

    ValueError for what is none.
    """
    data = file.read_bytes()
    parts = data[:256].split(maxsplit=4)
    if len(parts) < 4 or parts[0] not in (b"PF", b"Pf"):
        raise ValueError("no PFM header")
    width, height = _size(int(digits(parts[1])), int(digits(parts[2])))
    scale, channels = float(digits(parts[3])), 3 if parts[0] == b"PF" else 1
    if not np.isfinite(scale) or scale == 0:
        raise ValueError(f"scale {scale:g}, not a finite number")
    # one white space ends the header
    start = data.index(parts[3], data.index(parts[2], data.index(parts[1]) + len(parts[1])) + len(parts[2]))
    start += len(parts[3]) + 1
    count = width * height * channels
    if len(data) - start < 4 * count:
        raise ValueError(f"truncated, {len(data):,} of {start + 4 * count:,} bytes")
    values = np.frombuffer(data, "<f4" if scale < 0 else ">f4", count, start).reshape(height, width, channels)
    with np.errstate(over="ignore"):  # infinity is told of by the caller
        return np.repeat(values[::-1].astype(np.float32) * np.float32(abs(scale)), 3 // channels, -1)


def read_rgbe(file: Path) -> np.ndarray:
    """A Radiance picture as (h, w, 3) float32, by Mitsuba, after a look at its header. ValueError for what is none."""
    import mitsuba as mi

    with open(file, "rb") as handle:
        head = handle.read(65536)
    found = re.search(rb"\n\n-Y (\d{1,9}) \+X (\d{1,9})\n", head)
    if not head.startswith((b"#?RADIANCE", b"#?RGBE")) or not found:
        raise ValueError("no Radiance header with rows from the top (-Y h +X w)")
    _size(int(found[2]), int(found[1]))
    try:
        bitmap = mi.Bitmap(str(file)).convert(mi.Bitmap.PixelFormat.RGB, mi.Struct.Type.Float32, False)
    except Exception as error:
        raise ValueError((str(error).strip() or type(error).__name__).splitlines()[-1]) from None
    return np.array(bitmap, np.float32)


def from_angular_map(image: np.ndarray, width: int) -> np.ndarray:
    """A lat-long image from Debevec's angular map: the centre looks forward (+z here), the rim backward, the distance
    from the centre is the angle. Seen from inside with y up, right is -x."""
    from scipy.ndimage import map_coordinates

    size = np.array(image.shape[:2])

    def radiance(direction: np.ndarray) -> np.ndarray:
        x, y, z = np.moveaxis(direction, -1, 0)
        angle = np.arccos(np.clip(z, -1, 1)) / np.pi
        radius = angle / np.maximum(np.hypot(x, y), 1e-12)
        row, column = (1 - y * radius) / 2 * size[0] - 0.5, (1 - x * radius) / 2 * size[1] - 0.5
        at = np.stack([row, column])
        return np.stack([map_coordinates(image[..., c], at, order=1, mode="nearest") for c in range(3)], -1)

    return _render(radiance, width)


def turned(image: np.ndarray, degrees: float) -> np.ndarray:
    """The image turned about the vertical, anticlockwise from above, by a shift of columns (linear between them)."""
    shift = -degrees / 360 * image.shape[1]
    whole = int(np.floor(shift))
    part = shift - whole
    return (1 - part) * np.roll(image, whole, 1) + part * np.roll(image, whole + 1, 1)


def environment_image(environment: Mapping[str, Any], key: str) -> np.ndarray:
    """Radiance (h, w, 3) float32 of a scene's ``environment``; ``key`` names it in messages."""
    kind, width = environment["kind"], environment["width"]
    if kind == "file":
        image = read_probe(environment["file"], environment["mapping"], width, f"{key}.file")
    elif kind == "sunsky":
        image = sunsky(width, environment["turbidity"], environment["sun_elevation"])
    else:
        image = _render({"studio": studio, "overcast": overcast, "hall": hall}[kind], width)
    with np.errstate(over="ignore"):
        scaled = np.ascontiguousarray(turned(image, environment["turn"]) * environment["scale"], np.float32)
    largest = float(scaled.max())
    if not DARKEST <= largest <= BRIGHTEST:
        told = f"with scale {environment['scale']:g} the largest radiance is {largest:g}"
        raise ProbeError(f"{key}.scale: {told}; {DARKEST:g} to {BRIGHTEST:g} can be rendered")
    return scaled
