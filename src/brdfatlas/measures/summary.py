"""One summary of a run: every statistic that pages and PDF print is computed here, once.

One median (of the known values, the mean of the two middle ones), one rounding (``Measure.digits``), one rule for
"best" (:func:`best_of`), one order of the models (:meth:`Summary.order`). Tables over materials lead with ΔE00, which
can be compared between materials; linear PSNR cannot and ranks within a picture.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
import pandas as pd

from brdfatlas.constants import REFERENCE_AGAIN
from brdfatlas.measures.ranking import RANKED, best_rows, count_missing
from brdfatlas.measures.recommendation import Candidate, choose


@dataclass(frozen=True)
class Measure:
    """A column of the error tables: how it is called, its unit, the better direction and the decimals worth printing;
    None where values span decades and significant digits tell more."""

    key: str
    title: str
    unit: str
    higher_is_better: bool
    digits: int | None
    description: str

    @property
    def label(self) -> str:
        return f"{self.title} ({self.unit})" if self.unit else self.title

    def rounded(self, value: float) -> float:
        """The value as a page prints it: what looks alike is alike."""
        if not math.isfinite(value):
            return value
        return round(value, self.digits) if self.digits is not None else float(f"{value:.3g}")


MEASURES = (
    Measure("de00_mean", "ΔE00", "", False, 2, "mean CIEDE2000 colour difference over the material; 1 is just visible"),
    Measure("flip_mean", "FLIP", "", False, 3, "mean of the FLIP difference, made for flipping between pictures"),
    Measure(
        "psnr_db", "PSNR", "dB", True, 1, "10 log10(max² / MSE) of linear RGB over the pixels that the material covers"
    ),
    Measure("psnr_tonemapped_db", "PSNR, tone-mapped", "dB", True, 1, "PSNR of the tone-mapped 8-bit pictures"),
    Measure("de00_p95", "ΔE00, 95 %", "", False, 2, "95th percentile of the CIEDE2000 colour difference"),
    Measure("ssim", "SSIM", "", True, 4, "structural similarity of the tone-mapped pictures"),
    Measure("rmse", "RMSE", "", False, None, "root mean square error of linear RGB"),
    Measure("rel_mse", "relative MSE", "", False, None, "mean squared error relative to the squared reference"),
)
BRDF_MEASURES = (
    Measure(
        "objective_compressive", "compressive objective", "", False, 5, "the weighted objective of Bagher et al. 2016"
    ),
    Measure("loew_e2", "Löw E2", "", False, 5, "mean squared difference of ln(1 + ρ cos θi), Löw et al. 2012"),
    Measure(
        "cosine_weighted", "cosine-weighted", "", False, 5, "root mean square of (ρ − ρ*) cos θi, Ngan et al. 2005"
    ),
    Measure("log_deviation", "log deviation", "", False, 4, "mean |log1p(f cos) − log1p(g cos)| for cosines above 0.1"),
)
#: The measure of headlines, of the default order and of every comparison between materials.
LEADING = MEASURES[0]
PSNR = next(measure for measure in MEASURES if measure.key == "psnr_db")


@dataclass(frozen=True)
class Budget:
    """A column of the recommendation: at most ``bytes`` a fit, or exportable to an engine's own material."""

    key: str
    title: str
    bytes: int | None = None
    engine: bool = False


BUDGETS = (
    Budget("64", "≤ 64 B", 64),
    Budget("1k", "≤ 1 kB", 1000),
    Budget("8k", "≤ 8 kB", 8000),
    Budget("any", "any size"),
    Budget("engine", "an engine can load it", engine=True),
)


class Described(Protocol):
    """What the summary asks of a model's description."""

    status: str
    reciprocal: bool
    targets: tuple[str, ...]


def known(values: Iterable[float | None]) -> list[float]:
    """The values that are numbers."""
    return [float(value) for value in values if value is not None and not math.isnan(float(value))]


