"""What each command does. Each is also a Python function of the package; heavy parts are imported when used."""

import argparse
import contextlib
import dataclasses
import json
import math
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from brdfatlas.angles import above_horizon
from brdfatlas.files import FileFault, check_output, check_regular, json_of, shown
from brdfatlas.fits import Fit, fit, is_fit_file, load_fit
from brdfatlas.formats.merl import write_merl
from brdfatlas.formats.reader import read
from brdfatlas.measured import Measured, fold
from brdfatlas.measures.recommendation import allowed
from brdfatlas.models import MODELS

if TYPE_CHECKING:
    from brdfatlas.rendering.images import Render

#: Mean dE00 of a render above which a recommendation says that it is a poor one: several times what is just visible.
POOR_DE00 = 5.0
#: Targets of `export` with the kind of file that each is.
EXPORTS = {
    "json": "JSON",
    "sampler": "JSON",
    "mitsuba": "XML",
    "materialx": "MaterialX",
    "gltf": "glTF",
    "merl": "MERL table",
}


def say(*lines: object) -> None:
    """Print lines; a line break or an escape in a file's name cannot make one more."""
    emit("".join(f"{shown(line)}\n" for line in lines))


def emit(text: str, *, flush: bool = False) -> None:
    """Print a text. A fault of standard output names it, and what is left to be printed is lost: at exit Python would
    flush it, and complain."""
    try:
        print(text, end="", flush=flush)
    except OSError as error:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        raise OSError(error.errno, error.strerror, "standard output") from None


def load(path: str, source: str | None = None) -> Measured | Fit:
    """A measured file or a fit, whatever the file is; ``source``: the file of a fit's model where it has moved."""
    check_input(path)
    return stored_fit(path, source) if is_fit_file(path) or _is_json_fit(path) else read_aloud(path)


def stored_fit(path: str, source: str | None = None) -> Fit:
    """A fit, as npz or as the JSON that `export` wrote."""
    from brdfatlas.export.fit_json import import_json

    return import_json(path, source) if _is_json_fit(path) else load_fit(path, source)


def _is_json_fit(path: str) -> bool:
    return os.path.isfile(path) and json_of(path) == "fit"


def table_of(item: Measured | Fit, path: str) -> np.ndarray:
    """Its values on the MERL grid, NaN where there are none. ValueError for a fit that has none above the horizon."""
    if isinstance(item, Measured):
        return item.table
    table = fold(item.table())
    bad = int((~np.isfinite(table[above_horizon()])).any(-1).sum())
    if bad:
        raise ValueError(f"{path}: NaN or Inf at {bad:,} cells above the horizon; fit again")
    return table


def check_input(path: str) -> None:
    """Refuse what is no regular file; one that is not there is left to the reader's own words."""
    with contextlib.suppress(FileNotFoundError):
        check_regular(path)


def models_command(args: argparse.Namespace) -> dict[str, Any]:
    """Every model: name, paper, free parameters, bytes."""
    listed = {}
    for name in MODELS:
        try:
            model = MODELS[name]
        except ImportError as error:  # another package's model; the rest can still be listed
            print(f"brdfatlas models: {name}: left out, {shown(error)}", file=sys.stderr)
            continue
        listed[name] = {
            "title": model.title,
            "paper": model.paper.short,
            "doi": model.paper.doi,
            "status": model.status,
            "free_parameters": model.free_parameters,
            "bytes": model.bytes,
            "exports": list(model.targets),
            "options": {
                key: {
                    "default": o.default,
                    "choices": list(o.choices),
                    "low": o.low,
                    "high": o.high,
                    "description": o.description,
                }
                for key, o in model.options.items()
            },
            "parameters": [
                {
                    "name": p.name,
                    "shape": list(p.shape),
                    "unit": p.unit,
                    "low": p.low,
                    "high": p.high,
                    "description": p.description,
                }
                for p in model.parameters
            ],
        }
    if not args.json:
        say(f"{'name':18} {'paper':26} {'numbers':>8} {'bytes':>8}")
        for name, m in listed.items():
            note = f"  ({m['status'].split(':')[0]})" if m["status"] else ""
            say(f"{name:18} {m['paper']:26} {m['free_parameters']:8,} {m['bytes']:8,}{note}")
    return listed


