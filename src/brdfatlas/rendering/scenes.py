"""Scenes: read and checked from config/scenes.yaml, then prepared once for all materials.

Preparing makes or reads the environment and the meshes, and renders everything that the material does not touch: with
direct illumination the picture is a sum of what camera rays find on the material and of what they find elsewhere.
"""

import hashlib
import json
import math
from collections.abc import Mapping
from copy import deepcopy
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from brdfatlas.files import read_npz, write_npz
from brdfatlas.rendering import RENDERING
from brdfatlas.rendering.environments import ProbeError, environment_image, turned
from brdfatlas.settings import SCHEMAS, check, check_name, complete, located, read_yaml

#: Keys of a shape that say something about it, beside shape, surface and position.
_KEYS = {"sphere": {"size"}, "floor": {"size", "turn"}, "statue": {"size", "turn"}, "mesh": {"size", "turn", "file"}}
#: Sobol' points in a prepared scene, enough for 8192 samples in 8 batches, and their dimensions.
N_POINTS, DIMENSIONS = 1024, 8
#: A BSDF that reflects nothing: what is seen of the light past the material.
BLACK = {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.0}}


class SceneError(ValueError):
    """A scene that cannot be rendered; the message is one line that names file, key and remedy."""


def scenes_file() -> Path:
    """config/scenes.yaml of the working directory, else the built-in scenes of the package."""
    return Path(located("config/scenes.yaml"))


def read_scenes(path: str | Path | None = None) -> dict[str, dict[str, Any]]:
    """Every scene of a file, completed with defaults and checked against the schema: name -> definition.

    Fast and without Mitsuba; what is in the files that a scene names is checked by :func:`prepare_scene`.
    Raises ValueError (SceneError, ConfigError) with one line that names file, key and remedy.
    """
    path = Path(path or scenes_file())
    schema = read_yaml(SCHEMAS / "scenes.schema.yaml")
    scenes = read_yaml(located(path))
    if isinstance(scenes, Mapping):
        for scene in scenes.values():
            if isinstance(scene, Mapping) and isinstance(scene.get("camera"), Mapping):
                scene["camera"].setdefault("target", [0, 0, 0])
    scenes = check(scenes, schema, str(path))
    items = schema["additionalProperties"]["properties"]["geometry"]["items"]
    for name, scene in scenes.items():
        where = f"{path}: {check_name(name, str(path))}"
        scene["title"] = scene["title"] or name.replace("_", " ")
        for number, shape in enumerate(scene["geometry"]):
            spare = set(shape) - {"shape", "surface", "position"} - _KEYS[shape["shape"]]
            if spare:
                key = f"geometry.{number}.{sorted(spare)[0]}"
                raise SceneError(f"{where}.{key}: a {shape['shape']} has no such key, remove it")
            if shape["shape"] == "mesh" and not shape.get("file"):
                raise SceneError(f"{where}.geometry.{number}.file: a mesh needs a .ply or .obj file")
        scene["geometry"] = [complete(shape, items) for shape in scene["geometry"]]
        if not any(shape["surface"] == "material" for shape in scene["geometry"]):
            raise SceneError(f"{where}.geometry: nothing shows the material, give one shape `surface: material`")
        environment = scene["environment"]
        if (environment["kind"] == "file") != bool(environment["file"]):
            remedy = "name a light probe" if environment["kind"] == "file" else "remove it or set kind: file"
            raise SceneError(f"{where}.environment.file: does not go with kind {environment['kind']}, {remedy}")
        camera = scene["camera"]
        gaze = np.subtract(camera["target"], camera["origin"])
        if np.linalg.norm(np.cross(gaze, [0, 1, 0])) < 1e-6 * max(np.linalg.norm(gaze), 1e-9):
            raise SceneError(f"{where}.camera: the camera must not look straight up or down, nor at its own origin")
    return scenes


def check_settings(size: int, samples: int, batches: int, where: str = "render.") -> None:
    """Refuse a film of no pixels and a render of no samples. Raises SceneError naming the key, behind ``where``, and
    its range."""
    for key, value, low, reason in (
        ("size", size, 1, "a film has at least 1 pixel"),
        ("batches", batches, 1, "at least 1 batch is needed"),
        ("samples", samples, batches, "at least one sample a batch is needed"),
    ):
        if not isinstance(value, int | np.integer) or value < low:
            raise SceneError(f"{where}{key}: {value!r}: {reason}, give a whole number from {low}")


