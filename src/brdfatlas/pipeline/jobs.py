"""The body of a fit's job."""

import sys
import time
import traceback
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from brdfatlas.files import write_json
from brdfatlas.fits import Fit, fit
from brdfatlas.measured import Measured, read_merl
from brdfatlas.measures.physics import physics_checks
from brdfatlas.models import MODELS
from brdfatlas.models.base import FitError

#: Faults of the machine, not of the model: they fail the job, and the next run tries again.
MACHINE_FAULTS = (MemoryError, OSError, KeyboardInterrupt)


def describe_fit(fitted: Fit, measured: Measured) -> dict[str, Any]:
    """The report of a fit with its physics checks and those parameters that a person can read; JSON-able.

    FitError if the fit has no finite value where the material has one: no picture and no error could be made of it.
    """
    table = fitted.table()
    bad = int((~np.isfinite(table[measured.valid]).all(-1)).sum())
    if bad:
        raise FitError(f"{fitted.model} on {fitted.material}: NaN or Inf at {bad:,} measured cells")
    small = {name: array for name, array in fitted.parameters.items() if array.size <= 24}
    return {
        "status": "ok",
        "reason": "",
        "model": fitted.model,
        "material": fitted.material,
        "standin": fitted.standin,
        "options": dict(fitted.options),
        **fitted.report,
        "physics": physics_checks(fitted, table),
        "parameters": small,
    }


def fit_job(
    model: str,
    source: str | None,
    options: Mapping[str, Any],
    seed: int,
    binary: str,
    standin: bool,
    fit_path: str,
    report_path: str,
) -> None:
    """Fit one model to one material and write the fit and its report.

    A model that fails does not stop the run: its report says "failed" and why, its fit file is an empty mark. Faults
    of the machine (memory, disk) are raised: the job fails and the next run tries again.
    """
    if source:
        MODELS.register_file(model, source)
    measured = read_merl(binary, standin=standin)
    start = time.perf_counter()
    try:
        fitted = fit(model, measured, seed=seed, **options)
        report = describe_fit(fitted, measured)
        fitted.save(fit_path)
    except MACHINE_FAULTS:
        raise
    except Exception as error:
        traceback.print_exc()
        reason = f"{type(error).__name__}: {error}".splitlines()[0]
        print(f"{model} on {measured.name} failed: {reason}", file=sys.stderr)
        report = {
            "status": "failed",
            "reason": reason,
            "model": model,
            "material": measured.name,
            "standin": measured.standin,
            "options": dict(options),
            "seed": seed,
            "seconds": time.perf_counter() - start,
            "bytes": MODELS[model].bytes,
        }
        Path(fit_path).parent.mkdir(parents=True, exist_ok=True)
        Path(fit_path).write_bytes(b"")
    write_json(report_path, report)