def info_command(args: argparse.Namespace) -> dict[str, Any]:
    """What a measured file or a fit (.npz or JSON) holds: valid cells, range, albedo; model, parameters. Or what is
    wrong with it."""
    from brdfatlas.pipeline.records import describe_material

    item = load(args.file, args.source)
    if isinstance(item, Fit):
        return fit_info(args, item)
    described = describe_material(item)
    if not args.json:
        low, high = described["range"]
        note = "" if described["kind"] == "measured" else f" (a {described['kind']} material)"
        shares = (f"{share:.1%} of the valid cells {name}" for name, share in described["shares"].items() if share)
        told = {key: described[key] for key in ("origin", "instrument", "note") if described[key]}
        albedo = ", ".join(f"{value:.4f}" for value in described["albedo"])
        say(
            f"{args.file}{note}: {described['format']}",
            *(f"{key}: {text}" for key, text in told.items()),
            f"{described['valid_cells']:,} of {described['cells_above_horizon']:,} cells above the horizon are valid",
            *shares,
            f"range {low:.6g} to {high:.6g} 1/sr",
            f"albedo at 30 degrees (rgb) {albedo}",
            f"class {described['class']} ({_spread(described['diffuseness'])})",
        )
    return described


def _spread(diffuseness: float) -> str:
    return f"diffuseness {diffuseness:.4g}" if math.isfinite(diffuseness) else "it reflects nothing"


def read_aloud(path: str) -> Measured:
    """A measured file; what was assumed, changed or looks wrong is said on stderr."""
    measured = read(path)
    for warning in measured.provenance.warnings:
        print(shown(f"{path}: {warning}"), file=sys.stderr)
    return measured


def convert_command(args: argparse.Namespace) -> dict[str, Any]:
    """Any measured file or fit as a MERL .binary, or as a .csv on a chosen set of directions."""
    from brdfatlas.formats.tables import regular_directions, scattered_directions, write_csv

    item = load(args.file, args.source)
    fitted = isinstance(item, Fit)
    kind = "stand-in" if item.standin else "reconstructed" if fitted else item.kind
    rows = None
    if Path(args.output).suffix.lower() != ".csv":
        if args.like or args.step:
            raise ValueError("--like and --step choose directions of a .csv; name such an output")
        write_merl(args.output, table_of(item, args.file), standin=item.standin, reconstructed=kind == "reconstructed")
    else:
        wi, wo = scattered_directions(args.like) if args.like else regular_directions(args.step or 10.0)
        values = item.evaluate(wi, wo) if fitted else item.evaluate_measured(wi, wo)
        rows = write_csv(args.output, wi, wo, values, kind, f"{Path(args.file).name}, converted by brdfatlas")
    if not args.json:
        left_out = f", {len(wi) - rows:,} were not measured" if rows is not None and rows < len(wi) else ""
        say(f"{args.named}: {args.file}{'' if rows is None else f', {rows:,} pairs of directions{left_out}'}")
    return {"file": args.file, "output": args.named, "kind": kind, "rows": rows}


def fit_info(args: argparse.Namespace, fitted: Fit) -> dict[str, Any]:
    """What a fit is: model, material, options, bytes, and those parameters that a person can read."""
    model = fitted.instance
    small = {name: array for name, array in fitted.parameters.items() if array.size <= 24}
    if not args.json:
        note = " (a stand-in)" if fitted.standin else ""
        options = ", ".join(f"{key} {value}" for key, value in fitted.options.items()) or "none"
        say(
            f"{args.file}: a fit of {fitted.model} ({model.title}, {model.paper.short}) to {fitted.material}{note}",
            f"{fitted.bytes:,} bytes, options: {options}",
            *(f"{name} {np.array2string(array, precision=6, separator=', ')}" for name, array in small.items()),
            *(f"{name} {array.shape}" for name, array in fitted.parameters.items() if name not in small),
        )
    return {
        "kind": "fit",
        "model": fitted.model,
        "title": model.title,
        "paper": model.paper.short,
        "material": fitted.material,
        "standin": fitted.standin,
        "options": dict(fitted.options),
        "bytes": fitted.bytes,
        "parameters": small,
        "shapes": {name: list(array.shape) for name, array in fitted.parameters.items()},
    }


