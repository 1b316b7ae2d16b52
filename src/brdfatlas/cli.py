"""The command line. Each command is also a Python function of the package; heavy parts are imported when used."""

import argparse
import dataclasses
import json
import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

import brdfatlas
from brdfatlas.fits import Fit, fit, is_fit_file, load_fit
from brdfatlas.measured import Measured, MeasuredError, read_merl, write_merl
from brdfatlas.models import MODELS
from brdfatlas.models.base import FitError

if TYPE_CHECKING:
    from brdfatlas.rendering.images import Render

#: What a user can mend: one line on stderr and exit status 1; anything else is our fault and keeps its traceback.
USER_FAULTS = (MeasuredError, FitError, ValueError, KeyError, ImportError, OSError)


def load(path: str, source: str | None = None) -> Measured | Fit:
    """A .binary or a fit, whatever the file is; ``source``: the file of a fit's model where it has moved."""
    return load_fit(path, source) if is_fit_file(path) else read_merl(path)


def table_of(item: Measured | Fit) -> np.ndarray:
    """Its values on the MERL grid, NaN where there are none."""
    return item.table() if isinstance(item, Fit) else item.table


def models_command(args: argparse.Namespace) -> dict[str, Any]:
    """Every model: name, paper, free parameters, bytes."""
    listed = {}
    for name in MODELS:
        model = MODELS[name]
        listed[name] = {
            "title": model.title,
            "paper": model.paper.short,
            "doi": model.paper.doi,
            "status": model.status,
            "free_parameters": model.free_parameters,
            "bytes": model.bytes,
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
        print(f"{'name':18} {'paper':26} {'numbers':>8} {'bytes':>8}")
        for name, m in listed.items():
            note = f"  ({m['status'].split(':')[0]})" if m["status"] else ""
            print(f"{name:18} {m['paper']:26} {m['free_parameters']:8,} {m['bytes']:8,}{note}")
    return listed


def info_command(args: argparse.Namespace) -> dict[str, Any]:
    """Valid cells, range, albedo of a file; or what is wrong with it (exit status 1)."""
    from brdfatlas.pipeline.records import describe_material

    described = describe_material(read_merl(args.file))
    if not args.json:
        low, high = described["range"]
        note = " (a stand-in)" if described["standin"] else ""
        albedo = ", ".join(f"{value:.4f}" for value in described["albedo"])
        print(
            f"{args.file}{note}: {described['valid_cells']:,} of {described['cells_above_horizon']:,} cells above the "
            f"horizon are valid\nrange {low:.6g} to {high:.6g} 1/sr\nalbedo at 30 degrees (rgb) {albedo}\n"
            f"class {described['class']} (diffuseness {described['diffuseness']:.4g})"
        )
    return described


def standin_command(args: argparse.Namespace) -> dict[str, Any]:
    """Write a built-in material in MERL format: the median of published fits, not a measurement."""
    from brdfatlas.pipeline.standins import write_standin

    write_standin(args.material, args.output)
    if not args.json:
        print(f"{args.output}: stand-in for {args.material}, the median of five published fits, not a measurement")
    return {"material": args.material, "output": args.output, "standin": True}


def parse_options(items: Sequence[str]) -> dict[str, Any]:
    """KEY=VALUE pairs; a value is JSON where it parses as JSON, else text."""
    options: dict[str, Any] = {}
    for item in items:
        key, separator, value = item.partition("=")
        if not separator:
            raise ValueError(f"--option {item}: expected KEY=VALUE")
        try:
            options[key] = json.loads(value)
        except json.JSONDecodeError:
            options[key] = value
    return options


def fit_command(args: argparse.Namespace) -> dict[str, Any]:
    """Fit a model to a file and save the fit."""
    if args.source:
        MODELS.register_file(args.model, args.source)
    options = MODELS[args.model].check_options(parse_options(args.option))
    fitted = fit(args.model, read_merl(args.file), seed=args.seed, **options)
    fitted.save(args.output)
    report = {"model": fitted.entry, "material": fitted.material, "output": args.output, **fitted.report}
    if not args.json:
        state = "converged" if report["converged"] else f"did not converge ({report['message']})"
        print(
            f"{args.output}: {report['objective_name']} {report['objective']:.6g} after {report['iterations']} "
            f"iterations in {report['seconds']:.2f} s, {state}, {report['bytes']:,} bytes"
        )
    return report


def table_command(args: argparse.Namespace) -> dict[str, Any]:
    """Put a fit on the MERL grid, for any MERL reader."""
    fitted = load_fit(args.fit, args.source)
    write_merl(args.output, fitted.table(), standin=fitted.standin)
    if not args.json:
        print(f"{args.output}: {args.fit} on the MERL grid")
    return {"fit": args.fit, "output": args.output}


def compare_command(args: argparse.Namespace) -> dict[str, Any]:
    """BRDF-space measures of B against A, where both have values; A is the reference where a measure has one."""
    from brdfatlas.measures.errors import brdf_errors

    reference, other = (table_of(load(path, args.source)) for path in (args.a, args.b))
    measures = brdf_errors(other, np.where(np.isnan(other[..., :1]), np.nan, reference))
    if not args.json:
        for name, value in measures.items():
            print(f"{name:24} {value:.6g}")
    return dict(measures)


def export_command(args: argparse.Namespace) -> dict[str, Any]:
    """Write a fit for another program: a renderer's material, JSON, its sampler, a MERL table."""
    from brdfatlas.export.facts import with_report
    from brdfatlas.export.targets import export

    fitted = with_report(load_fit(args.fit, args.source), args.fit)
    target = "sampler" if args.sampler else args.to
    files = export(fitted, target, args.output)
    if not args.json:
        print(f"{', '.join(map(str, files))}: {args.fit} for {target}")
    return {"fit": args.fit, "output": args.output, "target": target, "files": files}


def uber_texture_command(args: argparse.Namespace) -> dict[str, Any]:
    """Put the factors of up to 128 fits into one EXR texture for shaders."""
    from brdfatlas.export.uber_texture import build_uber_texture, save_uber_texture

    texture = build_uber_texture([load_fit(path, args.source) for path in args.fits])
    save_uber_texture(args.output, texture)
    if not args.json:
        print(f"{args.output}: {texture.model} of {len(texture.materials)} materials, a row each")
    return {"model": texture.model, "materials": list(texture.materials), "output": args.output}


def render_command(args: argparse.Namespace) -> dict[str, Any]:
    """Render a file or a fit in a scene."""
    from brdfatlas.rendering.images import save_render
    from brdfatlas.rendering.jobs import render_file

    render = render_file(
        args.file,
        args.scene,
        samples=args.spp,
        size=args.size,
        seed=args.seed,
        scenes=args.scenes,
        integrator=args.integrator,
        variant=args.variant,
    )
    save_render(args.output, render)
    if not args.json:
        print(f"{args.output}: {args.file} in {args.scene}, {args.size} x {args.size}, {args.spp} samples a pixel")
    return {"output": args.output, "scene": args.scene, "spp": args.spp, "size": args.size, "seed": args.seed}


def load_image(path: str) -> "Render":
    """A render of ours with its batches and mask, or any EXR as one batch whose pixels all count."""
    from brdfatlas.rendering.images import ImageError, Render, load_exr, load_render

    try:
        return load_render(path)
    except ImageError:
        mean = load_exr(path)
        return Render(mean, mean[None], np.ones(mean.shape[:2], bool))


def image_errors_command(args: argparse.Namespace) -> dict[str, Any]:
    """Errors of an image against a reference: renders of ours by their batches and mask, other EXRs as they are."""
    from brdfatlas.measures.errors import Tone, image_errors

    reference, image = load_image(args.reference), load_image(args.image)
    shared = len(reference.batches) == len(image.batches) > 1
    if not shared:
        reference, image = (dataclasses.replace(r, batches=r.mean[None]) for r in (reference, image))
    tone = Tone(
        float(reference.meta.get("exposure", 1.0)) if args.exposure is None else args.exposure,
        float(reference.meta.get("gamma", 2.2)) if args.gamma is None else args.gamma,
    )
    errors = image_errors(reference, image, tone, common_numbers=shared)
    # JSON has no infinity: what an infinite standard error says is said in a word.
    bound = bool(np.isfinite(errors["psnr_db"]) and np.isinf(errors["psnr_se_db"]))
    if not args.json:
        for name, value in errors.items():
            print(f"{name:24} {value:.6g}" + ("  (a lower bound)" if bound and name == "psnr_db" else ""))
    return {**errors, "psnr_is_lower_bound": bound, "exposure": tone.exposure, "gamma": tone.gamma}


def parser() -> argparse.ArgumentParser:
    """The command line's grammar."""
    top = argparse.ArgumentParser(prog="brdfatlas", description="Reflectance models fitted to measured reflectance.")
    top.add_argument("--version", action="version", version=brdfatlas.__version__)
    commands = top.add_subparsers(dest="command", required=True, metavar="COMMAND")

    def command(name: str, function, output: bool = False) -> argparse.ArgumentParser:
        sub = commands.add_parser(name, help=function.__doc__, description=function.__doc__)
        sub.set_defaults(function=function)
        sub.add_argument("--json", action="store_true", help="print JSON")
        if output:
            sub.add_argument("-o", "--output", required=True, metavar="OUT")
        return sub

    def own_model(sub: argparse.ArgumentParser) -> None:
        sub.add_argument("--source", metavar="FILE.py", help="file with a model of your own; a fit remembers it")

    command("models", models_command)
    command("info", info_command).add_argument("file", metavar="FILE.binary")
    command("standin", standin_command, output=True).add_argument("material")
    sub = command("fit", fit_command, output=True)
    sub.add_argument("model")
    sub.add_argument("file", metavar="FILE.binary")
    sub.add_argument("--seed", type=int, default=0)
    sub.add_argument("--option", action="append", default=[], metavar="KEY=VALUE", help="an option of the model")
    own_model(sub)
    sub = command("table", table_command, output=True)
    sub.add_argument("fit", metavar="FIT")
    own_model(sub)
    sub = command("export", export_command, output=True)
    sub.add_argument("fit", metavar="FIT")
    sub.add_argument("--to", metavar="TARGET", default="json", help="mitsuba, materialx, gltf, json, sampler or merl")
    sub.add_argument("--sampler", action="store_true", help="the same as --to sampler")
    own_model(sub)
    sub = command("uber-texture", uber_texture_command, output=True)
    sub.add_argument("fits", metavar="FIT", nargs="+")
    own_model(sub)
    sub = command("compare", compare_command)
    sub.add_argument("a", metavar="A")
    sub.add_argument("b", metavar="B")
    own_model(sub)
    sub = command("render", render_command, output=True)
    sub.add_argument("file", metavar="FILE_OR_FIT")
    sub.add_argument("--scene", default="studio_sphere")
    sub.add_argument("--spp", type=int, default=64)
    sub.add_argument("--size", type=int, default=256)
    sub.add_argument("--seed", type=int, default=1)
    sub.add_argument("--scenes", metavar="FILE.yaml", help="file that defines the scene, else the built-in scenes")
    sub.add_argument("--integrator", choices=("direct", "path"), default="direct", help="path: by stock Mitsuba")
    sub.add_argument("--variant", default="llvm_ad_rgb", help="Mitsuba variant")
    sub = command("image-errors", image_errors_command)
    sub.add_argument("reference", metavar="REFERENCE.exr")
    sub.add_argument("image", metavar="IMAGE.exr")
    sub.add_argument("--exposure", type=float, help="of the tone map; else the reference's own, else 1")
    sub.add_argument("--gamma", type=float, help="of the tone map; else the reference's own, else 2.2")
    return top


def main(argv: Sequence[str] | None = None) -> int:
    """Entry point; exit status 0, or 1 after one line that says what is wrong."""
    args = parser().parse_args(argv)
    try:
        result = args.function(args)
    except USER_FAULTS as error:
        message = str(error.args[0] if isinstance(error, KeyError) and error.args else error)
        print(f"brdfatlas {args.command}: {(message or type(error).__name__).splitlines()[0]}", file=sys.stderr)
        return 1
    if args.json:
        from brdfatlas.files import plain

        print(json.dumps(plain(result), indent=1, ensure_ascii=False))
    return 0


if __name__ == "__main__":
    sys.exit(main())
