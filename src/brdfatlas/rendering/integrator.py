"""Direct illumination of a measured material and of all its fits along the same paths, one lane a pixel and batch (more
where the noise is), the sample loop inside the kernel.

The estimator is that of Mitsuba's ``direct``: one sample of the environment and one of the BSDF at each hit, weighted
by the power heuristic (Veach and Guibas 1995). Only pixels that show the material are computed; the rest of the picture
comes from the prepared scene. Sample points are a Sobol' sequence, scrambled per pixel, batch and dimension
(Owen 1995; hash of Laine and Karras 2011), so batches are independent, and equal for a reference and all its fits.
So are the lanes: how many a pixel has comes from the noise of a small render of the reference. A group of tables is
rendered in one pass: rays, shadow rays, samples and densities do not depend on the table, only the value does. It is
read at random neighbours (:meth:`Reflectance.values`), as memory is what limits a render.

Nothing of a scene or a material is a constant of the kernel: for each size of a group there is one kernel for lone
spheres and one for scenes with several shapes, and Dr.Jit finds them again on disk in later processes.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from brdfatlas.constants import LUMINANCE
from brdfatlas.rendering.arrays import upload
from brdfatlas.rendering.bsdf import Reflectance
from brdfatlas.rendering.scenes import DIMENSIONS, PreparedScene, material_shapes, mitsuba_scene, sobol_points

#: Lanes a pixel on average and at most, and the small render that shares them out.
MORE_LANES, MOST_LANES = 1.5, 32
PILOT_BATCHES = 8
LIST_BITS = 19
#: Most colours that are held at once, for each lane one a table and LANE for its place and random numbers; where one
#: batch has not more.
MOST_COLOURS, LANE = 2**25, 4


class Environment:
    """A lat-long environment to look up and to sample.

    Radiance is bilinear between texels, as in Mitsuba's ``envmap``. The density is constant in each cell between four
    texels, its probability a multiple of 2^-19: inverting the distribution is one look-up in a list of cells. Cells
    too dark for a place in the list are left to BSDF sampling, which covers every direction.
    """

    def __init__(self, image: np.ndarray):
        import mitsuba as mi

        height, width = image.shape[:2]
        cosine = np.cos(np.arange(height) / (height - 1) * np.pi)
        solid_angle = (2 * np.pi / width) * (cosine[:-1] - cosine[1:])
        luminance = image.astype(float) @ LUMINANCE
        rows = luminance[:-1] + luminance[1:]
        energy = (rows + np.roll(rows, -1, 1)) / 4 * solid_angle[:, None]
        length = 1 << LIST_BITS
        share = (energy / energy.sum() * length).ravel()
        counts = np.floor(share).astype(np.int64)
        rest = length - counts.sum()
        counts[np.argsort(counts - share, kind="stable")[:rest]] += 1
        pdf = np.zeros((height, width))
        pdf[:-1] = counts.reshape(height - 1, width) / length / solid_angle[:, None]
        # Rows alternate in direction, so that neighbours in the list are neighbours in the image.
        order = np.arange(counts.size).reshape(height - 1, width)
        order[1::2] = order[1::2, ::-1].copy()
        order = order.ravel()
        entries = np.repeat(order, counts[order])
        first = np.zeros(counts.size)
        first[order] = np.cumsum(counts[order]) - counts[order]
        packed = np.concatenate([image, pdf[..., None]], -1)
        self.texels = upload(mi.Float, packed)
        self.entries = upload(mi.UInt32, entries)
        places = np.stack([first, np.maximum(counts, 1)], -1)
        self.places = upload(mi.UInt32, places)
        self.cosines = upload(mi.Float, cosine)
        self.width, self.height = mi.UInt32(width), mi.UInt32(height)
        import drjit as dr

        dr.make_opaque(self.width, self.height)

    def _fetch(self, column: Any, row: Any, u: Any, v: Any, active: Any) -> tuple[Any, Any]:
        import drjit as dr
        import mitsuba as mi

        base = row * self.width
        right = dr.select(column + 1 == self.width, mi.UInt32(0), column + 1)
        a = dr.gather(mi.Vector4f, self.texels, base + column, active)
        b = dr.gather(mi.Vector4f, self.texels, base + right, active)
        c = dr.gather(mi.Vector4f, self.texels, base + self.width + column, active)
        d = dr.gather(mi.Vector4f, self.texels, base + self.width + right, active)
        top, bottom = dr.fma(u, b - a, a), dr.fma(u, d - c, c)
        value = dr.fma(v, bottom - top, top)
        return mi.Color3f(value.x, value.y, value.z), a.w

    def eval_pdf(self, direction: Any, active: Any) -> tuple[Any, Any]:
        """Radiance from, and density in 1/sr of, a direction in the world."""
        import drjit as dr
        import mitsuba as mi

        width, height = mi.Float(self.width), mi.Float(self.height)
        x = dr.atan2(direction.x, -direction.z) * (0.5 / np.pi) * width - 0.5
        x = dr.select(x < 0, x + width, x)
        y = dr.safe_acos(direction.y) * (1 / np.pi) * (height - 1)
        column = mi.UInt32(dr.clip(x, 0, width - 1))
        row = mi.UInt32(dr.minimum(y, height - 2))
        return self._fetch(column, row, x - mi.Float(column), y - mi.Float(row), active)

    def sample(self, first: Any, second: Any, active: Any) -> tuple[Any, Any, Any]:
        """A direction from two 32-bit fractions; its radiance and its density in 1/sr."""
        import drjit as dr
        import mitsuba as mi

        place = first >> (32 - LIST_BITS)
        cell = dr.gather(mi.UInt32, self.entries, place, active)
        run = dr.gather(mi.Vector2u, self.places, cell, active)
        # The place within the cell's run, and the bits below it, are uniform in [0, 1) again.
        rest = mi.Float(first & ((1 << (32 - LIST_BITS)) - 1)) * 2.0 ** -(32 - LIST_BITS)
        u = (mi.Float(place - run.x) + rest) / mi.Float(run.y)
        v = fraction(second)
        row = cell // self.width
        column = cell - row * self.width
        upper, lower = (
            dr.gather(mi.Float, self.cosines, row, active),
            dr.gather(mi.Float, self.cosines, row + 1, active),
        )
        cos_t = dr.fma(v, lower - upper, upper)
        sin_t = dr.sqrt(dr.maximum(dr.fma(-cos_t, cos_t, 1.0), 0.0))
        phi = (mi.Float(column) + 0.5 + u) * (2 * np.pi) / mi.Float(self.width)
        sin_p, cos_p = dr.sincos(phi)
        y = dr.clip(dr.safe_acos(cos_t) * (1 / np.pi) * (mi.Float(self.height) - 1) - mi.Float(row), 0.0, 1.0)
        radiance, pdf = self._fetch(column, row, dr.minimum(u, 1.0), y, active)
        return mi.Vector3f(sin_p * sin_t, cos_t, -cos_p * sin_t), radiance, pdf


def fraction(bits: Any) -> Any:
    """A 32-bit fraction as a float in [0, 1)."""
    import mitsuba as mi

    return mi.Float(bits >> 8) * 2.0**-24


def _scramble(reversed_bits: Any, seed: Any) -> Any:
    """Owen scrambling of a fraction whose bits are reversed, by the hash of Laine and Karras; bits in order again."""
    import drjit as dr

    x = reversed_bits + seed
    for constant in (0x6C50B47C, 0xB82F1E52, 0xC7AFE638, 0x8D22F6E6):
        x = x ^ (x * constant)
    return dr.brev(x)


@dataclass
class Setup:
    """A prepared scene in the form the kernel computes with; made once, used for all tables."""

    scene: PreparedScene
    environment: Environment
    pixels: np.ndarray
    camera: list[Any]
    sphere: list[Any] | None
    loaded: Any
    shapes: list[Any]


def set_up(scene: PreparedScene) -> Setup:
    """Upload a prepared scene. Pixels near the material are included, for a corner no coverage ray found."""
    import drjit as dr
    import mitsuba as mi
    from scipy.ndimage import binary_dilation

    near = binary_dilation(scene.coverage > 0, np.ones((3, 3)))
    rows, columns = np.nonzero(near)
    spread = np.zeros(len(rows), np.int64)
    for bit in range(12):  # Morton order: neighbouring lanes look up neighbouring cells
        spread |= (((columns >> bit) & 1) << (2 * bit)) | (((rows >> bit) & 1) << (2 * bit + 1))
    order = np.argsort(spread, kind="stable")
    pixels = (rows * scene.size + columns)[order]

    black = mi.load_dict({"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.0}})
    loaded = mi.load_dict(mitsuba_scene(scene, black))
    rays = [
        loaded.sensors()[0].sample_ray(0.0, 0.5, mi.Point2f(*at), mi.Point2f(0.5))[0] for at in ((0, 0), (1, 0), (0, 1))
    ]
    origin = np.array(rays[0].o).ravel()
    camera = scene.definition["camera"]
    forward = np.subtract(camera["target"], camera["origin"])
    forward = forward / np.linalg.norm(forward)
    corners = [(d := np.array(ray.d, float).ravel()) / (d @ forward) for ray in rays]
    vectors = [np.asarray(camera["origin"], float), corners[0], corners[1] - corners[0], corners[2] - corners[0]]
    # Mitsuba's position is float32, so it is as coarse as the scene lies far from the origin of its coordinates.
    assert np.allclose(np.cross(origin - vectors[0], corners[0]), 0, atol=1e-4 * max(1.0, np.abs(origin).max()))
    view = [mi.Vector3f(*map(float, v)) for v in vectors]
    sphere = None
    if scene.lone_sphere:
        shape = scene.definition["geometry"][0]
        sphere = [mi.Vector3f(*map(float, shape["position"])), mi.Float(float(shape["size"]))]
    dr.make_opaque(view, sphere)
    shapes = [mi.ShapePtr(shape) for shape in material_shapes(loaded, scene.definition)]
    dr.make_opaque(shapes)
    return Setup(scene, Environment(scene.environment), pixels, view, sphere, loaded, shapes)


def share_lanes(setup: Setup, reference: Reflectance, samples: int, seed: int) -> np.ndarray:
    """How many lanes each of ``setup.pixels`` gets, from a small render of the reference.

    A highlight smaller than a pixel has more noise than all the rest, and sets the peak of the PSNR. There are
    MORE_LANES lanes a pixel on average, 1 to about MOST_LANES, in proportion to the noise found there or beside it: the
    least variance for so many samples (Neyman 1934). ``seed`` must not be that of a picture, which must not depend on
    what the small render found.
    """
    from scipy.ndimage import maximum_filter

    pilot = max(PILOT_BATCHES * 2, samples // 8)
    parts = render_batches(setup, reference, pilot, PILOT_BATCHES, seed)[0]
    spread = parts.max(-1).std(0, ddof=1)
    noise = np.maximum(maximum_filter(spread, 3).ravel()[setup.pixels].astype(float), 1e-30)
    # Always as many in all: Dr.Jit compiles its kernel anew for another number of lanes.
    total = int(MORE_LANES * noise.size)
    low, high = 0.0, MOST_LANES / noise.min()
    for _ in range(200):
        factor = 0.5 * (low + high)
        low, high = (factor, high) if np.clip(noise * factor, 1, MOST_LANES).sum() <= total else (low, factor)
    wanted = np.clip(noise * low, 1, MOST_LANES)
    lanes = wanted.astype(np.int64)
    lanes[np.argsort(lanes - wanted, kind="stable")[: total - lanes.sum()]] += 1
    return lanes


def render_batches(
    setup: Setup, reflectance: Reflectance, samples: int, batches: int, seed: int, lanes: np.ndarray | None = None
) -> np.ndarray:
    """Independent batch means of the material's part of the picture for every table of ``reflectance``, (tables,
    batches, size, size, 3) float32.

    ``samples``: a lane, all batches together, rounded up to a multiple of ``batches``. ``seed``: 32 bits. ``lanes``:
    how many lanes each of ``setup.pixels`` has, by default 1; the same for a reference and its fits
    (:func:`share_lanes`).
    """
    import drjit as dr
    import mitsuba as mi

    each = -(-samples // batches)
    size = setup.scene.size
    lanes = np.ones(len(setup.pixels), np.int64) if lanes is None else lanes
    n, first = int(lanes.sum()), np.cumsum(lanes) - lanes
    points = upload(mi.UInt32, _reversed(sobol_points(each, setup.scene.points)))
    result = np.zeros((reflectance.count, batches, size * size, 3), np.float32)
    together = max(1, MOST_COLOURS // (n * (reflectance.size + LANE)))
    for start in range(0, batches, together):
        part = np.arange(start, min(start + together, batches))
        pixel = upload(mi.UInt32, np.tile(np.repeat(setup.pixels, lanes), len(part)))
        number = upload(mi.UInt32, np.tile(np.arange(n) - np.repeat(first, lanes), len(part)))
        batch = upload(mi.UInt32, np.repeat(part, n))
        count, width, stream = mi.UInt32(each), mi.UInt32(size), mi.UInt32(seed)
        dr.make_opaque(count, width, stream)
        row = pixel // width
        corner = mi.Point2f(mi.Float(pixel - row * width), mi.Float(row))
        # Two rounds of a block cipher: seeds that differ in one bit are unrelated (Zafar et al. 2010).
        key, other = mi.sample_tea_32(pixel + number * (width * width), batch * 0x9E3779B9 + stream)
        keys = [key, other]
        for dimension in range(2, DIMENSIONS):
            keys.append(mi.sample_tea_32(key + dimension, other)[0])

        # Scramble seeds stay outside the loop; inside there is one addition and four multiplications a dimension.
        totals = _loop(setup, reflectance, points, keys, corner, count, mi.Float(width))
        for picture, total in zip(result, totals):
            values = np.array(total / mi.Float(count)).T.reshape(len(part), n, 3)
            means = np.add.reduceat(values, first, axis=1) / lanes[:, None].astype(np.float32)
            picture[start : start + len(part), setup.pixels] = means
    return result.reshape(-1, batches, size, size, 3)


def _reversed(bits: np.ndarray) -> np.ndarray:
    """32-bit numbers with their bits in the opposite order."""
    for shift, mask in ((1, 0x55555555), (2, 0x33333333), (4, 0x0F0F0F0F), (8, 0x00FF00FF)):
        bits = ((bits >> shift) & np.uint32(mask)) | ((bits & np.uint32(mask)) << np.uint32(shift))
    return (bits >> 16) | (bits << np.uint32(16))


def _loop(
    setup: Setup, reflectance: Reflectance, points: Any, keys: list, corner: Any, count: Any, width: Any
) -> list[Any]:
    """Sums over a lane's samples, a colour for each table."""
    import drjit as dr
    import mitsuba as mi

    def body(index: Any, totals: list[Any]) -> tuple[Any, list[Any]]:
        low = dr.gather(mi.Vector4u, points, 2 * index)
        high = dr.gather(mi.Vector4u, points, 2 * index + 1)
        bits = [_scramble(x, key) for x, key in zip([*low, *high], keys)]
        at = (corner + mi.Point2f(fraction(bits[0]), fraction(bits[1]))) / width
        return index + 1, [a + b for a, b in zip(totals, _sample(setup, reflectance, at, bits[2:]))]

    lanes = dr.width(corner)
    start = dr.zeros(mi.UInt32, lanes), [dr.zeros(mi.Color3f, lanes) for _ in range(reflectance.size)]
    _, totals = dr.while_loop(
        start, lambda index, _: index < count, body, labels=("index", "totals"), mode="symbolic", label="samples"
    )
    dr.eval(totals)
    return totals[: reflectance.count]


