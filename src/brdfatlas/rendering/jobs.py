"""Renders of one material in several scenes: what the workflow, the command line and Python call."""

import hashlib
import json
import os
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from brdfatlas.constants import REFERENCE, REFERENCE_AGAIN
from brdfatlas.files import read_json
from brdfatlas.fits import Fit, is_fit_file, load_fit
from brdfatlas.measured import Measured, read_merl
from brdfatlas.rendering import use_variant
from brdfatlas.rendering.images import ImageError, Render, load_render, read_meta, save_render
from brdfatlas.rendering.scenes import (
    PreparedScene,
    SceneError,
    check_scene,
    check_settings,
    load_scene,
    mitsuba_scene,
    prepare_scene,
    read_scenes,
    scenes_file,
)


def render_scene(
    scene: PreparedScene,
    measured: Measured,
    table: np.ndarray | None = None,
    *,
    samples: int = 64,
    batches: int = 8,
    seed: int = 1,
) -> Render:
    """Render a reference, or a fit's ``table`` with the reference's mask and sampling density, in one scene.

    The variant must be set (:func:`brdfatlas.rendering.use_variant`). ``samples`` a pixel, all batches together,
    rounded up to a multiple of ``batches``. Raises SceneError for impossible settings.
    """
    return _render(scene, _reflectances(measured, table), samples, batches, seed)


def _reflectances(measured: Measured, table: np.ndarray | None) -> tuple[Any, Any]:
    """The reference, and what is rendered: a fit with the reference's density, or the reference itself."""
    from brdfatlas.rendering.bsdf import reflectance_of

    reference = reflectance_of(measured)
    return reference, reference if table is None else reference.with_table(table, measured.valid)


def _render(scene: PreparedScene, reflectances: tuple[Any, Any], samples: int, batches: int, seed: int) -> Render:
    import drjit as dr
    import mitsuba as mi

    check_settings(scene.size, samples, batches)
    reference, reflectance = reflectances
    if dr.is_jit_v(mi.Float):
        from brdfatlas.rendering.integrator import render_batches, set_up, share_lanes

        setup = set_up(scene)
        lanes = share_lanes(setup, reference, samples, seed)
        parts = render_batches(setup, reflectance, samples, batches, seed, lanes) + scene.background
    else:
        parts = stock_batches(scene, reflectance, samples, batches, seed)
    return _with_labels(scene, parts, samples, seed)


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

    loaded = mi.load_dict(mitsuba_scene(scene, bsdf_of(reflectance), integrator={"type": integrator}))
    each = -(-samples // batches)
    # Mitsuba takes 32 bits
    seeds = [(seed * 65536 + number) % 2**32 for number in range(batches)]
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
) -> Render:
    """Render a ``.binary``, a fit (``.npz``), or what was read from one, in a scene of ``scenes`` (config/scenes.yaml).

    ``integrator="path"`` traces paths with Mitsuba's own integrator: light that is reflected more than once. Raises
    ValueError (SceneError, MeasuredError, LlvmError) with one line that says what is wrong.
    """
    if integrator not in ("direct", "path"):
        raise SceneError(f"integrator {integrator!r}: choose direct or path")
    source = Path(scenes) if scenes else scenes_file()
    definitions = read_scenes(source)
    if scene not in definitions:
        raise SceneError(f"{source}: no scene {scene!r}; it has {', '.join(definitions)}")
    check_settings(size, samples, batches)
    if isinstance(item, str | os.PathLike):
        item = load_fit(item) if is_fit_file(item) else read_merl(item)
    material = item.material if isinstance(item, Fit) else item.name
    model = item.entry if isinstance(item, Fit) else REFERENCE
    if isinstance(item, Fit):
        item = Measured(item.material, item.table(), item.standin)
    use_variant(variant)
    prepared = prepare_scene(scene, definitions[scene], size, source=str(source))
    if integrator == "direct":
        render = render_scene(prepared, item, samples=samples, batches=batches, seed=seed)
    else:
        from brdfatlas.rendering.bsdf import reflectance_of

        parts = stock_batches(prepared, reflectance_of(item), samples, batches, seed, integrator)
        render = _with_labels(prepared, parts, samples, seed)
    notes = {"material": material, "model": model, "integrator": integrator, "standin": str(item.standin).lower()}
    return replace(render, meta=dict(render.meta) | notes)