def standin_command(args: argparse.Namespace) -> dict[str, Any]:
    """Write a built-in material in MERL format: cell by cell the median of five published fits of the material of that
    name (Bilgili et al. 2011), made reciprocal. It is no measurement, and a few do not look like their names."""
    from brdfatlas.pipeline.standins import standin_names, write_standin

    if args.list:
        if args.material or args.output:
            raise ValueError("--list writes no file; leave it out, or MATERIAL and -o")
        if not args.json:
            say(*standin_names())
        return {"standins": standin_names()}
    if not args.material or not args.output:
        raise ValueError("name a material and an output: MATERIAL -o OUT.binary; --list says which there are")
    write_standin(args.material, args.output)
    if not args.json:
        say(f"{args.named}: stand-in for {args.material}, the median of five published fits, not a measurement")
    return {"material": args.material, "output": args.named, "standin": True}


def parse_options(items: Sequence[str]) -> dict[str, Any]:
    """KEY=VALUE pairs; a value is JSON where it parses as JSON, else text."""
    options: dict[str, Any] = {}
    for item in items:
        key, separator, value = item.partition("=")
        if not separator:
            raise ValueError(f"--option {item}: expected KEY=VALUE")
        if key in options:
            raise ValueError(f"--option {key}: stands twice; leave one out")
        try:
            options[key] = json.loads(value)
        except json.JSONDecodeError:
            options[key] = value
        except (ValueError, RecursionError):
            raise ValueError(f"--option {key}: {value[:40]!r}... is too long or nested too deeply") from None
    return options


def fit_command(args: argparse.Namespace) -> dict[str, Any]:
    """Fit a model to a file and save the fit."""
    if args.source:
        MODELS.register_file(args.model, args.source)
    check_input(args.file)
    options = MODELS[args.model].check_options(parse_options(args.option))
    fitted = fit(args.model, read_aloud(args.file), seed=args.seed, **options)
    fitted.save(args.output)
    report = {"model": fitted.entry, "material": fitted.material, "output": args.named, **fitted.report}
    if not args.json:
        why = f" ({report['message']})" if report["message"] else ""
        state = "converged" if report["converged"] else f"did not converge{why}"
        say(
            f"{args.named}: {report['objective_name']} {report['objective']:.6g} after {report['iterations']} "
            f"iterations in {report['seconds']:.2f} s, {state}, {report['bytes']:,} bytes"
        )
    return report


def table_command(args: argparse.Namespace) -> dict[str, Any]:
    """Put a fit on the MERL grid, for any MERL reader."""
    fitted = stored_fit(args.fit, args.source)
    write_merl(args.output, table_of(fitted, args.fit), standin=fitted.standin, reconstructed=True)
    folded = not fitted.instance.reciprocal
    if not args.json:
        note = " (not reciprocal: the mean of both orders of the directions)" if folded else ""
        say(f"{args.named}: {args.fit} on the MERL grid{note}")
    return {"fit": args.fit, "output": args.named, "mean_of_both_orders": folded}


def compare_command(args: argparse.Namespace) -> dict[str, Any]:
    """BRDF-space measures of B against A, where both have values; A is the reference where a measure has one."""
    from brdfatlas.measures.errors import brdf_errors

    reference, other = (table_of(load(path, args.source), path) for path in (args.a, args.b))
    try:
        measures = brdf_errors(other, np.where(np.isnan(other[..., :1]), np.nan, reference))
    except ValueError as error:
        raise ValueError(f"{args.a}, {args.b}: {error}; compare files that have values in common") from None
    if not args.json:
        for name, value in measures.items():
            say(f"{name:24} {value:.6g}")
    return dict(measures)


def export_command(args: argparse.Namespace) -> dict[str, Any]:
    """Write a fit for another program: a renderer's material, JSON, its sampler, a MERL table."""
    from brdfatlas.export.facts import with_report
    from brdfatlas.export.mitsuba import beside_of
    from brdfatlas.export.targets import export

    beside = beside_of(args.named)
    fitted = with_report(stored_fit(args.fit, args.source), args.fit)
    target = "sampler" if args.sampler else args.to
    if target == "mitsuba" and not args.force:
        check_beside(fitted, beside_of(args.output))
    files = [args.named, beside][: len(export(fitted, target, args.output))]
    if not args.json:
        say(f"{', '.join(map(str, files))}: {args.fit} for {target}")
    return {"fit": args.fit, "output": args.named, "target": target, "files": files}


