"""Which differences exceed the noise of the renders, for tables and pages alike (docs/errors.md)."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

#: Standard errors of their difference that two values must lie apart.
SIGNIFICANT = 2.0
PICTURE = ["material", "scene"]


@dataclass(frozen=True)
class Ranked:
    """A measure that ranks the models of a picture: its column, that of its standard error, the better direction and
    the value of a perfect fit (None for PSNR, whose perfect value is infinite)."""

    key: str
    error: str
    higher_is_better: bool = False
    perfect: float | None = 0.0

    def margin(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """By how many dB the error of ``a`` is below that of ``b``, elementwise; 0 where both are exact.

        PSNRs are subtracted. Of other measures 20 log10 of the ratio of the distances from the perfect value is
        taken: 2 dB are a fifth of a root mean square error as of a dE00.
        """
        if self.perfect is None:
            return subtract(a, b)
        with np.errstate(divide="ignore", invalid="ignore"):
            return subtract(*(-20 * np.log10(np.abs(np.asarray(x, float) - self.perfect)) for x in (a, b)))


RANKED = {
    measure.key: measure
    for measure in (
        Ranked("de00_mean", "de00_se"),
        Ranked("flip_mean", "flip_se"),
        Ranked("ssim", "ssim_se", True, 1.0),
        Ranked("psnr_db", "psnr_se_db", True, None),
    )
}
#: What ranks unless another is asked for: dE00 can be compared between materials, linear PSNR cannot.
LEADING = "de00_mean"


def significant(
    a: np.ndarray, a_error: np.ndarray, b: np.ndarray, b_error: np.ndarray, joint: np.ndarray | float = np.nan
) -> np.ndarray:
    """Whether values ``a`` and ``b`` differ by more than 2 standard errors of their difference, elementwise.

    ``joint``: that standard error, which models of one picture have of their own because they share random numbers
    (:func:`.errors.material_errors`); where it is NaN the two errors are taken as independent. An infinite error marks
    a lower bound (PSNR, :func:`.errors.linear_errors`): nothing above it differs significantly from it, and
    what lies below does by its own error alone, the bound being 2 standard errors low already. An unknown error (NaN)
    counts as 0.
    """
    a, a_error, b, b_error = (np.asarray(x, float) for x in (a, a_error, b, b_error))
    lower, higher = np.where(a < b, a_error, b_error), np.where(a < b, b_error, a_error)
    known = np.isfinite(lower) & np.isfinite(higher) & np.isfinite(joint)
    lower, higher = np.where(np.isnan(lower), 0, lower), np.where(np.isfinite(higher), higher, 0)
    return np.abs(subtract(a, b)) > SIGNIFICANT * np.where(known, joint, np.hypot(lower, higher))


def subtract(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """a - b; 0 between two equal infinite values, both being exact."""
    with np.errstate(invalid="ignore"):
        return np.where(np.equal(a, b), 0.0, np.subtract(a, b))


def judged(errors: pd.DataFrame, models: Sequence[str], measure: str) -> pd.DataFrame:
    """Rows of ``models`` that have a value of ``measure``."""
    if measure not in errors:
        return errors.iloc[:0].assign(**{measure: 0.0, RANKED[measure].error: 0.0})
    return errors[errors["model"].isin(models) & (errors["status"] == "ok") & errors[measure].notna()]


def joint_errors(pairs: pd.DataFrame | None, measure: str) -> pd.Series:
    """Standard errors of differences by (material, scene, model, other), both orders; empty without ``pairs``."""
    keys = [*PICTURE, "model", "other"]
    if pairs is None or pairs.empty:
        empty = pd.MultiIndex.from_arrays([[], [], [], []], names=keys)
        return pd.Series([], index=empty, dtype=float)
    both = pd.concat([pairs, pairs.rename(columns={"model": "other", "other": "model"})])
    return both.set_index(keys)[RANKED[measure].error]


def best_rows(
    errors: pd.DataFrame, models: Sequence[str], *, measure: str, pairs: pd.DataFrame | None = None
) -> pd.DataFrame:
    """Rows of the models that are best on a picture (material, scene) by ``measure``, a key of :data:`RANKED`: the best
    value, and all statistically indistinguishable from it. ``pairs``: rows of results/errors/*/pairs.tsv."""
    ranked = RANKED[measure]
    rows = judged(errors, models, measure).reset_index(drop=True)
    if rows.empty:
        return rows
    first = rows.groupby(PICTURE)[measure].transform("idxmax" if ranked.higher_is_better else "idxmin").to_numpy()
    value = rows[measure].to_numpy(float)
    error = rows[ranked.error].to_numpy(float) if ranked.error in rows else np.full(len(rows), np.nan)
    asked = pd.MultiIndex.from_arrays(
        [rows["material"], rows["scene"], rows["model"], rows["model"].to_numpy()[first]],
    )
    joint = joint_errors(pairs, measure).reindex(asked).to_numpy(float)
    return rows[~significant(value[first], error[first], value, error, joint)]


def count_missing(errors: pd.DataFrame, models: Sequence[str]) -> dict[str, int]:
    """How many pictures each model lacks of those that any of ``models`` has: means compare only where this is 0."""
    rows = judged(errors, models, "psnr_db")
    pictures = len(rows[PICTURE].drop_duplicates())
    found = rows["model"].value_counts()
    return {model: pictures - int(found.get(model, 0)) for model in models}
