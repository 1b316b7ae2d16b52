"""The body of a fit's job."""

import sys
import time
import traceback
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from brdfatlas.files import write_json
from brdfatlas.fits import describe_fit, fit
from brdfatlas.formats.reader import read
from brdfatlas.measures.physics import physics_checks
from brdfatlas.models import Entry
from brdfatlas.models.base import FitError
from brdfatlas.models.given import has_row

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

    A model that fails does not stop the run: its report says "failed" and why, its fit file is an empty mark. So it is
    with given parameters that the material does not have; their report says "absent", which is no fault. Faults of the
    machine (memory, disk) are raised: the job fails and the next run tries again.
    """
    row = Entry(**entry)
    measured = read(binary, standin=standin)
    status, start = "failed", time.perf_counter()
    try:
        missing = has_row(row.name, row.parameters, measured.name, standin=standin) if row.parameters else ""
        if missing:
            status = "absent"
            raise FitError(missing)
        fitted = fit(row, measured, seed=seed)
        table = fitted.table()
        report = describe_fit(fitted, measured, table) | {"physics": physics_checks(fitted, table)}
        fitted.save(fit_path)
    except MACHINE_FAULTS:
        raise
    except Exception as error:
        traceback.print_exc()
        reason = f"{type(error).__name__}: {error}".splitlines()[0] if status == "failed" else str(error)
        print(f"{row.name} on {measured.name} {status}: {reason}", file=sys.stderr)
        report = {
            "status": status,
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
        Path(fit_path).parent.mkdir(parents=True, exist_ok=True)
        Path(fit_path).write_bytes(b"")
    write_json(report_path, report)