def check_beside(fitted: Fit, beside: Path) -> None:
    """Refuse to write a fit beside its export over a file that nobody named, unless that holds the same fit."""
    from brdfatlas.export.mitsuba import holds, mitsuba_dict

    if mitsuba_dict(fitted)["type"] == "brdfatlas" and os.path.lexists(beside) and not holds(beside, fitted):
        raise FileFault(
            f"{shown(beside)}: exists and is another file, the fit is written there beside the export; "
            "name another output, or replace it by --force"
        )


def recommend_command(args: argparse.Namespace) -> dict[str, Any]:
    """Fit every model, render small, rank by dE00; with -o write the best fit with its exports and a picture."""
    from brdfatlas.recommend import check_folder, recommend

    models = list(MODELS) if args.models is None else [name.strip() for name in args.models.split(",")]
    if not any(
        allowed(model, target=args.target) and (args.budget is None or model.least_bytes <= args.budget)
        for model in map(MODELS.__getitem__, models)
    ):
        raise ValueError(no_winner(args, models))
    folder = None if args.folder is None else Path(args.folder).absolute()
    measured = read(args.file)
    if args.folder is not None:
        check_folder(args.folder, measured.name, models)

    def progress(line: str) -> None:
        print(shown(line), file=sys.stderr, flush=True)

    found = recommend(
        measured, budget=args.budget, target=args.target, models=models, seed=args.seed, progress=progress
    )
    if not args.json:
        say(*found.table().splitlines())
    if found.winner is None:
        raise ValueError(no_winner(args, models))
    files = [os.path.join(args.folder, path.name) for path in found.save(folder)] if folder else []
    if not args.json:
        if found.winner.de00 > POOR_DE00:
            say(f"dE00 {found.winner.de00:.1f}: none of these models comes close to {found.material}")
        say(f"take {found.winner.model}" + (f": {', '.join(map(str, files))}" if files else "; -o FOLDER writes it"))
    rows = [dataclasses.asdict(row) for row in found.rows]
    return {"material": found.material, "winner": found.winner.model, "models": rows, "files": files}


def no_winner(args: argparse.Namespace, models: Sequence[str]) -> str:
    """What to say where none of ``models`` meets the conditions of `recommend`."""
    limits = [] if args.target is None else [f"exact in {args.target}"]
    limits += [] if args.budget is None else [f"fitted in at most {args.budget:,} bytes"]
    others = []
    for name in MODELS:
        with contextlib.suppress(ImportError):  # another package's model
            able = name not in models and allowed(MODELS[name], budget=args.budget, target=args.target)
            others += [name] if able else []
    remedy = f"models that are: {', '.join(others)}" if others else "relax a condition"
    if not limits:
        return f"{args.file}: none of these models is fitted; the lines above say why"
    return f"{args.file}: none of these models is {' and '.join(limits)}; {remedy}"


def uber_texture_command(args: argparse.Namespace) -> dict[str, Any]:
    """Put the factors of up to 128 fits into one EXR texture for shaders."""
    from brdfatlas.export.uber_texture import build_uber_texture, save_uber_texture

    texture = build_uber_texture([stored_fit(path, args.source) for path in args.fits])
    save_uber_texture(args.output, texture)
    if not args.json:
        say(f"{args.named}: {texture.model} of {len(texture.materials)} materials, a row each")
    return {"model": texture.model, "materials": list(texture.materials), "output": args.named}


def render_command(args: argparse.Namespace) -> dict[str, Any]:
    """Render a file or a fit in a scene."""
    from brdfatlas.rendering.images import save_picture
    from brdfatlas.rendering.jobs import render_file

    check_output(args.named, "picture", scene_files(args.scene, args.scenes), force=True)
    item = load(args.file, args.source)
    if args.reference:
        check_input(args.reference)
    with contextlib.redirect_stdout(sys.stderr):  # OpenEXR prints of a damaged file
        render = render_file(
            item,
            args.scene,
            samples=args.spp,
            size=args.size,
            seed=args.seed,
            scenes=args.scenes,
            integrator=args.integrator,
            variant=args.variant,
            reference=read_aloud(args.reference) if args.reference else None,
        )
    save_picture(args.output, render)
    spp = int(render.meta["samples"])  # a multiple of the batches
    if not args.json:
        say(f"{args.named}: {args.file} in {args.scene}, {args.size} x {args.size}, {spp} samples a pixel")
    return {"output": args.named, "scene": args.scene, "spp": spp, "size": args.size, "seed": args.seed}


