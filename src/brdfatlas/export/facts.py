"""What every exported material says of itself, whatever its format."""

import os
import sys
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from brdfatlas.files import file_digest, read_record, shown
from brdfatlas.fits import Fit, report_faults


class ExportError(ValueError):
    """A fit that cannot be written to a target; the message is one line that says why and what can."""


def check_ranges(fit: Fit) -> None:
    """ExportError for a parameter that is not finite or outside its range, as a file written by hand may hold."""
    parameters = {parameter.name: parameter for parameter in fit.instance.parameters_of(fit.options)}
    for name, parameter in parameters.items():
        if name not in fit.parameters:
            raise ExportError(f"{fit.entry} of {fit.material}: no parameter {name}")
        values = np.asarray(fit.parameters[name], float)
        inside = (values >= _below(parameter.low)) & (values <= _above(parameter.high))
        if not (np.isfinite(values) & inside).all():
            raise ExportError(
                f"{fit.entry} of {fit.material}: {name} = {values.tolist()} is outside its "
                f"range {parameter.low:g} to {parameter.high:g}"
            )


def _below(low: float) -> float:
    """The end of a range as float32 may hold it."""
    return np.nextafter(np.float32(low), np.float32(-np.inf)) if np.isfinite(low) else low


def _above(high: float) -> float:
    return np.nextafter(np.float32(high), np.float32(np.inf)) if np.isfinite(high) else high


def facts(fit: Fit, more: Mapping[str, Any] | None = None) -> dict[str, str]:
    """Source material, model, error, conventions, version, as words: key -> text. ``more`` adds, such as a dE00."""
    import brdfatlas

    model = fit.instance
    error = "not stored with the fit"
    if fit.report.get("objective") is not None:
        error = f"{fit.report['objective']:.6g} ({fit.report['objective_name']})"
    told = {
        "material": fit.material + (" (a stand-in, not a measurement)" if fit.standin else ""),
        "model": f"{fit.entry}: {model.title_of(fit.options)} ({model.paper.short})",
        "error": error,
        "colour space": "linear Rec. 709 (sRGB primaries), no transfer curve",
        "scale": "as measured: BRDF in 1/sr, no exposure applied",
        "written by": f"brdfatlas {brdfatlas.__version__}",
    }
    if fit.report.get("message"):
        told["note"] = str(fit.report["message"])
    return told | {key: str(value) for key, value in (more or {}).items()}


def with_report(fit: Fit, path: str | os.PathLike) -> Fit:
    """The fit with the report that a run wrote beside its file (.json), if there is one: how good it is.

    A report of another fit, or one that no run wrote, is left aside with a line on stderr.
    """
    beside = Path(path).with_suffix(".json")
    if fit.report or not beside.is_file():
        return fit
    try:
        report = read_record(beside, "objective_name")
    except ValueError:
        return fit  # another program's file of that name
    faults = [f"its {key} is another" for key in ("material", "entry", "model") if report.get(key) != getattr(fit, key)]
    faults += report_faults(report)
    if "sha256" in report and report["sha256"] != file_digest(path):
        faults.append("it is about another file")
    if faults:
        print(f"{shown(beside)}: not the report of {shown(path)} ({faults[0]}); the error is left out", file=sys.stderr)
        return fit
    return replace(fit, report=report)
