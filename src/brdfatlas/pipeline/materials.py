"""The materials of a run: what is in the folder, what of it can be used, and why the rest is left out."""

import os
import sys
from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from brdfatlas.angles import GRID_SHAPE
from brdfatlas.constants import LONGEST_NAME, NAME
from brdfatlas.files import read_json, stamps
from brdfatlas.formats.files import name_of
from brdfatlas.formats.reader import ENDINGS, check, format_of, merl
from brdfatlas.measured import MeasuredError
from brdfatlas.objectives import importance_weight
from brdfatlas.pipeline.configuration import choose, time_fault
from brdfatlas.pipeline.standins import standin_names
from brdfatlas.settings import ConfigError

#: Of what :func:`_fault` looks for: verdicts of an older one are not believed.
EDITION = 4
#: Where measurements are looked for if the configuration names no other folder.
MEASURED_FOLDER, MERL_FOLDER = "data/measured", "data/merl"
#: Names that pages, folders and rules of the run have; a material cannot.
RESERVED = frozenset(
    {"ablation", "assets", "checks", "compare", "index", "model", "models", "reference", "reference_again", "run"}
    | {"scenes", "standings", "summary", "supplement", "tables", "viewer"}
)


@dataclass(frozen=True)
class Material:
    """A material of the run: the file that jobs read (it is there or will be made), whether it is a stand-in, and the
    file of another format from which ``binary`` is made, "" where there is none."""

    name: str
    binary: str
    standin: bool
    source: str = ""


@dataclass(frozen=True)
class LeftOut:
    """A file that cannot be used, with the reason in one line."""

    name: str
    path: str
    reason: str


def folders_of(config: Mapping[str, Any]) -> list[Path]:
    """Where the run's files are: ``measured_folder`` if it is set, else ``merl_folder`` if that is not the default,
    else both default folders together."""
    if config["measured_folder"]:
        return [Path(config["measured_folder"])]
    if Path(config["merl_folder"]) != Path(MERL_FOLDER):
        return [Path(config["merl_folder"])]
    return [Path(MEASURED_FOLDER), Path(MERL_FOLDER)]


def shown(path: str | Path) -> str:
    """A path as one printable line, whatever bytes its name has."""
    text = os.fsencode(path).decode("utf-8", "backslashreplace")
    return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in text)


def _files(folders: list[Path]) -> dict[str, Path]:
    """name -> file of everything that is a measurement by its content, or by its ending claims to be one.

    ConfigError for two files of one name, or of names that a system which takes no heed of case would confuse.
    """
    files: dict[str, Path] = {}
    taken: dict[str, Path] = {}
    for path in (path for folder in folders if folder.is_dir() for path in sorted(folder.iterdir())):
        # hidden files are unfinished writes, and what other systems leave beside files ("._chrome.binary")
        if path.name.startswith(".") or not (path.suffix.lower() in ENDINGS or _is_measurement(path)):
            continue
        name = name_of(path)
        other = taken.setdefault(name.casefold(), path)
        if other != path:
            raise ConfigError(
                f"{shown(other)} and {shown(path)} would both be the material {shown(name)!r}; rename one of them"
            )
        files[name] = path
    return files


def _is_measurement(path: Path) -> bool:
    try:
        return format_of(path) is not None
    except MeasuredError:
        return False


def find_materials(
    config: Mapping[str, Any], standins_folder: str, checks: str | Path, tables_folder: str = "results/measured"
) -> tuple[list[Material], list[LeftOut], dict[str, dict[str, str]]]:
    """Materials of the run, what is left out of it, and the verdicts on all files.

    Every file of measured reflectance in :func:`folders_of`, told by its content, else built-in stand-ins, with a line
    that says so. Files that are no MERL files will be put on the grid once, in ``tables_folder``. A file is read unless
    ``checks``, the verdicts that a job of an earlier run wrote, know its size and time stamp. Nothing is written.
    ConfigError for an unknown name, for two files of one name, for nothing at all to work on, for files that are not
    quite where they are looked for, and under ``strict`` for the first file that cannot be used, and for none.
    """
    folders = folders_of(config)
    files = _files(folders)
    wanted = config["materials"]
    if not files:
        _say_standins(folders, config["strict"])
        known = standin_names()
        names = choose(wanted, known, "materials", "config") if wanted != "all" else None
        if names is None:
            names = choose(config["standins"], known, "standins", "config")
        return [Material(name, f"{standins_folder}/{name}.binary", True) for name in names], [], {}
    place = " and ".join(str(folder) for folder in folders)
    names = choose(wanted, list(files), "materials", f"config (files in {place})")
    verdicts = check_files({name: files[name] for name in names}, checks)
    reasons = {name: verdicts[shown(files[name])]["reason"] for name in names}
    left_out = [LeftOut(shown(name), shown(files[name]), reason) for name, reason in reasons.items() if reason]
    if left_out and config["strict"]:
        raise ConfigError(f"{left_out[0].reason} (strict: true; repair or remove the file, or set strict: false)")
    usable = [_material(name, files[name], tables_folder) for name in names if not reasons[name]]
    if not usable:
        raise ConfigError(f"{place}: no file there can be used: {left_out[0].reason}")
    return usable, left_out, verdicts