def scene_files(scene: str, scenes: str | None) -> list[str]:
    """The file that defines a scene and those that it names: inputs of a render."""
    from brdfatlas.rendering.scenes import read_scenes, scenes_file

    check_input(scenes or str(scenes_file()))
    definition = read_scenes(scenes).get(scene, {"geometry": [], "environment": {}})
    named = [definition["environment"].get("file"), *(shape.get("file") for shape in definition["geometry"])]
    return [str(scenes or scenes_file()), *filter(None, named)]


def load_image(path: str) -> "Render":
    """A render of ours with its batches and mask, or any EXR as one batch whose pixels all count."""
    from brdfatlas.rendering.images import ImageError, Render, load_exr, load_render

    check_input(path)
    try:
        render = load_render(path)
        if render.meta.get("status", "ok") != "ok":
            raise ValueError(f"{path}: the black picture of a fit that failed; compare another")
        return render
    except ImageError:
        mean = load_exr(path)
        return Render(mean, mean[None], np.ones(mean.shape[:2], bool))


def _of_tone_map(args: argparse.Namespace, reference: "Render", key: str, default: float) -> float:
    """A number of the tone map: the command line's, the reference's own, or the default."""
    told = getattr(args, key)
    told = reference.meta.get(key, default) if told is None else told
    with contextlib.suppress(ValueError):
        if 0 < float(told) < math.inf:
            return float(told)
    raise ValueError(f"{args.reference}: its {key} is {told!r:.40}, no number above 0; choose one, --{key}")


def image_errors_command(args: argparse.Namespace) -> dict[str, Any]:
    """Errors of an image against a reference: renders of ours by their batches and mask, other EXRs as they are."""
    from brdfatlas.measures.errors import Tone, image_errors, to_8_bit
    from brdfatlas.rendering.images import tone_map

    with contextlib.redirect_stdout(sys.stderr):  # OpenEXR prints of a damaged file
        reference, image = load_image(args.reference), load_image(args.image)
    scenes = [render.meta.get("scene") for render in (reference, image)]
    if None not in scenes and scenes[0] != scenes[1]:
        shows = f"{args.reference} shows the scene {scenes[0]}, {args.image} shows {scenes[1]}"
        raise ValueError(f"{shows}; compare pictures of one scene")
    shared = len(reference.batches) == len(image.batches) > 1
    if not shared:
        reference, image = (dataclasses.replace(r, batches=r.mean[None]) for r in (reference, image))
    tone = Tone(_of_tone_map(args, reference, "exposure", 1.0), _of_tone_map(args, reference, "gamma", 2.2))
    try:
        errors = image_errors(reference, image, tone, common_numbers=shared)
    except ValueError as error:
        raise ValueError(f"{args.reference}, {args.image}: {error}") from None
    shown_values = {int(v) for r in (reference, image) for v in np.unique(to_8_bit(tone_map(r.mean[r.mask], *tone)))}
    if shown_values in ({0}, {255}):
        fault = f"{'white' if 255 in shown_values else 'black'} all over with exposure {tone.exposure:g}"
        raise ValueError(
            f"{args.reference}, {args.image}: {fault} and gamma {tone.gamma:g}; choose others, --exposure or --gamma"
        )
    # JSON has no infinity: what an infinite standard error says is said in a word.
    bound = bool(np.isfinite(errors["psnr_db"]) and np.isinf(errors["psnr_se_db"]))
    if not args.json:
        for name, value in errors.items():
            say(f"{name:24} {value:.6g}" + ("  (a lower bound)" if bound and name == "psnr_db" else ""))
    return {**errors, "psnr_is_lower_bound": bound, "exposure": tone.exposure, "gamma": tone.gamma}