@dataclass(frozen=True, eq=False)
class Mesh:
    """A triangle mesh, (n, 3) float32 vertices, (m, 3) uint32, (n, 3) float32 unit normals; surface as configured."""

    vertices: np.ndarray
    faces: np.ndarray
    normals: np.ndarray
    surface: Any


@dataclass(frozen=True, eq=False)
class PreparedScene:
    """A scene ready for every material. Its ``definition`` is in a common unit of length (:func:`in_common_unit`).

    ``background``: (size, size, 3) float32, the radiance that arrives past the material, means over all camera rays of
    a pixel. ``coverage``: (size, size) float32, the share of camera rays that find the material. ``environment``:
    (h, w, 3) float32. ``meshes``: those of the definition that are not spheres or floors, in order. ``points``:
    (N_POINTS, DIMENSIONS) uint32, :func:`sobol_points`, for SciPy's import takes as long as a small render.
    """

    name: str
    definition: Mapping[str, Any]
    size: int
    environment: np.ndarray
    meshes: tuple[Mesh, ...]
    background: np.ndarray
    coverage: np.ndarray
    points: np.ndarray
    notes: tuple[str, ...] = field(default=())

    @property
    def mask(self) -> np.ndarray:
        """Pixels that the material covers wholly, (size, size) bool."""
        return self.coverage > 0.9999

    @property
    def lone_sphere(self) -> bool:
        """True if there is nothing but one sphere: no ray from it can be blocked, none needs tracing."""
        shapes = self.definition["geometry"]
        return len(shapes) == 1 and shapes[0]["shape"] == "sphere"

    def save(self, path: str | Path) -> None:
        """Write as npz, whole or not at all."""
        arrays = {"environment": self.environment, "background": self.background, "coverage": self.coverage}
        arrays |= {"points": self.points}
        for number, mesh in enumerate(self.meshes):
            arrays |= {f"mesh{number}/{key}": getattr(mesh, key) for key in ("vertices", "faces", "normals")}
        surfaces = [mesh.surface for mesh in self.meshes]
        labels = {"name": self.name, "definition": self.definition, "surfaces": surfaces, "notes": list(self.notes)}
        write_npz(path, arrays | {"labels": np.array(json.dumps(labels))})

    def digest(self) -> str:
        """SHA-256 of all that a render of this scene depends on; titles and tone maps are not among it."""
        seen = hashlib.sha256(json.dumps([self.definition[k] for k in ("geometry", "camera")]).encode())
        arrays = [self.environment, self.background, self.coverage]
        for array in arrays + [part for mesh in self.meshes for part in (mesh.vertices, mesh.faces, mesh.normals)]:
            seen.update(np.ascontiguousarray(array).data)
        return seen.hexdigest()


def sobol_points(count: int, known: np.ndarray | None = None) -> np.ndarray:
    """First ``count`` points of the Sobol' sequence in Gray code order as 32-bit fractions, (count, DIMENSIONS) uint32;
    from ``known`` where it has enough of them."""
    if known is not None and count <= len(known):
        return known[:count]
    from scipy.stats import qmc

    points = qmc.Sobol(DIMENSIONS, scramble=False, bits=32).random_base2(max(count - 1, 0).bit_length())[:count]
    return (points * 2.0**32).astype(np.uint64).astype(np.uint32)


def in_common_unit(definition: Mapping[str, Any]) -> dict[str, Any]:
    """A scene's definition with its lengths multiplied by the power of two that puts the camera 4 to 8 units from its
    target. Shadow rays of Mitsuba start a fixed distance off a surface, and its camera clips at fixed distances; a
    power of two rounds nothing."""
    scene = deepcopy(dict(definition))
    camera = scene["camera"]
    factor = 2.0 ** (2 - math.floor(math.log2(math.dist(camera["target"], camera["origin"]))))
    for holder, key in [(camera, "origin"), (camera, "target"), *((shape, "position") for shape in scene["geometry"])]:
        holder[key] = [factor * x for x in holder[key]]
    for shape in scene["geometry"]:
        shape["size"] *= factor
    return scene


def load_scene(path: str | Path) -> PreparedScene:
    """Read what :meth:`PreparedScene.save` wrote. ValueError naming the file for another npz."""
    store = read_npz(path)
    try:
        labels = json.loads(str(store["labels"]))
        meshes = tuple(
            Mesh(*(store[f"mesh{number}/{key}"] for key in ("vertices", "faces", "normals")), surface)
            for number, surface in enumerate(labels["surfaces"])
        )
        size = len(store["coverage"])
        arrays = [store[key] for key in ("background", "coverage", "points")]
        name, definition, notes = labels["name"], labels["definition"], tuple(labels["notes"])
        return PreparedScene(name, definition, size, store["environment"], meshes, *arrays, notes)
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(f"{path}: no prepared scene ({type(error).__name__}: {error})") from None


