"""The grammar of the command line: commands, their arguments, and what is refused before any work."""

import argparse
import math
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NoReturn

import brdfatlas
from brdfatlas.cli.commands import (
    EXPORTS,
    compare_command,
    convert_command,
    export_command,
    fit_command,
    image_errors_command,
    info_command,
    models_command,
    recommend_command,
    render_command,
    standin_command,
    table_command,
    uber_texture_command,
)
from brdfatlas.files import ENDINGS, FileFault, check_output, digits, shown

#: Kinds of output that are text, which `-o -` writes to standard output.
TEXT = ("JSON", "XML", "MaterialX")


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
    fit_of = {"metavar": "FIT", "help": "fit that `brdfatlas fit` wrote, or its JSON"}
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
    add_render(command("render", render_command, ["file", "scenes", "reference"], "picture", source=True))
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
    sub.add_argument(
        "--reference",
        metavar="FILE",
        help="measured file of a fit's material: the fit is drawn with its mask and random numbers, as `recommend` and "
        "a run draw it, to be compared with its picture",
    )
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
