"""The command line. Each command is also a Python function of the package; heavy parts are imported when used."""

import argparse
import contextlib
import dataclasses
import errno
import json
import math
import os
import signal
import sys
import tempfile
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

import numpy as np

import brdfatlas
from brdfatlas import interrupts
from brdfatlas.angles import above_horizon
from brdfatlas.files import ENDINGS, FileFault, check_output, check_regular, digits, json_of, plain, shown
from brdfatlas.fits import Fit, fit, is_fit_file, load_fit
from brdfatlas.formats.merl import write_merl
from brdfatlas.formats.reader import read
from brdfatlas.measured import Measured, MeasuredError, fold
from brdfatlas.measures.recommendation import allowed
from brdfatlas.models import MODELS
from brdfatlas.models.base import FitError

if TYPE_CHECKING:
    from brdfatlas.rendering.images import Render

#: Mean dE00 of a render above which a recommendation says that it is a poor one: several times what is just visible.
POOR_DE00 = 5.0
#: What a user can repair: one line on stderr and exit status 1; anything else is our fault and keeps its traceback.
USER_FAULTS = (MeasuredError, FitError, ValueError, KeyError, ImportError, OSError, MemoryError)
#: Kinds of output that are text, which `-o -` writes to standard output.
TEXT = ("JSON", "XML", "MaterialX")
#: Targets of `export` with the kind of file that each is.
EXPORTS = {
    "json": "JSON",
    "sampler": "JSON",
    "mitsuba": "XML",
    "materialx": "MaterialX",
    "gltf": "glTF",
    "merl": "MERL table",
}
#: Exit status of a shell for a command that SIGPIPE ended; for another signal it is 128 and its number, too.
BROKEN_PIPE = 141


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
    return load_fit(path, source) if is_fit_file(path) else read_aloud(path)


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
    from brdfatlas.export.fit_json import import_json
    from brdfatlas.pipeline.records import describe_material

    check_input(args.file)
    if is_fit_file(args.file):
        return fit_info(args, load_fit(args.file, args.source))
    if os.path.exists(args.file) and json_of(args.file) == "fit":
        return fit_info(args, import_json(args.file, args.source))
    described = describe_material(read_aloud(args.file))
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

    check_input(args.file)
    item = load_fit(args.file, args.source) if is_fit_file(args.file) else read_aloud(args.file)
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
    fitted = load_fit(args.fit, args.source)
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
    fitted = with_report(load_fit(args.fit, args.source), args.fit)
    target = "sampler" if args.sampler else args.to
    if target == "mitsuba" and not args.force:
        check_beside(fitted, beside_of(args.output))
    files = [args.named, beside][: len(export(fitted, target, args.output))]
    if not args.json:
        say(f"{', '.join(map(str, files))}: {args.fit} for {target}")
    return {"fit": args.fit, "output": args.named, "target": target, "files": files}


def check_beside(fitted: Fit, beside: Path) -> None:
    """Refuse to write a fit beside its export over a file that nobody named, unless that holds the same fit."""
    from brdfatlas.export.mitsuba import mitsuba_dict

    if mitsuba_dict(fitted)["type"] == "brdfatlas" and os.path.lexists(beside):
        with contextlib.suppress(ValueError):
            if load_fit(beside, fitted.source) == fitted:
                return
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

    texture = build_uber_texture([load_fit(path, args.source) for path in args.fits])
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
    tone = Tone(
        float(reference.meta.get("exposure", 1.0)) if args.exposure is None else args.exposure,
        float(reference.meta.get("gamma", 2.2)) if args.gamma is None else args.gamma,
    )
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


class Parser(argparse.ArgumentParser):
    """An argument parser whose errors are one line, and whose options stand once."""

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        self.register("action", None, Once)

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"{self.prog}: {shown(message)}; see {self.prog} --help\n")


