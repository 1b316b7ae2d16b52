"""Which PSNRs the noise of the renders tells apart: for tables and pages alike (docs/errors.md, Ranking)."""

from collections.abc import Sequence

import numpy as np
import pandas as pd

#: Joint standard errors that two PSNRs must lie apart.
TOLD_APART = 2.0
PICTURE = ["material", "scene"]


def told_apart(a: np.ndarray, a_error: np.ndarray, b: np.ndarray, b_error: np.ndarray) -> np.ndarray:
    """Whether PSNRs ``a`` and ``b`` (dB) differ by more than 2 joint standard errors, elementwise.

    The errors are taken as independent; fits share random numbers, so this is conservative. An infinite error marks
    a lower bound (:func:`.errors.linear_errors`): nothing above it is told apart from it, and what lies below
    is so by its own error alone, the bound being 2 standard errors low already. An unknown error (NaN) counts as 0.
    """
    a, a_error, b, b_error = (np.asarray(x, float) for x in (a, a_error, b, b_error))
    lower, higher = np.where(a < b, a_error, b_error), np.where(a < b, b_error, a_error)
    lower, higher = np.where(np.isnan(lower), 0, lower), np.where(np.isfinite(higher), higher, 0)
    return np.abs(subtract(a, b)) > TOLD_APART * np.hypot(lower, higher)


def subtract(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """a - b in dB; 0 between two infinite PSNRs, both being exact."""
    with np.errstate(invalid="ignore"):
        return np.where(a == b, 0.0, a - b)


def judged(errors: pd.DataFrame, models: Sequence[str]) -> pd.DataFrame:
    """Rows of ``models`` that have a PSNR."""
    if "psnr_db" not in errors:
        return errors.iloc[:0].assign(psnr_db=0.0, psnr_se_db=0.0)
    return errors[errors["model"].isin(models) & (errors["status"] == "ok") & errors["psnr_db"].notna()]


def best_rows(errors: pd.DataFrame, models: Sequence[str]) -> pd.DataFrame:
    """Rows of the models that are best on a picture (material, scene): the highest PSNR, and all not told apart from
    it."""
    rows = judged(errors, models).reset_index(drop=True)
    if rows.empty:
        return rows
    first = rows.groupby(PICTURE)["psnr_db"].transform("idxmax").to_numpy()
    psnr, error = rows["psnr_db"].to_numpy(float), rows["psnr_se_db"].to_numpy(float)
    return rows[~told_apart(psnr[first], error[first], psnr, error)]


def count_missing(errors: pd.DataFrame, models: Sequence[str]) -> dict[str, int]:
    """How many pictures each model lacks of those that any of ``models`` has: means compare only where this is 0."""
    rows = judged(errors, models)
    pictures = len(rows[PICTURE].drop_duplicates())
    found = rows["model"].value_counts()
    return {model: pictures - int(found.get(model, 0)) for model in models}