def _material(name: str, path: Path, tables_folder: str) -> Material:
    if format_of(path) is merl:
        return Material(name, str(path), False)
    return Material(name, f"{tables_folder}/{name}.measured", False, str(path))


def _say_standins(folders: list[Path], strict: bool) -> None:
    """Say that stand-ins are used; ConfigError where measured files were probably meant."""
    for folder in folders:
        for path in _below(folder):
            if path.suffix.lower() in ENDINGS and _is_measurement(path):
                raise ConfigError(
                    f"config: measured_folder: {folder}: no measurement there, but {shown(path)}; "
                    f"set measured_folder: {shown(path.parent)}"
                )
    gone = len(folders) == 1 and not folders[0].is_dir()
    fault = f"{' and '.join(map(str, folders))}: {'no such folder' if gone else 'no measurement there'}"
    if strict:
        remedy = "correct the folder, or set strict: false; `snakemake rgl --config strict=False` downloads some"
        raise ConfigError(f"config: measured_folder: {fault} (strict: true; {remedy})")
    print(f"{fault}; built-in stand-ins are used", file=sys.stderr)


def _below(folder: Path, depth: int = 2) -> Iterator[Path]:
    """Files in a folder and so many levels below it; nothing hidden, behind a link, or that cannot be listed."""
    for place, folders, names in os.walk(folder):
        level = len(Path(place).relative_to(folder).parts)
        folders[:] = sorted(name for name in folders if level < depth and not name.startswith("."))
        yield from (Path(place, name) for name in sorted(names) if not name.startswith("."))


def check_files(files: Mapping[str, Path], checks: str | Path) -> dict[str, dict[str, str]]:
    """path -> {"stamp": edition, mode, stamp of the file; "reason": "" if the file is good, else why not}."""
    try:
        known = {path: {key: old[key] for key in ("stamp", "reason")} for path, old in read_json(checks).items()}
    except (OSError, ValueError, AttributeError, KeyError, TypeError):  # none yet, or not what a run writes
        known = {}

    def verdict(name: str, path: Path) -> dict[str, str]:
        try:
            stamp = f"{EDITION} {path.stat().st_mode} {stamps([path])[str(path)]}"
        except OSError:
            stamp = ""
        fault = time_fault(path)
        if fault:  # time heals it: not to be remembered
            return {"stamp": "", "reason": f"{shown(path)}: {fault}"}
        old = known.get(shown(path), {})
        return old if stamp and old.get("stamp") == stamp else {"stamp": stamp, "reason": _fault(name, path)}

    with ThreadPoolExecutor(min(8, os.cpu_count() or 1)) as pool:
        return dict(zip(map(shown, files.values()), pool.map(verdict, files, files.values())))


def name_fault(name: str) -> str:
    """What is wrong with a material's name, which becomes folders, wildcards and addresses; "" if nothing."""
    if not NAME.match(name):
        return "the name may have letters, digits, '.', '_' and '-' only, and begins with one of the first two"
    if len(name) > LONGEST_NAME:
        return f"the name has {len(name)} characters, {LONGEST_NAME} are the most"
    if not any(c.isalpha() for c in name):
        return "the name needs a letter"
    if name.lower() in RESERVED or name.startswith("model-") or name.lower().endswith((".brdf", ".html", ".")):
        return f"{name!r} is a name that the run uses itself"
    return ""


@cache
def _judged() -> np.ndarray:
    """Cells by which fits are judged where they were measured; bool of GRID_SHAPE."""
    return importance_weight(np.ones(GRID_SHAPE, bool)) > 0


def _fault(name: str, path: Path) -> str:
    fault = name_fault(name)
    if fault:
        return f"{shown(path)}: {fault}; rename the file"
    try:
        if format_of(path) is not merl:
            check(path)
            return ""
        table = merl.load(path)[0]
    except MeasuredError as error:
        return str(error)
    counted = _judged() & ~np.isnan(table[..., 0])
    if not counted.any():
        return f"{path}: no valid cell with both directions within 89 degrees of the normal, where fits are judged"
    if not any((counted & (channel > 0)).any() for channel in np.moveaxis(table, -1, 0)):
        return f"{path}: black, every sample within 89 degrees of the normal is 0"
    return ""