class Once(argparse._StoreAction):
    """An option that stands once: of two values one would be lost silently."""

    def __call__(self, parser: Any, namespace: Any, values: Any, option_string: str | None = None) -> None:
        if option_string:
            given = namespace.__dict__.setdefault("_given", set())
            if self.dest in given:
                raise argparse.ArgumentError(self, "stands twice; leave one out")
            given.add(self.dest)
        super().__call__(parser, namespace, values, option_string)


class Defaults(argparse.ArgumentDefaultsHelpFormatter):
    """Help with the default of every option that has one."""

    def _get_help_string(self, action: argparse.Action) -> str | None:
        return action.help if action.default in (None, False, []) else super()._get_help_string(action)


def whole(low: int, high: int) -> Callable[[str], int]:
    """A type of argument: a whole number of ``low`` to ``high``."""

    def parse(text: str) -> int:
        try:
            value = int(digits(text))
        except ValueError:
            value = low - 1
        if not low <= value <= high:
            raise argparse.ArgumentTypeError(f"{text[:40]!r} is not a whole number of {low} to {high}")
        return value

    return parse


def number(low: float, high: float) -> Callable[[str], float]:
    """A type of argument: a number of ``low`` to ``high``."""

    def parse(text: str) -> float:
        try:
            value = float(digits(text))
        except ValueError:
            value = math.nan
        if not low <= value <= high:
            raise argparse.ArgumentTypeError(f"{text[:40]!r} is not a number of {low:g} to {high:g}")
        return value

    return parse


def add_command(
    commands: Any, name: str, function: Callable, reads: Sequence[str] = (), writes: str = "", source: bool = False
) -> argparse.ArgumentParser:
    """A command; ``reads`` names its arguments that are inputs, ``writes`` is the kind of its output (ENDINGS)."""
    sub = commands.add_parser(name, help=function.__doc__, description=function.__doc__, formatter_class=Defaults)
    sub.set_defaults(function=function, reads=(*reads, "source"), writes=writes)
    sub.add_argument("--json", action="store_true", help="print the result as JSON")
    if writes:
        ways = f"{' or '.join(ENDINGS[writes])}{', - for standard output' if writes in TEXT else ''}"
        sub.add_argument("-o", "--output", required=name != "standin", metavar="OUT", help=f"file to write: {ways}")
        sub.add_argument("--force", action="store_true", help="replace an existing file that brdfatlas did not write")
    if source:
        sub.add_argument("--source", metavar="FILE.py", help="file with a model of your own; a fit remembers it")
    return sub


