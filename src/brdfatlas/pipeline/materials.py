"""The materials of a run: what is in the folder, what of it can be used, and why the rest is left out."""

import os
import sys
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from brdfatlas.files import read_json
from brdfatlas.formats import read
from brdfatlas.measured import MeasuredError
from brdfatlas.objectives import importance_weight
from brdfatlas.pipeline.configuration import choose
from brdfatlas.pipeline.standins import standin_names
from brdfatlas.settings import NAME, ConfigError

#: Of what :func:`_fault` looks for: verdicts of an older one are not believed.
EDITION = 2


@dataclass(frozen=True)
class Material:
    """A material of the run: where its .binary is (or will be made) and whether it is a stand-in."""

    name: str
    binary: str
    standin: bool


@dataclass(frozen=True)
class LeftOut:
    """A file that cannot be used, with the reason in one line."""

    name: str
    path: str
    reason: str


def find_materials(
    config: Mapping[str, Any], standins_folder: str, checks: str | Path
) -> tuple[list[Material], list[LeftOut], dict[str, dict[str, str]]]:
    """Materials of the run, what is left out of it, and the verdicts on all files.

    MERL files of ``config["merl_folder"]`` if it holds any, else built-in stand-ins, with a line that says so. A file
    is read whole unless ``checks``, the verdicts that a job of an earlier run wrote, know its size and time stamp.
    Nothing is written. ConfigError for an unknown name, for nothing at all to work on, for files that are not quite
    where they are looked for, and under ``strict`` for the first file that cannot be used, and for none.
    """
    folder = Path(config["merl_folder"])
    found = sorted(folder.glob("*.binary")) if folder.is_dir() else []
    # hidden files are unfinished writes, and what other systems leave beside files ("._chrome.binary")
    files = {path.stem: path for path in found if not path.name.startswith(".")}
    wanted = config["materials"]
    if not files:
        _say_standins(folder, config["strict"])
        known = standin_names()
        names = choose(wanted, known, "materials", "config") if wanted != "all" else None
        if names is None:
            names = choose(config["standins"], known, "standins", "config")
        return [Material(name, f"{standins_folder}/{name}.binary", True) for name in names], [], {}
    names = choose(wanted, list(files), "materials", f"config (files in {folder})")
    verdicts = check_files({name: files[name] for name in names}, checks)
    reasons = {name: verdicts[str(files[name])]["reason"] for name in names}
    left_out = [LeftOut(name, str(files[name]), reason) for name, reason in reasons.items() if reason]
    if left_out and config["strict"]:
        raise ConfigError(f"{left_out[0].reason} (strict: true; mend or remove the file, or set strict: false)")
    usable = [Material(name, str(files[name]), False) for name in names if not reasons[name]]
    if not usable:
        raise ConfigError(f"{folder}: no file there can be used: {left_out[0].reason}")
    return usable, left_out, verdicts


def _say_standins(folder: Path, strict: bool) -> None:
    """Say that stand-ins are used; ConfigError where measured files were probably meant."""
    for path in sorted(folder.rglob("*")) if folder.is_dir() else []:
        inside = path.relative_to(folder)
        if path.suffix.lower() == ".binary" and not any(part.startswith(".") for part in inside.parts):
            remedy = f"set merl_folder: {path.parent}" if len(inside.parts) > 1 else "rename it to end in .binary"
            raise ConfigError(f"config: merl_folder: {folder}: no .binary file there, but {path}; {remedy}")
    fault = f"{folder}: no .binary file there"
    if strict:
        remedy = "correct the folder, or set strict: false; `snakemake merl --config strict=False` downloads"
        raise ConfigError(f"config: merl_folder: {fault} (strict: true; {remedy})")
    print(f"{fault}; built-in stand-ins are used", file=sys.stderr)


def check_files(files: Mapping[str, Path], checks: str | Path) -> dict[str, dict[str, str]]:
    """path -> {"stamp": edition, size, time stamp, mode; "reason": "" if the file is good, else why not}."""
    try:
        known = read_json(checks)
    except (OSError, ValueError):
        known = {}

    def verdict(name: str, path: Path) -> dict[str, str]:
        try:
            status = path.stat()
            stamp = f"{EDITION} {status.st_size} {status.st_mtime_ns} {status.st_mode}"
        except OSError:
            stamp = ""
        old = known.get(str(path), {})
        return old if stamp and old.get("stamp") == stamp else {"stamp": stamp, "reason": _fault(name, path)}

    with ThreadPoolExecutor(min(8, os.cpu_count() or 1)) as pool:
        return dict(zip(map(str, files.values()), pool.map(verdict, files, files.values())))


def _fault(name: str, path: Path) -> str:
    if not NAME.match(name):
        return f"{path}: the name may have letters, digits, '.', '_' and '-' only; rename the file"
    try:
        measured = read(path)
    except MeasuredError as error:
        return str(error)
    counted = importance_weight(measured.valid) > 0
    if not counted.any():
        return f"{path}: no valid cell with both directions within 89 degrees of the normal, where fits are judged"
    if not measured.table[counted].any():
        return f"{path}: black, every sample within 89 degrees of the normal is 0"
    return ""