def median(values: Iterable[float | None]) -> float:
    """The median of the known values; NaN without any."""
    found = known(values)
    return float(np.median(found)) if found else float("nan")


@dataclass(frozen=True)
class Score:
    """A measure over pictures: ``mean`` with the Monte Carlo standard ``error`` of that mean and the ``count`` of
    pictures; ``median``, ``low`` and ``high`` are over materials, each averaged over its scenes first."""

    mean: float
    error: float
    count: int
    median: float = float("nan")
    low: float = float("nan")
    high: float = float("nan")


NO_SCORE = Score(float("nan"), float("nan"), 0)
Scores = Mapping[str, Mapping[str, Score]]


def score_models(errors: pd.DataFrame) -> dict[str, dict[str, Score]]:
    """model -> measure -> score over all its good pictures. PSNR carries the standard error of the mean; it is infinite
    where a picture has a lower bound only, and so has the mean."""
    good = errors[errors["status"] == "ok"]
    values = {measure.key: good[measure.key].to_numpy(float) for measure in MEASURES if measure.key in good}
    squares = good["psnr_se_db"].to_numpy(float) ** 2 if "psnr_se_db" in good else None
    materials, (numbers, names) = pd.factorize(good["material"])[0], pd.factorize(good["model"])
    found: dict[str, dict[str, Score]] = {str(name): {} for name in names}
    for number, scores in enumerate(found.values()):
        rows = np.flatnonzero(numbers == number)
        for key, column in values.items():
            there = rows[~np.isnan(column[rows])]
            if there.size:
                group = np.unique(materials[there], return_inverse=True)[1]
                means = np.bincount(group, column[there]) / np.bincount(group)
                known = squares is not None and key == "psnr_db"
                error = float(np.sqrt(np.nansum(squares[there]))) / there.size if known else float("nan")
                mean = float(column[there].mean())
                scores[key] = Score(mean, error, there.size, median(means), float(means.min()), float(means.max()))
    return found


def score_of(scores: Scores, model: str, measure: str = LEADING.key) -> Score:
    """The score of a model; nan over 0 pictures where there is none."""
    return scores.get(model, {}).get(measure, NO_SCORE)


def best_of(values: Mapping[str, float | None], measure: Measure) -> list[str]:
    """The names with the best value as it is printed: values that read alike are best together. Empty without any."""
    alive = {name: measure.rounded(float(v)) for name, v in values.items() if v is not None and not math.isnan(v)}
    if not alive:
        return []
    best = (max if measure.higher_is_better else min)(alive.values())
    return [name for name, value in alive.items() if value == best]


def best_by_noise(
    errors: pd.DataFrame, models: Sequence[str], measure: Measure, pairs: pd.DataFrame | None = None
) -> pd.DataFrame:
    """Rows of the models that are best on a picture: all that are statistically indistinguishable from the
    best where the measure has a standard error (``pairs``: those of differences), and all that print like it."""
    good = errors[(errors["status"] == "ok") & errors["model"].isin(list(models))]
    if measure.key not in good or good.empty:
        return good.iloc[:0]
    places = set()
    if measure.key in RANKED:
        keys = ["material", "scene", "model"]
        best = best_rows(errors, list(models), measure=measure.key, pairs=pairs)
        places = set(map(tuple, best[keys].itertuples(index=False)))
    kept = []
    for (material, scene), rows in good.groupby(["material", "scene"], sort=False):
        names = best_of(dict(zip(rows["model"], rows[measure.key], strict=True)), measure)
        kept += [i for i, name in rows["model"].items() if name in names or (material, scene, name) in places]
    return good.loc[kept]


def best_first(values: Mapping[str, float], measure: Measure) -> list[str]:
    """Names by quality; those without a number last, in their own order."""
    sign = -1 if measure.higher_is_better else 1
    return sorted(values, key=lambda name: (math.isnan(values[name]), sign * values[name] if values[name] else 0.0))