def parser() -> argparse.ArgumentParser:
    """The command line's grammar."""
    top = Parser(prog="brdfatlas", description="Reflectance models fitted to measured reflectance.")
    top.add_argument("--version", action="version", version=brdfatlas.__version__)
    commands = top.add_subparsers(dest="command", required=True, metavar="COMMAND")

    command = partial(add_command, commands)
    command("models", models_command)
    sub = command("info", info_command, ["file"], source=True)
    sub.add_argument("file", metavar="FILE", help="measured file or fit")
    sub = command("convert", convert_command, ["file", "like"], "table", source=True)
    sub.add_argument("file", metavar="FILE", help="measured file or fit")
    sub = sub.add_mutually_exclusive_group()
    sub.add_argument("--like", metavar="FILE", help="of a .csv: the directions of this table or spectral text")
    sub.add_argument(
        "--step",
        type=number(1.0, 30.0),  # a smaller step makes a larger table than is read, a larger one fewer pairs
        help="of a .csv: degrees between directions of a regular table, 1 to 30, else 10",
    )
    sub = command("standin", standin_command, writes="MERL table")
    sub.add_argument("material", nargs="?", help="name of a material of the MERL database")
    sub.add_argument("--list", action="store_true", help="list the materials that have a stand-in")
    sub = command("fit", fit_command, ["file"], "fit", source=True)
    sub.add_argument("model", help="name of the model; `brdfatlas models` lists them")
    sub.add_argument("file", metavar="FILE", help="measured file, of any format")
    sub.add_argument("--seed", type=whole(0, 2**32 - 1), default=0, help="of the random numbers of the fit")
    sub.add_argument("--option", action="append", default=[], metavar="KEY=VALUE", help="an option of the model")
    fit_of = {"metavar": "FIT", "help": "fit that `brdfatlas fit` wrote"}
    command("table", table_command, ["fit"], "MERL table", source=True).add_argument("fit", **fit_of)
    sub = command("export", export_command, ["fit"], "JSON", source=True)
    sub.add_argument("fit", **fit_of)
    sub = sub.add_mutually_exclusive_group()
    sub.add_argument("--to", metavar="TARGET", default="json", choices=list(EXPORTS), help=", ".join(EXPORTS))
    sub.add_argument("--sampler", action="store_true", help="the same as --to sampler")
    sub = command("recommend", recommend_command, ["file"])
    sub.add_argument("file", metavar="FILE", help="measured file")
    sub.add_argument("--budget", type=whole(1, 2**40), metavar="BYTES", help="largest size of a fit")
    sub.add_argument(
        "--for",
        dest="target",
        choices=("mitsuba", "materialx", "gltf"),
        help="only models that this material is exactly",
    )
    sub.add_argument("--models", metavar="NAME,...", help="only these; else all")
    sub.add_argument("-o", "--folder", metavar="FOLDER", help="folder for the best fit, its exports and a picture")
    sub.add_argument("--seed", type=whole(0, 2**32 - 1), default=0, help="of the random numbers")
    sub = command("uber-texture", uber_texture_command, ["fits"], "EXR picture", source=True)
    sub.add_argument("fits", metavar="FIT", nargs="+", help="fits of one model, one a material, at most 128")
    sub = command("compare", compare_command, ["a", "b"], source=True)
    sub.add_argument("a", metavar="A", help="measured file or fit, the reference")
    sub.add_argument("b", metavar="B", help="measured file or fit")
    add_render(command("render", render_command, ["file", "scenes"], "picture", source=True))
    sub = command("image-errors", image_errors_command, ["reference", "image"])
    sub.add_argument("reference", metavar="REFERENCE.exr", help="picture that is right")
    sub.add_argument("image", metavar="IMAGE.exr", help="picture to judge")
    sub.add_argument("--exposure", type=number(1e-6, 1e6), help="of the tone map; else the reference's own, else 1")
    sub.add_argument("--gamma", type=number(0.1, 10.0), help="of the tone map; else the reference's own, else 2.2")
    return top


def add_render(sub: argparse.ArgumentParser) -> None:
    """The arguments of `render`."""
    sub.add_argument("file", metavar="FILE_OR_FIT", help="measured file or fit")
    sub.add_argument("--scene", default="studio_sphere", help="name of a scene")
    sub.add_argument(
        "--spp", type=whole(8, 2**20), default=64, help="samples a pixel, at least one in each of 8 batches"
    )
    sub.add_argument("--size", type=whole(1, 4096), default=256, help="width and height in pixels")
    sub.add_argument("--seed", type=whole(0, 2**32 - 1), default=1, help="of the random numbers of the render")
    sub.add_argument("--scenes", metavar="FILE.yaml", help="file that defines the scene, else the built-in scenes")
    sub.add_argument("--integrator", choices=("direct", "path"), default="direct", help="path: by stock Mitsuba")
    sub.add_argument("--variant", default="llvm_ad_rgb", help="Mitsuba variant")


