"""Renders of one material and all its fits: what the workflow, the command line and Python call."""

import hashlib
import json
import os
import sys
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from brdfatlas.constants import REFERENCE, REFERENCE_AGAIN
from brdfatlas.files import digest_of, fingerprint, read_record, write_made
from brdfatlas.fits import Fit, is_fit_file, load_fit, load_reported
from brdfatlas.formats.reader import read
from brdfatlas.measured import Measured
from brdfatlas.rendering import RENDERING, use_variant
from brdfatlas.rendering.images import ImageError, Render, load_render, read_meta, save_render
from brdfatlas.rendering.scenes import (
    PreparedScene,
    SceneError,
    check_settings,
    load_scene,
    mitsuba_scene,
    prepare_scene,
    read_scenes,
    scenes_file,
    turn_light,
)

#: Most bytes of the batches of pictures that are rendered together, where one alone has not more.
MOST_GROUP_BYTES = 2**29


def picture_seed(seed: int, material: str, scene: str, purpose: str = "picture") -> int:
    """The 32-bit seed of a render: ``seed`` of the configuration hashed with the material and the scene, so that
    materials and scenes have independent noise; ``purpose`` tells the renders of one material in one scene apart
    ("picture", REFERENCE_AGAIN, "pilot")."""
    text = json.dumps([seed, material, scene, purpose])
    return int.from_bytes(hashlib.sha256(text.encode()).digest()[:4], "little")


def render_models(
    scene: PreparedScene,
    measured: Measured,
    tables: Mapping[str, np.ndarray | None],
    *,
    samples: int = 64,
    batches: int = 8,
    seed: int = 1,
) -> dict[str, Render]:
    """Render a reference and its fits in one scene along the same paths: name -> picture.

    ``tables``: name -> table of a fit (90, 90, 180 or 360, 3), or None for the reference itself, whose mask and
    sampling density all share. What is called REFERENCE_AGAIN has other random numbers than the rest. ``samples`` a
    pixel, all batches together, rounded up to a multiple of ``batches``. The variant must be set
    (:func:`brdfatlas.rendering.use_variant`). Raises SceneError for impossible settings, MeasuredError for a table that
    is not finite where the reference was measured.
    """
    found = dict(_renders(scene, measured, tables, samples, batches, seed))
    return {name: found[name] for name in tables}


def _renders(
    scene: PreparedScene,
    measured: Measured,
    tables: Mapping[str, np.ndarray | None],
    samples: int,
    batches: int,
    seed: int,
) -> Iterator[tuple[str, Render]]:
    """The pictures of :func:`render_models` one by one, for who has no room for all: name, picture."""
    import drjit as dr
    import mitsuba as mi

    from brdfatlas.rendering.bsdf import reflectance_of

    check_settings(scene.size, samples, batches)
    with RENDERING:
        reference = reflectance_of(measured)
        passes = _stock_pass
        if dr.is_jit_v(mi.Float):
            from brdfatlas.rendering.integrator import set_up, share_lanes

            setup = set_up(scene)
            pilot = picture_seed(seed, measured.name, scene.name, "pilot")
            passes = partial(_shared_pass, setup, share_lanes(setup, reference, samples, pilot))
        again = [name for name in tables if name == REFERENCE_AGAIN]
        for purpose, names in (("picture", [name for name in tables if name not in again]), (REFERENCE_AGAIN, again)):
            stream = picture_seed(seed, measured.name, scene.name, purpose)
            chosen = [measured.table if tables[name] is None else tables[name] for name in names]
            pictures = passes(scene, reference, chosen, samples, batches, stream)
            for name, parts in zip(names, pictures):
                yield name, _with_labels(scene, parts, samples, stream)


def render_turning(
    scene: PreparedScene,
    measured: Measured,
    tables: Mapping[str, np.ndarray | None],
    turns: Sequence[float],
    *,
    samples: int = 64,
    batches: int = 4,
    seed: int = 1,
) -> Iterator[dict[str, np.ndarray]]:
    """As :func:`render_models` with the environment turned by each of ``turns`` in degrees: name -> (size, size, 3)
    linear radiance. Tables are loaded once, at most 32, and every lane has as many samples: noise does not move."""
    import drjit as dr
    import mitsuba as mi

    from brdfatlas.rendering.bsdf import reflectance_of

    settings = {"samples": samples, "batches": batches, "seed": seed}
    if not dr.is_jit_v(mi.Float):
        for degrees in turns:
            renders = render_models(turn_light(scene, degrees), measured, tables, **settings)
            yield {name: render.mean for name, render in renders.items()}
        return
    from brdfatlas.rendering.integrator import render_batches, set_up

    check_settings(scene.size, samples, batches)
    with RENDERING:
        chosen = [measured.table if table is None else table for table in tables.values()]
        group = reflectance_of(measured).with_tables(chosen)
    stream = picture_seed(seed, measured.name, scene.name)
    for degrees in turns:
        with RENDERING:
            lit = turn_light(scene, degrees)
            parts = render_batches(set_up(lit), group, samples, batches, stream).mean(1) + lit.background
        yield dict(zip(tables, parts))