def pareto_front(points: Mapping[str, tuple[float, float]], higher_is_better: bool) -> list[str]:
    """Names whose (cost, value) no other point beats in one without being worse in the other, all of equal points; by
    rising cost. Not-a-number points take no part."""
    alive = [
        (cost, value, name) for name, (cost, value) in points.items() if not (math.isnan(cost) or math.isnan(value))
    ]
    sign = -1 if higher_is_better else 1
    front, best = [], (math.nan, math.inf)
    for cost, value, name in sorted(alive, key=lambda item: (item[0], sign * item[1])):
        if sign * value < best[1] or (cost, sign * value) == best:
            best = cost, sign * value
            front.append(name)
    return front


@dataclass(frozen=True)
class Summary:
    """The numbers of a run, or of one material of it.

    ``models``: entry -> its description, in the order of the configuration; ``errors``, ``pairs``: rows of
    results/errors/*/images.tsv and pairs.tsv;
    ``fits``: one row a material and model (status, bytes, seconds, max_albedo and so on); ``classes``: material ->
    its class, in the order of the run.
    """

    models: Mapping[str, Described]
    errors: pd.DataFrame
    fits: pd.DataFrame
    classes: Mapping[str, str]
    pairs: pd.DataFrame | None = None

    @cached_property
    def scores(self) -> dict[str, dict[str, Score]]:
        """Over the whole run."""
        return score_models(self.errors)

    @cached_property
    def by_material(self) -> dict[str, dict[str, dict[str, Score]]]:
        """Over the scenes of each material."""
        groups = {str(name): rows for name, rows in self.errors.groupby("material", sort=False)}
        return {name: score_models(groups[name]) if name in groups else {} for name in self.classes}

    @cached_property
    def missing(self) -> dict[str, int]:
        """Pictures that a model lacks and another has: its means cover fewer and are never compared."""
        return count_missing(self.errors, list(self.models))

    @cached_property
    def missing_in(self) -> dict[str, dict[str, int]]:
        """The same for each material."""
        groups = {str(name): rows for name, rows in self.errors.groupby("material", sort=False)}
        empty = self.errors.iloc[:0]
        return {name: count_missing(groups.get(name, empty), list(self.models)) for name in self.classes}

    @cached_property
    def _fits(self) -> dict[tuple[str, str], Mapping]:
        return {(str(row["material"]), str(row["model"])): row for row in self.fits.to_dict("records")}

    def fit_of(self, material: str, model: str) -> Mapping | None:
        """The row of a fit that did not fail."""
        row = self._fits.get((material, model))
        return row if row is not None and row["status"] == "ok" else None

    def value(self, model: str, measure: Measure = LEADING, material: str | None = None) -> float:
        """What ranks a model: the median over materials, or the mean over the scenes of one material."""
        if material is None:
            return score_of(self.scores, model, measure.key).median
        return score_of(self.by_material[material], model, measure.key).mean

    def pictured(self, model: str) -> list[str]:
        """The materials on which a model has a picture: its median is over these."""
        return [name for name in self.classes if not math.isnan(self.value(model, LEADING, name))]

    def complete(self, material: str | None = None) -> list[str]:
        """The models that have every picture, of the run or of a material."""
        missing = self.missing if material is None else self.missing_in[material]
        return [name for name in self.models if not missing[name] and not math.isnan(self.value(name, PSNR, material))]

    def order(self, measure: Measure = LEADING, material: str | None = None) -> list[str]:
        """All models, best first; those that lack a picture last."""
        ranked = self.complete(material)
        values = {name: self.value(name, measure, material) if name in ranked else float("nan") for name in self.models}
        return best_first(values, measure)

    def best(self, measure: Measure = LEADING, material: str | None = None) -> list[str]:
        """The best models that have every picture, all that print alike."""
        return best_of({name: self.value(name, measure, material) for name in self.complete(material)}, measure)

    def wins(self, measure: Measure = LEADING) -> dict[str, int]:
        """Pictures on which a model is best (:func:`best_by_noise`)."""
        counts = best_by_noise(self.errors, list(self.models), measure, self.pairs)["model"].value_counts()
        return {name: int(counts.get(name, 0)) for name in self.models}

    def cost(self, model: str, key: str, material: str | None = None) -> float:
        """Bytes or seconds of a fit: of one material, else the median over those that have one."""
        names = self.classes if material is None else [material]
        rows = [row for name in names if (row := self.fit_of(name, model)) is not None]
        return median(row[key] for row in rows)

    def front(self, key: str = "bytes", measure: Measure = LEADING, material: str | None = None) -> list[str]:
        """The Pareto-optimal models in cost (``key``) and value, among those with every picture."""
        points = {
            name: (self.cost(name, key, material), self.value(name, measure, material))
            for name in self.complete(material)
        }
        return pareto_front(points, measure.higher_is_better)

    def difficulty(self, measure: Measure = LEADING) -> dict[str, float]:
        """Material -> the median of a measure over the models with every picture of the run."""
        models = self.complete()
        return {name: median(self.value(model, measure, name) for model in models) for name in self.classes}

    def candidate(self, model: str, material: str | None = None, group: Sequence[str] = ()) -> Candidate | None:
        """A model as :func:`.recommendation.choose` sees it: on one material, or on a ``group`` of them (median ΔE00,
        largest size and albedo), where it needs every picture. None where a fit failed."""
        names = [material] if material is not None else list(group)
        rows = [row for name in names if (row := self.fit_of(name, model)) is not None]
        if len(rows) < len(names) or any(self.missing_in[name][model] for name in names):
            return None
        described = self.models[model]
        albedo = [float(row["max_albedo"]) if row["max_albedo"] is not None else math.nan for row in rows]
        return Candidate(
            model,
            median(self.value(model, LEADING, name) for name in names),
            int(max(row["bytes"] for row in rows)),
            median(row["seconds"] for row in rows),
            described.reciprocal,
            math.nan if any(map(math.isnan, albedo)) else max(albedo),
            described.status,
            tuple(described.targets),
        )

    def recommend(self, names: Sequence[str], **switches: bool) -> list[str | None]:
        """The recommended model of each of :data:`BUDGETS` for one material or a group of them; ``switches``:
        reciprocal, published, energy."""
        group = [found for model in self.models if (found := self.candidate(model, group=names)) is not None]
        chosen = []
        for budget in BUDGETS:
            rows = [item for item in group if item.targets] if budget.engine else group
            found = choose(rows, budget=budget.bytes, **switches)
            chosen.append(found.model if found else None)
        return chosen

    def fitting_statistics(self, model: str) -> dict[str, float]:
        """Table I of Bagher et al. 2016: smallest, mean and largest seconds, iterations and golden-section calls of a
        fit, the number of materials with such calls and of materials. NaN where no fit counts them."""
        rows = [row for name in self.classes if (row := self.fit_of(name, model)) is not None]
        found: dict[str, float] = {"materials": len(rows)}
        for key, column in (("seconds", "seconds"), ("iterations", "iterations"), ("golden", "golden_section_calls")):
            values = known(row.get(column) for row in rows)
            for kind, of in (("min", min), ("mean", lambda v: sum(v) / len(v)), ("max", max)):
                found[f"{key}_{kind}"] = float(of(values)) if values else float("nan")
        calls = known(row.get("golden_section_calls") for row in rows)
        return found | {"golden_materials": sum(v > 0 for v in calls) if calls else float("nan")}

    @property
    def noise(self) -> Mapping[str, Score]:
        """Scores of the reference rendered again with other random numbers; empty where it was not rendered."""
        return self.scores.get(REFERENCE_AGAIN, {})
