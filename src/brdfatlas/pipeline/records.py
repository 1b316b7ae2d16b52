"""What a run records of its materials and of itself: descriptions, versions, verdict."""

import platform
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from brdfatlas import __version__
from brdfatlas.angles import above_horizon
from brdfatlas.constants import ABSENT
from brdfatlas.files import file_digest, read_record, write_json
from brdfatlas.formats.files import name_of
from brdfatlas.formats.reader import read, stored
from brdfatlas.measured import Measured, MeasuredError
from brdfatlas.measures.diffuseness import diffuseness, material_class
from brdfatlas.measures.physics import directional_albedo


def describe_material(measured: Measured) -> dict[str, Any]:
    """What a reader wants to know of a material before its fits; JSON-able."""
    valid = measured.valid
    values = measured.table[valid]
    spread = diffuseness(measured)
    return {
        "name": measured.name,
        "title": measured.name.replace("-", " "),
        "standin": measured.standin,
        "source": "built-in stand-in: median of five published fits" if measured.standin else str(measured.path),
        "kind": measured.kind,
        "format": measured.provenance.format,
        "origin": measured.provenance.source,
        "instrument": measured.provenance.instrument,
        "note": measured.provenance.note,
        "shares": dict(measured.provenance.shares),
        "warnings": list(measured.provenance.warnings),
        "valid_cells": int(valid.sum()),
        "cells_above_horizon": int(above_horizon().sum()),
        "range": [float(values.min()), float(values.max())],
        "median": np.median(values, axis=0),
        "albedo": directional_albedo(measured.evaluate, np.deg2rad(30.0)),
        "albedo_angle_degrees": 30.0,
        "diffuseness": spread,
        "class": material_class(spread),
    }


def read_material_job(source: str, output: str) -> None:
    """Put a file on the grid and keep the result; warnings go to the log and to the terminal.

    Name and path are those of this file, whatever a stored table says that was copied or renamed.
    """
    try:
        measured = read(source)
    except MeasuredError as error:
        raise SystemExit(str(error)) from None
    for warning in measured.provenance.warnings:
        print(f"{source}: {warning}", file=sys.stderr)
    stored.write(output, replace(measured, name=name_of(source), path=Path(source)))


def describe_material_job(binary: str, standin: bool, output: str) -> None:
    """Write the description of one material."""
    measured = read(binary, standin=standin)
    write_json(output, describe_material(measured) | {"sha256": file_digest(measured.path or binary)})


def revision(root: Path) -> str:
    """The git revision of the checkout, with "+" if files differ from it; "unknown" outside git."""

    def git(*arguments: str) -> str:
        done = subprocess.run(["git", "-C", str(root), *arguments], capture_output=True, text=True, timeout=20)
        return done.stdout.strip() if done.returncode == 0 else ""

    try:
        head = git("rev-parse", "--short=12", "HEAD")
        return (head + ("+" if git("status", "--porcelain", "--untracked-files=no") else "")) if head else "unknown"
    except (OSError, subprocess.TimeoutExpired):
        return "unknown"


#: Other packages whose versions a report's numbers depend on.
PACKAGES = (
    "numpy",
    "scipy",
    "numba",
    "pandas",
    "mitsuba",
    "drjit",
    "scikit-image",
    "OpenEXR",
    "snakemake",
)


def versions() -> dict[str, str]:
    """Versions of Python, of this package and of those that make results."""
    ours = {"python": platform.python_version(), "brdfatlas": __version__}
    return ours | {name: version(name) for name in PACKAGES}


def manifest(
    config: Mapping[str, Any],
    models: Mapping[str, Any],
    materials: Mapping[str, str],
    left_out: Sequence[Mapping],
    descriptions: Sequence[str],
    revision: str,
    versions: Mapping[str, str],
) -> dict[str, Any]:
    """Everything that is needed to repeat a run: configuration, seeds, versions, inputs with checksums, revision."""
    keys = ("name", "source", "sha256", "standin")
    described = [read_record(path, *keys) for path in descriptions]
    return {
        "revision": revision,
        "versions": versions,
        "machine": f"{platform.system()} {platform.machine()}",
        "config": config,
        "models": models,
        "inputs": [{key: d[key] for key in keys} for d in described],
        "binaries": materials,
        "left_out": list(left_out),
    }


def failures(reports: Sequence[str]) -> list[str]:
    """One line for each failed fit among report files."""
    found = [read_record(path, "status", "entry", "material", "reason") for path in reports]
    return [f"{r['entry']} on {r['material']}: {r['reason']}" for r in found if r["status"] not in ("ok", ABSENT)]


def check_failures_job(reports: Sequence[str], output: str) -> None:
    """Write the verdict if every fit succeeded; else list the failures and exit with 1, after the report is out."""
    lines = failures(reports)
    if lines:
        raise SystemExit("\n".join([f"{len(lines)} of {len(reports)} fits failed; the report says so:", *lines]))
    Path(output).write_text(f"all {len(reports)} fits succeeded\n", encoding="utf-8")