def load_meshes(scene: Mapping[str, Any], where: str) -> tuple[tuple[Mesh, ...], tuple[str, ...]]:
    """Statues and meshes of a scene, placed; and notes on what had to be repaired. SceneError as in the module."""
    from brdfatlas.rendering.meshes import MeshError, read_mesh
    from brdfatlas.rendering.statue import statue_mesh

    meshes, notes = [], []
    for number, shape in enumerate(scene["geometry"]):
        key = f"{where}.geometry.{number}.file"
        if shape["shape"] == "statue":
            vertices, faces, normals = statue_mesh()
        elif shape["shape"] == "mesh":
            try:
                vertices, faces, normals, repaired = read_mesh(shape["file"], key)
            except MeshError as error:
                raise SceneError(str(error)) from None
            notes += [f"{key}: {shape['file']}: {note}" for note in repaired]
        else:
            continue
        low, high = vertices.min(0), vertices.max(0)
        foot = np.array([(low[0] + high[0]) / 2, low[1], (low[2] + high[2]) / 2])
        if shape["shape"] == "statue":
            foot = np.zeros(3)
        angle = np.radians(shape["turn"])
        turn = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
        placed = (vertices - foot) @ turn.T * (shape["size"] / (high[1] - low[1])) + shape["position"]
        meshes.append(Mesh(placed.astype(np.float32), faces, (normals @ turn.T).astype(np.float32), shape["surface"]))
    return tuple(meshes), tuple(notes)


def _environment(scene: Mapping[str, Any], where: str) -> np.ndarray:
    try:
        return environment_image(scene["environment"], f"{where}.environment")
    except ProbeError as error:
        raise SceneError(str(error)) from None


def mitsuba_scene(
    scene: PreparedScene, material: Any, size: int | None = None, integrator: Any = None
) -> dict[str, Any]:
    """The scene as a Mitsuba dictionary, the material's shapes with the BSDF ``material`` (an object or a dict)."""
    import mitsuba as mi

    transform, camera = mi.ScalarTransform4f, scene.definition["camera"]
    size = size or scene.size
    film = {
        "type": "hdrfilm",
        "width": size,
        "height": size,
        "pixel_format": "rgb",
        "component_format": "float32",
        "filter": {"type": "box"},
    }
    near = 1e-3 * math.dist(camera["target"], camera["origin"])
    view = transform().look_at(origin=camera["origin"], target=camera["target"], up=[0, 1, 0])
    result = {
        "type": "scene",
        "integrator": integrator or {"type": "direct"},
        "sensor": {"type": "perspective", "fov": camera["fov"], "near_clip": near, "to_world": view, "film": film},
        "light": {"type": "envmap", "bitmap": mi.Bitmap(scene.environment)},
    }
    material = mi.load_dict(material) if isinstance(material, dict) else material
    meshes = iter(scene.meshes)
    for number, shape in enumerate(scene.definition["geometry"]):
        if shape["surface"] == "material":
            bsdf = material
        else:
            bsdf = {"type": "diffuse", "reflectance": {"type": "rgb", "value": list(map(float, shape["surface"]))}}
        if shape["shape"] == "sphere":
            item = {"type": "sphere", "center": list(shape["position"]), "radius": float(shape["size"]), "bsdf": bsdf}
        elif shape["shape"] == "floor":
            place = transform().translate(shape["position"]).rotate([0, 1, 0], shape["turn"])
            place = place.rotate([1, 0, 0], -90).scale(shape["size"])
            item = {"type": "rectangle", "to_world": place, "bsdf": bsdf}
        else:
            item = _mitsuba_mesh(next(meshes), f"shape{number}", bsdf)
        result[f"shape{number}"] = item
    return result


def _mitsuba_mesh(mesh: Mesh, name: str, bsdf: Any) -> Any:
    import mitsuba as mi

    properties = mi.Properties()
    properties["mesh_bsdf"] = mi.load_dict(bsdf) if isinstance(bsdf, dict) else bsdf
    made = mi.Mesh(name, len(mesh.vertices), len(mesh.faces), props=properties, has_vertex_normals=True)
    parameters = mi.traverse(made)
    for key, values in (("vertex_positions", mesh.vertices), ("vertex_normals", mesh.normals), ("faces", mesh.faces)):
        parameters[key] = type(parameters[key])(values.ravel())
    parameters.update()
    return made


