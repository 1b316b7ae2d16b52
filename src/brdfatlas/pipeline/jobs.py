"""The body of a fit's job."""

import sys
import time
import traceback
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from brdfatlas.constants import ABSENT
from brdfatlas.files import write_json
from brdfatlas.fits import describe_fit, fit
from brdfatlas.formats.reader import read
from brdfatlas.measures.physics import physics_checks
from brdfatlas.models import Entry
from brdfatlas.models.given import why_no_row

#: Faults of the machine, not of the model: they fail the job, and the next run tries again.
MACHINE_FAULTS = (MemoryError, OSError, KeyboardInterrupt)


def fit_job(
    entry: Mapping[str, Any],
    seed: int,
    binary: str,
    standin: bool,
    fit_path: str,
    report_path: str,
) -> None:
    """Fit an entry (``Entry.plain``) to one material and write the fit and its report.

    A model that fails does not stop the run: its report says "failed" and why, its fit file is an empty mark. So does
    an entry of given parameters that has none for this material, which is no failure: its report says "absent". Faults
    of the machine (memory, disk) are raised: the job fails and the next run tries again.
    """
    row = Entry(**entry)
    measured = read(binary, standin=standin)
    start = time.perf_counter()
    absent = row.parameters and why_no_row(row.name, row.parameters, measured.name, standin=measured.standin)
    if absent:
        print(f"{row.name} on {measured.name}: no row, {absent}", file=sys.stderr)
        _write_mark(fit_path)
        labels = {"entry": row.name, "model": row.model, "material": measured.name, "standin": measured.standin}
        write_json(report_path, {"status": ABSENT, "reason": absent, **labels})
        return
    try:
        fitted = fit(row, measured, seed=seed)
        table = fitted.table()
        report = describe_fit(fitted, measured, table) | {"physics": physics_checks(fitted, table)}
        fitted.save(fit_path)
    except MACHINE_FAULTS:
        raise
    except Exception as error:
        traceback.print_exc()
        reason = f"{type(error).__name__}: {error}".splitlines()[0]
        print(f"{row.name} on {measured.name} failed: {reason}", file=sys.stderr)
        report = {
            "status": "failed",
            "reason": reason,
            "entry": row.name,
            "model": row.model,
            "material": measured.name,
            "standin": measured.standin,
            "options": dict(row.options),
            "seed": seed,
            "seconds": time.perf_counter() - start,
            "bytes": row.bytes,
        }
        _write_mark(fit_path)
    write_json(report_path, report)


def _write_mark(fit_path: str) -> None:
    """An empty file where there is no fit."""
    Path(fit_path).parent.mkdir(parents=True, exist_ok=True)
    Path(fit_path).write_bytes(b"")
