"""The body of a job that fits the models of one paper to one material."""

import os
import sys
import time
import traceback
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from brdfatlas.constants import ABSENT
from brdfatlas.files import digest_of, file_digest, fingerprint, read_record, write_json, write_made
from brdfatlas.fits import describe_fit, fit, load_reported
from brdfatlas.formats.reader import read
from brdfatlas.measured import Measured
from brdfatlas.measures.physics import physics_checks
from brdfatlas.models import Entry
from brdfatlas.models.given import why_no_row

#: Faults of the machine, not of the model: they fail the job, and the next run tries again.
MACHINE_FAULTS = (MemoryError, OSError, KeyboardInterrupt)


def fit_job(
    entries: Sequence[Mapping[str, Any]],
    seed: int,
    binary: str,
    standin: bool,
    outputs: Mapping[str, tuple[str, str]],
    provenance: Mapping[str, str],
    made: str,
) -> None:
    """Fit entries (``Entry.plain``) to one material and write each one's fit and report, ``outputs``: name -> (fit,
    report), and at the end the fits' checksums to ``made``. A fit whose fingerprint is still right is kept;
    ``provenance``: name -> what its code is made of (:func:`brdfatlas.pipeline.provenance.provenance`).

    A model that fails does not stop the run: its report says "failed" and why, its fit file is an empty mark. So does
    an entry of given parameters that has none for this material, which is no failure: its report says "absent". Faults
    of the machine (memory, disk) are raised: the job fails and the next run tries again.
    """
    measured = read(binary, standin=standin)
    content = [digest_of(measured.table), measured.name, standin, seed]
    checksums = {}
    for entry in entries:
        row = Entry(**entry)
        fit_path, report_path = outputs[row.name]
        given = file_digest(row.parameters) if row.parameters else ""
        right = fingerprint(*content, row.plain, given, provenance[row.name])
        report = _kept(fit_path, report_path, right, row.name, measured.name)
        if report:
            print(f"{fit_path}: kept")
        else:
            print(f"fitting {row.name} to {measured.name}")  # the run's progress names it where the process ends here
            Path(report_path).unlink(missing_ok=True)  # code of others that ends the process leaves no report
            report = _report_of(row, measured, seed, fit_path)
            write_json(report_path, report | {"fingerprint": right})
            print(f"{fit_path}: {report['status']}")
        checksums[row.name] = report.get("sha256", report["status"])
    write_made(made, checksums)


def _kept(fit_path: str, report_path: str, right: str, entry: str, material: str) -> Mapping[str, Any]:
    """The report of a fit, empty unless both are there, whole and still right, by their fingerprint; they then get a
    fresh time stamp. A fit that failed is tried again."""
    try:
        report = read_record(report_path, "status", "fingerprint", "sha256")
        if report["status"] != "ok" or report["fingerprint"] != right:
            return {}
        load_reported(fit_path, report, entry, material)
    except (OSError, ValueError):
        return {}
    for path in (fit_path, report_path):
        os.utime(path)
    return report


def _report_of(row: Entry, measured: Measured, seed: int, fit_path: str) -> dict[str, Any]:
    """Fit one entry, write its fit and return its report."""
    labels = {"entry": row.name, "model": row.model, "material": measured.name, "standin": measured.standin}
    absent = row.parameters and why_no_row(row.name, row.parameters, measured.name, standin=measured.standin)
    if absent:
        print(f"{row.name} on {measured.name}: no row, {absent}", file=sys.stderr)
        _write_mark(fit_path)
        return {"status": ABSENT, "reason": absent, **labels}
    start = time.perf_counter()
    try:
        fitted = fit(row, measured, seed=seed)
        table = fitted.table()
        report = describe_fit(fitted, measured, table) | {"physics": physics_checks(fitted, table)}
        fitted.save(fit_path)
        return report | {"sha256": file_digest(fit_path)}
    except MACHINE_FAULTS:
        raise
    except Exception as error:
        traceback.print_exc()
        where = f"{row.name} on {measured.name}"
        reason = f"{type(error).__name__}: {str(error).removeprefix(f'{where}: ')}".splitlines()[0]
        print(f"{where} failed: {reason}", file=sys.stderr)
        _write_mark(fit_path)
        told = {"options": dict(row.options), "seed": seed, "seconds": time.perf_counter() - start, "bytes": row.bytes}
        return {"status": "failed", "reason": reason, **labels, **told}


def _write_mark(fit_path: str) -> None:
    """An empty file where there is no fit."""
    Path(fit_path).parent.mkdir(parents=True, exist_ok=True)
    Path(fit_path).write_bytes(b"")