def check_scenes_job(definitions: Mapping[str, Any], source: str, variant: str, output: str) -> None:
    """Read every file that the scenes name; SceneError before any rendering. Writes a line a scene."""
    from brdfatlas.files import write_text

    if any(shape["shape"] == "mesh" for d in definitions.values() for shape in d["geometry"]) or any(
        d["environment"]["kind"] == "file" for d in definitions.values()
    ):
        use_variant(variant)
        for name, definition in definitions.items():
            check_scene(definition, f"{source}: {name}")
    write_text(output, "".join(f"{name}: ok\n" for name in definitions))


def prepare_scene_job(
    name: str, definition: Mapping[str, Any], size: int, variant: str, source: str, output: str, threads: int = 1
) -> None:
    """Prepare one scene for all materials of a run."""
    use_variant(variant, threads)
    scene = prepare_scene(name, definition, size, source=source)
    for note in scene.notes:
        print(note)
    scene.save(output)


def render_job(
    material: str,
    model: str,
    binary: str,
    fit: str | None,
    report: str | None,
    scenes: Mapping[str, str],
    outputs: Mapping[str, str],
    settings: Mapping[str, Any],
    *,
    provenance: str = "",
    standin: bool = False,
    threads: int = 1,
) -> None:
    """Render one material with one model in every scene: one EXR each.

    ``model``: a model's name with its ``fit`` and ``report``, or "reference", or "reference_again", the same with other
    random numbers. ``scenes``: name -> prepared scene. ``settings``: samples, batches, seed, variant of the
    configuration, and optionally ``scene_samples``, name -> samples or None. ``provenance``: what the renderer is made
    of (:func:`brdfatlas.pipeline.provenance.provenance`). An output whose fingerprint is still right is kept. A failed
    fit gives black pictures with ``meta["status"] = "failed"``.
    """
    measured = read_merl(binary, standin=standin)
    failed = report is not None and read_json(report)["status"] != "ok"
    table = None if fit is None or failed else load_fit(fit).table()
    seed = settings["seed"] + (model == REFERENCE_AGAIN) * 1_000_003
    labels = {"material": material, "model": model, "standin": str(measured.standin).lower()}
    content = _digest(measured.table if table is None else table, measured.table)
    reflectances = None
    for name, path in scenes.items():
        scene = load_scene(path)
        samples = (settings.get("scene_samples") or {}).get(name) or settings["samples"]
        chosen = [samples, settings["batches"], seed, settings["variant"], failed, provenance]
        fingerprint = hashlib.sha256(json.dumps([scene.digest(), content, chosen]).encode()).hexdigest()
        tone = {key: repr(float(scene.definition[key])) for key in ("exposure", "gamma")}
        labels |= {"fingerprint": fingerprint, "title": scene.definition["title"], **tone}
        if _keep(outputs[name], labels):
            print(f"{outputs[name]}: kept")
            continue
        if failed:
            black = np.zeros((settings["batches"], scene.size, scene.size, 3), np.float32)
            render = Render(black[0], black, scene.mask, {"status": "failed", "scene": name})
        else:
            use_variant(settings["variant"], threads)
            reflectances = reflectances or _reflectances(measured, table)
            render = _render(scene, reflectances, samples, settings["batches"], seed)
        save_render(outputs[name], replace(render, meta=dict(render.meta) | labels))
        print(f"{outputs[name]}: rendered")


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


def _digest(*arrays: np.ndarray) -> str:
    digest = hashlib.sha256()
    for array in arrays:
        digest.update(np.ascontiguousarray(array).data)
    return digest.hexdigest()