def _shared_pass(
    setup: Any, lanes: np.ndarray, scene: PreparedScene, reference: Any, tables: Sequence[np.ndarray], *settings: int
) -> Iterator[np.ndarray]:
    """Batches of every table, a group of tables at a time, no more than there is room for."""
    from brdfatlas.rendering.bsdf import GROUP_SIZES
    from brdfatlas.rendering.integrator import render_batches

    _, batches, _ = settings
    picture = 12 * batches * scene.size**2
    together = max(size for size in GROUP_SIZES if size == 1 or size * picture <= MOST_GROUP_BYTES)
    for first in range(0, len(tables), together):
        group = reference.with_tables(tables[first : first + together])
        for parts in render_batches(setup, group, *settings, lanes):
            yield parts + scene.background


def _stock_pass(
    scene: PreparedScene, reference: Any, tables: Sequence[np.ndarray], *settings: int
) -> Iterator[np.ndarray]:
    """As :func:`_shared_pass` by stock Mitsuba, one table after another, for scalar variants."""
    for table in tables:
        yield stock_batches(scene, reference.with_tables(table), *settings)


def render_scene(
    scene: PreparedScene,
    measured: Measured,
    table: np.ndarray | None = None,
    *,
    samples: int = 64,
    batches: int = 8,
    seed: int = 1,
) -> Render:
    """Render a reference, or a fit's ``table`` with the reference's mask and sampling density, in one scene: one
    picture of :func:`render_models`. ``table``: (90, 90, 180, 3) or (90, 90, 360, 3) in 1/sr, None for the
    reference."""
    return render_models(scene, measured, {"": table}, samples=samples, batches=batches, seed=seed)[""]