def check_arguments(args: argparse.Namespace) -> None:
    """Refuse an output that would destroy an input or a file of another kind."""
    output = getattr(args, "output", None)
    given = [getattr(args, name, None) for name in args.reads]
    inputs = [path for value in given for path in ([value] if isinstance(value, str) else value or [])]
    if args.command == "export":
        args.writes = EXPORTS["sampler" if args.sampler else args.to]
    if "" in [output, *inputs]:
        raise FileFault("'': an empty name of a file; is a variable of the shell not set?")
    if output == "-" and (args.writes not in TEXT or args.json):
        fault = "the result is printed there" if args.json else f"{args.writes} is no text"
        raise FileFault(f"-o -: standard output cannot be the file, {fault}; name a file")
    if output and output != "-":
        check_output(output, args.writes, inputs, force=args.force)
        args.named, args.output = output, str(Path(output).absolute())  # a model's own code may leave the folder


def run(args: argparse.Namespace) -> None:
    """Run a command and print what it has to say; with ``-o -`` print the file that it would write."""
    check_arguments(args)
    if getattr(args, "output", None) != "-":
        # with --json the result alone is printed: not what a model prints
        with contextlib.redirect_stdout(sys.stderr if args.json else sys.stdout):
            result = args.function(args)
        if args.json:
            emit(json.dumps(plain(result), indent=1, ensure_ascii=False) + "\n")
    else:
        with interrupts.unwound(), tempfile.TemporaryDirectory() as folder:
            args.named = args.output = os.path.join(folder, "out" + ENDINGS[args.writes][0])
            args.json = True
            with contextlib.redirect_stdout(sys.stderr):
                args.function(args)
            if len(os.listdir(folder)) > 1:
                raise FileFault("-o -: this fit is written beside its export, in a file of its own; name a file")
            emit(Path(args.output).read_text(encoding="utf-8"))
    emit("", flush=True)


def reason(error: BaseException) -> str:
    """An error in one line."""
    if isinstance(error, MemoryError):
        return "not enough memory; take a smaller size, or close other programs"
    if isinstance(error, KeyError) and error.args:
        return shown(error.args[0])
    if isinstance(error, OSError) and error.errno in (errno.EMFILE, errno.ENFILE):
        return f"{error.strerror}; allow more, `ulimit -n 256`, or close other programs"
    if isinstance(error, OSError) and error.strerror and error.filename:
        return f"{shown(error.filename)}: {error.strerror}"
    if isinstance(error, FileNotFoundError) and not error.filename:
        return "the working folder is gone; change to one that exists"
    return shown(" ".join(str(error).split("\n")).strip() or type(error).__name__)


def _open_streams() -> None:
    """Standard streams that the caller has closed lead nowhere. Without them the next file to be opened would have the
    number of one, and get what libraries print."""
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            number = os.open(os.devnull, os.O_RDWR)  # the lowest that is free: the stream's own
            setattr(sys, name, os.fdopen(number, mode, closefd=False))


def main(argv: Sequence[str] | None = None) -> int:
    """Entry point; exit status 0, or 1 after one line that says what is wrong; 128 + n where signal n ended it."""
    _open_streams()
    with contextlib.suppress(AttributeError):
        sys.stdout.reconfigure(errors="backslashreplace")  # names of files that are no text in this locale
    try:
        interrupts.as_exceptions()
        args = parser().parse_args(argv)
        run(args)
    except BrokenPipeError:  # `| head` has read enough
        return BROKEN_PIPE
    except BaseException as error:
        number = interrupts.received or (signal.SIGINT if isinstance(error, KeyboardInterrupt) else 0)
        if number:
            with contextlib.suppress(OSError):  # of a terminal that was closed
                print("brdfatlas: interrupted, nothing was written", file=sys.stderr)
            return 128 + number
        if isinstance(error, Exception | SystemExit) and not isinstance(error, USER_FAULTS):
            raise
        kind = "" if isinstance(error, USER_FAULTS) else f"{type(error).__name__}: "  # a model's own
        print(f"brdfatlas {args.command}: {kind}{reason(error)}", file=sys.stderr)
        return 1
    finally:
        interrupts.at_once()
    return 0


if __name__ == "__main__":
    sys.exit(main())