def _camera_hit(setup: Setup, at: Any) -> tuple[Any, Any, Any, Any]:
    """Where the camera ray through the film at ``at`` finds the material: shading frame, direction back along the ray
    in the world, whether it does, and Mitsuba's interaction where shadow rays are needed."""
    import drjit as dr
    import mitsuba as mi

    origin, base, right, down = setup.camera
    ray_d = dr.normalize(base + at.x * right + at.y * down)
    if setup.sphere is not None:
        centre, radius = setup.sphere
        middle = dr.dot(centre - origin, ray_d)
        past = (centre - origin) - middle * ray_d
        half = dr.fma(radius, radius, -dr.squared_norm(past))
        normal = (ray_d * -dr.sqrt(dr.maximum(half, 0)) - past) / radius
        return mi.Frame3f(normal), -ray_d, (half > 0) & (middle > 0), None
    si = setup.loaded.ray_intersect(mi.Ray3f(mi.Point3f(origin), ray_d))
    hit = dr.full(mi.Bool, False)
    for shape in setup.shapes:
        hit |= si.shape == shape
    return si.sh_frame, -ray_d, si.is_valid() & hit, si


def _sample(setup: Setup, reflectance: Reflectance, at: Any, bits: list) -> list[Any]:
    """Radiance along one camera ray that finds the material, 0 for one that does not, for each table."""
    import mitsuba as mi

    frame, back, active, si = _camera_hit(setup, at)
    wi = frame.to_local(back)
    active &= wi.z > 0
    incidence = reflectance.incidence(wi, active)

    world, radiance, pdf = setup.environment.sample(bits[0], bits[1], active)
    wo = frame.to_local(world)
    use = active & (wo.z > 0) & (pdf > 0)
    if si is not None:
        use &= ~setup.loaded.ray_test(si.spawn_ray(world), use)
    angles = reflectance.angles(wi, wo)
    other = reflectance.pdf_at(wi, wo, angles[0], incidence, use)
    lit = _weighted(reflectance, angles, bits[5], radiance, pdf, other, wo.z, use)

    wo = reflectance.sample(wi, fraction(bits[2]), mi.Point2f(fraction(bits[3]), fraction(bits[4])), incidence, active)
    use = active & (wo.z > 0)
    world = frame.to_world(wo)
    if si is not None:
        use &= ~setup.loaded.ray_test(si.spawn_ray(world), use)
    angles = reflectance.angles(wi, wo)
    pdf = reflectance.pdf_at(wi, wo, angles[0], incidence, use)
    radiance, other = setup.environment.eval_pdf(world, use)
    found = _weighted(reflectance, angles, bits[5], radiance, pdf, other, wo.z, use)
    return [a + b for a, b in zip(lit, found)]


def _weighted(
    reflectance: Reflectance, angles: tuple, chance: Any, radiance: Any, pdf: Any, other: Any, cosine: Any, use: Any
) -> list[Any]:
    """What a sample of density ``pdf`` contributes beside a technique of density ``other``, for each table."""
    import drjit as dr
    import mitsuba as mi

    # Power heuristic: p_a^2 / (p_a^2 + p_b^2) / p_a
    weight = radiance * (cosine * pdf / dr.maximum(pdf * pdf + other * other, 1e-30))
    return [dr.select(use, value * weight, mi.Color3f(0)) for value in reflectance.values(angles, use, chance)]