def _with_labels(scene: PreparedScene, parts: np.ndarray, samples: int, seed: int) -> Render:
    """A render of batches (n, size, size, 3) that says how it was made."""
    import mitsuba as mi

    meta = {
        "status": "ok",
        "scene": scene.name,
        "title": scene.definition["title"],
        "exposure": repr(float(scene.definition["exposure"])),
        "gamma": repr(float(scene.definition["gamma"])),
        "samples": str(-(-samples // len(parts)) * len(parts)),
        "batches": str(len(parts)),
        "seed": str(seed),
        "variant": mi.variant(),
    }
    return Render(parts.mean(0, dtype=np.float64).astype(np.float32), parts, scene.mask, meta)


def stock_batches(
    scene: PreparedScene, reflectance: Any, samples: int, batches: int, seed: int, integrator: str = "direct"
) -> np.ndarray:
    """The same picture by Mitsuba's own integrator ("direct", "path") through the plugin: (batches, size, size, 3).

    For scalar variants, for path tracing, and as the yardstick of tests and benchmarks.
    """
    import mitsuba as mi

    from brdfatlas.rendering.bsdf import bsdf_of

    each = -(-samples // batches)
    # Mitsuba takes 32 bits
    seeds = [(seed * 65536 + number) % 2**32 for number in range(batches)]
    with RENDERING:
        loaded = mi.load_dict(mitsuba_scene(scene, bsdf_of(reflectance), integrator={"type": integrator}))
        return np.stack([np.array(mi.render(loaded, spp=each, seed=number), np.float32) for number in seeds])


def render_file(
    item: str | os.PathLike | Measured | Fit,
    scene: str,
    *,
    samples: int = 64,
    size: int = 256,
    seed: int = 1,
    batches: int = 8,
    scenes: str | os.PathLike | None = None,
    integrator: str = "direct",
    variant: str = "llvm_ad_rgb",
    reference: str | os.PathLike | Measured | None = None,
) -> Render:
    """Render a ``.binary``, a fit (``.npz``), or what was read from one, in a scene of ``scenes`` (config/scenes.yaml).

    ``reference``: the material of a fit, whose mask of measured cells, sampling and random numbers the fit then has:
    the picture of a run, to be compared with that of the material. A fit alone is drawn with its own values where
    nothing was measured.

    ``integrator="path"`` traces paths with Mitsuba's own integrator: light that is reflected more than once. Raises
    ValueError (SceneError, MeasuredError, LlvmError) with one line that says what is wrong, TypeError for what is none
    of the first.
    """
    if integrator not in ("direct", "path"):
        raise SceneError(f"integrator {integrator!r}: choose direct or path")
    source = Path(scenes) if scenes else scenes_file()
    definitions = read_scenes(source)
    if scene not in definitions:
        raise SceneError(f"{source}: no scene {scene!r}; it has {', '.join(definitions)}")
    check_settings(size, samples, batches)
    if isinstance(item, str | os.PathLike):
        item = load_fit(item) if is_fit_file(item) else read(item)
    if not isinstance(item, Measured | Fit):
        raise TypeError(f"{item!r:.80} is no path, Measured or Fit")
    material = item.material if isinstance(item, Fit) else item.name
    model = item.entry if isinstance(item, Fit) else REFERENCE
    table = item.table() if isinstance(item, Fit) else item.table
    if reference is not None:
        measured = reference if isinstance(reference, Measured) else read(reference)
    else:
        measured, table = Measured(material, table, item.standin) if isinstance(item, Fit) else item, None
    use_variant(variant)
    prepared = prepare_scene(scene, definitions[scene], size, source=str(source))
    for note in prepared.notes:
        print(note, file=sys.stderr)
    if integrator == "direct":
        render = render_scene(prepared, measured, table, samples=samples, batches=batches, seed=seed)
    else:
        from brdfatlas.rendering.bsdf import reflectance_of

        parts = stock_batches(prepared, reflectance_of(measured, table), samples, batches, seed, integrator)
        render = _with_labels(prepared, parts, samples, seed)
    notes = {"material": material, "model": model, "integrator": integrator, "standin": str(item.standin).lower()}
    return replace(render, meta=dict(render.meta) | notes)


def prepare_scene_job(
    name: str, definition: Mapping[str, Any], size: int, variant: str, source: str, output: str, threads: int = 1
) -> None:
    """Prepare one scene for all materials of a run. SceneError, and no file, where one that the scene names is bad."""
    use_variant(variant, threads)
    scene = prepare_scene(name, definition, size, source=source)
    for note in scene.notes:
        print(note)
    scene.save(output)


def render_job(
    material: str,
    binary: str,
    scene: str,
    fits: Mapping[str, tuple[str, str]],
    outputs: Mapping[str, str],
    settings: Mapping[str, Any],
    *,
    made: str,
    provenance: str = "",
    standin: bool = False,
    threads: int = 1,
) -> None:
    """Render one material in one scene: an EXR for each of ``outputs``, name -> path, and at the end their
    fingerprints to ``made``.

    A name is that of one of ``fits``, name -> (fit, report), or REFERENCE, or REFERENCE_AGAIN, the reference with other
    random numbers. ``scene``: path of the prepared scene. ``settings``: samples, batches, seed and variant.
    ``provenance``: what the renderer is made of (:func:`brdfatlas.pipeline.provenance.provenance`). An output whose
    fingerprint is still right is kept; the others are rendered together. A failed fit gives a black picture with
    ``meta["status"] = "failed"``.
    """
    measured, prepared = read(binary, standin=standin), load_scene(scene)
    names = [name for name in outputs if name in fits]
    with ThreadPoolExecutor(threads) as pool:
        tables = dict(zip(names, pool.map(lambda name: _table_of(*fits[name], name, measured.name), names)))
    measured = replace(measured, name=material)
    chosen = [settings[key] for key in ("samples", "batches", "seed", "variant")] + [provenance]
    labels = {name: _labels(name, measured, tables.get(name), name in names, prepared, chosen) for name in outputs}
    needed = {}
    for name, path in outputs.items():
        if _keep(path, labels[name]):
            print(f"{path}: kept")
        elif name in names and tables[name] is None:
            black = np.zeros((settings["batches"], prepared.size, prepared.size, 3), np.float32)
            failed = Render(black[0], black, prepared.mask, {"status": "failed", "scene": prepared.name})
            _save(path, failed, labels[name])
        else:
            needed[name] = tables.get(name)
    if needed:
        use_variant(settings["variant"], threads)
        counts = {key: settings[key] for key in ("samples", "batches", "seed")}
        for name, render in _renders(prepared, measured, needed, **counts):
            _save(outputs[name], render, labels[name])
    write_made(made, {name: told["fingerprint"] for name, told in labels.items()})


def _table_of(fit: str, report: str, entry: str, material: str) -> np.ndarray | None:
    """The table of a fit, None if it failed."""
    told = read_record(report, "status")
    return load_reported(fit, told, entry, material).table() if told["status"] == "ok" else None


def _labels(
    name: str, measured: Measured, table: np.ndarray | None, fitted: bool, scene: PreparedScene, chosen: Sequence
) -> dict[str, str]:
    """What the EXR of a picture says beside its pixels; ``fingerprint`` covers all that they depend on, ``chosen`` with
    it."""
    failed = fitted and table is None
    content = digest_of(measured.table if table is None else table, measured.table)
    told = [scene.digest(), content, measured.name, scene.name, name == REFERENCE_AGAIN, failed, *chosen]
    labels = {"material": measured.name, "model": name, "standin": str(measured.standin).lower()}
    labels |= {"fingerprint": fingerprint(*told), "title": scene.definition["title"]}
    return labels | {key: repr(float(scene.definition[key])) for key in ("exposure", "gamma")}


def _save(path: str, render: Render, labels: Mapping[str, str]) -> None:
    save_render(path, replace(render, meta=dict(render.meta) | labels))
    print(f"{path}: rendered")


def _keep(path: str, labels: Mapping[str, str]) -> bool:
    """Whether a render is there and still right; it then gets the labels of today and a fresh time stamp."""
    meta = read_meta(path)
    if meta.get("fingerprint") != labels["fingerprint"]:
        return False
    try:
        old = load_render(path)  # whole, not cut off
    except ImageError:
        return False
    if any(meta.get(key) != value for key, value in labels.items()):
        save_render(path, replace(old, meta=dict(old.meta) | dict(labels)))
    os.utime(path)
    return True