def prepare_scene(
    name: str, scene: Mapping[str, Any], size: int, samples: int = 256, source: str = "scenes"
) -> PreparedScene:
    """Make a scene ready: environment, meshes, background. SceneError if a file is bad or no pixel shows the material.

    ``samples``: of the background, which is the same for the reference and all fits.
    """
    import mitsuba as mi

    check_settings(size, samples, 1)
    where = f"{source}: {name}"
    scene = in_common_unit(scene)
    meshes, notes = load_meshes(scene, where)
    environment = _environment(scene, where)
    black, empty = np.zeros((size, size, 3), np.float32), np.zeros((size, size), np.float32)
    points = sobol_points(N_POINTS)
    bare = PreparedScene(name, scene, size, environment, meshes, black, empty, points, notes)
    with RENDERING:
        loaded = mi.load_dict(mitsuba_scene(bare, BLACK))
        background = np.array(mi.render(loaded, spp=samples, seed=0), np.float32)
        coverage, back = _coverage(loaded, scene, size)
        del loaded  # before another thread renders
    share = float(back.sum() / max(coverage.sum(), 1e-9))
    fault = f"{share:.0%} of what is seen of the material is its back, which reflects nothing"
    if share > 0.5:
        raise SceneError(f"{where}: {fault}; turn faces and normals of the mesh outward, or move the camera")
    if share > 0.05:  # a coarse mesh has as much at its silhouette
        notes = (*notes, f"{where}: {fault}")
    if coverage.max() < 0.9999:
        fault = f"no pixel of {size} x {size} shows the material alone"
        raise SceneError(f"{where}: {fault}; take a larger size, or move the camera or the shapes")
    return PreparedScene(name, scene, size, environment, meshes, background, coverage, points, notes)


def turn_light(scene: PreparedScene, degrees: float, samples: int = 64) -> PreparedScene:
    """The scene with its environment turned about the vertical, anticlockwise from above; ``samples``: of the
    background."""
    import mitsuba as mi

    environment = np.ascontiguousarray(turned(scene.environment, degrees), np.float32)
    lit = replace(scene, environment=environment)
    with RENDERING:
        background = np.array(mi.render(mi.load_dict(mitsuba_scene(lit, BLACK)), spp=samples, seed=0), np.float32)
    return replace(lit, background=background)


def material_shapes(loaded: Any, scene: Mapping[str, Any]) -> list[Any]:
    """The shapes of a loaded Mitsuba scene that show the material."""
    shapes = {shape.id(): shape for shape in loaded.shapes()}
    return [shapes[f"shape{n}"] for n, shape in enumerate(scene["geometry"]) if shape["surface"] == "material"]


def _coverage(loaded: Any, scene: Mapping[str, Any], size: int) -> tuple[np.ndarray, np.ndarray]:
    """Share of a pixel's camera rays, those through its corners among them, that find a shape with the material, and
    share that find it from behind; (size, size) float32 each."""
    import drjit as dr
    import mitsuba as mi

    sensor = loaded.sensors()[0]
    shapes = material_shapes(loaded, scene)
    if not dr.is_jit_v(mi.Float):
        side, total = 3, np.zeros((2, size, size), np.float32)
        for row, column, y, x in np.ndindex(size, size, side, side):
            at = mi.Point2f((column + x / (side - 1)) / size, (row + y / (side - 1)) / size)
            hit = loaded.ray_intersect(sensor.sample_ray(0.0, 0.5, at, mi.Point2f(0.5))[0])
            found = hit.is_valid() and any(hit.shape == shape for shape in shapes)
            total[:, row, column] += found, found and hit.wi.z <= 0
    else:
        side, total = 8, np.zeros((2, size * size), np.float32)
        shapes = [mi.ShapePtr(shape) for shape in shapes]
        column, row = np.meshgrid(np.arange(size), np.arange(size))
        for fine in np.ndindex(side, side):
            at = [((c.ravel() + f / (side - 1)) / size) for c, f in zip((column, row), fine)]
            ray, _ = sensor.sample_ray(0.0, 0.5, mi.Point2f(mi.Float(at[0]), mi.Float(at[1])), mi.Point2f(0.5))
            hit = loaded.ray_intersect(ray)
            found = dr.full(mi.Bool, False, size * size)
            for shape in shapes:
                found |= hit.is_valid() & (hit.shape == shape)
            total += np.array(found), np.array(found & (hit.wi.z <= 0))
    coverage, back = total.reshape(2, size, size) / side**2
    return coverage, back
