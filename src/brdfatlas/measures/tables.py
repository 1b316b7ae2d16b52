"""Tables over a whole run: means and medians per model, wins and ties, our figures beside published ones.

All are pure functions of the tidy tables of :mod:`brdfatlas.measures.errors` and of the descriptions of the materials.
"""

import os
from collections.abc import Iterable, Sequence
from itertools import permutations
from pathlib import Path

import numpy as np
import pandas as pd

from brdfatlas.constants import REFERENCE_AGAIN
from brdfatlas.files import read_json
from brdfatlas.measured import RECONSTRUCTED
from brdfatlas.measures.errors import BRDF_MEASURES, IMAGE_MEASURES, PAIR_ERRORS
from brdfatlas.measures.ranking import (
    LEADING,
    PICTURE,
    RANKED,
    count_missing,
    joint_errors,
    judged,
    significant,
    subtract,
)
from brdfatlas.measures.tsv import read_tsv, write_tsv
from brdfatlas.models.published import published_means, published_names, published_psnr

CLASSES = ("all", "diffuse", "glossy", "specular")
#: Two renders whose errors differ by no more are a tie (Bagher et al. 2016, section 6, for PSNR).
TIE_DB = 2.0
#: Column of a summary -> that of the materials it counts.
KINDS = {"standins": "standin", "reconstructions": "reconstructed"}
AVERAGED = tuple(name for name in IMAGE_MEASURES if name not in PAIR_ERRORS)
BAGHER2016 = "Bagher et al. 2016"
BILGILI2011 = "Bilgili et al. 2011"


def read_classes(descriptions: Iterable[str | os.PathLike]) -> pd.DataFrame:
    """material, class, standin, reconstructed from files results/materials/{material}.json."""
    facts = [read_json(path) for path in descriptions]
    rows = [(item["name"], item["class"], bool(item["standin"]), item.get("kind") == RECONSTRUCTED) for item in facts]
    return pd.DataFrame(rows, columns=["material", "class", "standin", "reconstructed"])


def _order(models: Iterable[str], wanted: Sequence[str]) -> list[str]:
    present = set(models)
    return [name for name in [*wanted, REFERENCE_AGAIN] if name in present]


def _groups(table: pd.DataFrame, classes: Sequence[str] = CLASSES) -> Iterable[tuple[str, pd.DataFrame]]:
    """(class, its rows), "all" first; classes without a row are left out."""
    for name in classes:
        part = table if name == "all" else table[table["class"] == name]
        if len(part):
            yield name, part


def summarise(errors: pd.DataFrame, classes: pd.DataFrame, models: Sequence[str]) -> pd.DataFrame:
    """Mean and median of every image measure per model, for each class of material and each scene and over all; dE00
    first. Linear PSNR cannot be compared between materials: over several, its median is what to read.

    Columns: model, class, scene ("all" or a name), materials and how many of them are standins (built in, whatever
    became of their renders) or reconstructions (no measurements either), count (renders that could be judged), failed,
    missing (renders that another model has and this one lacks: its means are over fewer), bounds (PSNRs that are lower
    bounds, the error being below the noise), then {measure}_mean and {measure}_median. One infinite PSNR makes a mean
    infinite; the median stands beside it.
    """
    table = errors.merge(classes, on="material", how="left", validate="many_to_one")
    rows = []
    scenes = ["all", *dict.fromkeys(table["scene"])]
    order = _order(table["model"], models)
    for class_name, members in _groups(table):
        for scene in scenes if len(scenes) > 2 else scenes[:1]:
            pictures = members if scene == "all" else members[members["scene"] == scene]
            missing = count_missing(pictures, [name for name in order if name != REFERENCE_AGAIN])
            for model in order:
                part = pictures[pictures["model"] == model]
                if part.empty:
                    continue
                good, materials = part[part["status"] == "ok"], part.drop_duplicates("material")
                row: dict[str, object] = {"model": model, "class": class_name, "scene": scene}
                row |= {"materials": len(materials), **_kinds(materials)}
                row |= {"count": len(good), "failed": len(part) - len(good), "missing": missing.get(model, 0)}
                row["bounds"] = int(np.isinf(good["psnr_se_db"]).sum())
                for measure in AVERAGED:
                    row[f"{measure}_mean"], row[f"{measure}_median"] = good[measure].mean(), good[measure].median()
                rows.append(row)
    return pd.DataFrame(sorted(rows, key=lambda row: order.index(row["model"])))


def summarise_brdf(brdf: pd.DataFrame, classes: pd.DataFrame, models: Sequence[str]) -> pd.DataFrame:
    """Mean and median of the BRDF-space measures per model and class: model, class, count, failed, then measures."""
    table = brdf.merge(classes, on="material", how="left", validate="many_to_one")
    rows = []
    for model in _order(table["model"], models):
        for class_name, part in _groups(table[table["model"] == model]):
            good = part[part[BRDF_MEASURES[0]].notna()]
            row: dict[str, object] = {"model": model, "class": class_name, "count": len(good)}
            row["failed"] = len(part) - len(good)
            for measure in BRDF_MEASURES:
                row[f"{measure}_mean"], row[f"{measure}_median"] = good[measure].mean(), good[measure].median()
            rows.append(row)
    return pd.DataFrame(rows)


def count_wins(
    errors: pd.DataFrame,
    classes: pd.DataFrame,
    models: Sequence[str],
    *,
    measure: str = LEADING,
    pairs: pd.DataFrame | None = None,
    tie_db: float = TIE_DB,
) -> pd.DataFrame:
    """Wins, ties and losses in a measure of every model against every other, per class, as in Bagher et al. 2016.

    Columns: measure, model, other, class, count, wins, ties, losses, materials, mean_difference, se_difference. A
    render counts where both models have one; an error more than ``tie_db`` below the other's
    (:meth:`.ranking.Ranked.margin`) wins if the two differ significantly (:func:`.ranking.significant`, by the standard
    errors of their differences in ``pairs``). The mean difference (model minus other, in the measure's unit) is over
    materials, each averaged over its scenes first, with the standard error of that mean by the spread over materials;
    in PSNR a difference to a lower bound below counts as 0, and it is infinite where one PSNR is.
    """
    ranked, joint = RANKED[measure], joint_errors(pairs, measure)
    good = judged(errors, models, measure).merge(classes, on="material", how="left", validate="many_to_one")
    rows = []
    for class_name, members in _groups(good):
        values, errors_of = (
            members.pivot(index=PICTURE, columns="model", values=column) for column in (measure, ranked.error)
        )
        present = [model for model in models if model in values]
        for model, other in permutations(present, 2):
            both = values[[model, other]].notna().all(axis=1)
            a, b = values.loc[both, model].to_numpy(), values.loc[both, other].to_numpy()
            a_error, b_error = errors_of.loc[both, model].to_numpy(), errors_of.loc[both, other].to_numpy()
            asked = pd.MultiIndex.from_tuples([(*picture, model, other) for picture in values.index[both]])
            own = joint.reindex(asked).to_numpy() if len(joint) and len(asked) else np.nan
            apart, margin = significant(a, a_error, b, b_error, own), ranked.margin(a, b)
            difference = subtract(a, b)
            bounded = np.isinf(np.where(a < b, a_error, b_error))
            margin, difference = np.where(bounded, 0.0, margin), np.where(bounded, 0.0, difference)
            wins, losses = int((apart & (margin > tie_db)).sum()), int((apart & (margin < -tie_db)).sum())
            materials = values.index[both].get_level_values("material")
            row = (measure, model, other, class_name, len(a), wins, len(a) - wins - losses, losses)
            rows.append((*row, *_over_materials(difference, materials)))
    columns = ["measure", "model", "other", "class", "count", "wins", "ties", "losses"]
    return pd.DataFrame(rows, columns=[*columns, "materials", "mean_difference", "se_difference"])


def _over_materials(values: np.ndarray, materials: pd.Index) -> tuple[int, float, float]:
    """(materials, mean of their means, its standard error by their spread; NaN for one material alone)."""
    means = pd.Series(values).groupby(np.asarray(materials)).mean().to_numpy()
    count = len(means)
    if count == 0:
        return 0, float("nan"), float("nan")
    mean = float(means.mean())
    spread = float(means.std(ddof=1) / np.sqrt(count)) if count > 1 and np.isfinite(mean) else float("nan")
    return count, mean, spread


def beside_published(errors: pd.DataFrame, classes: pd.DataFrame, models: Sequence[str]) -> pd.DataFrame:
    """Our mean PSNR beside each published one, with a note of what differs.

    Columns: model, source, published_db, published_count (materials), ours_db (linear PSNR), ours_tonemapped_db,
    ours_count (materials), note. Bagher et al. 2016 give means over 100 materials and four scenes: ours is the mean of
    this run. Bilgili et al. 2011 give one PSNR a material: both sides are means over the materials that are in
    this run and in their tables. PSNRs of different papers cannot be compared with each other.
    """
    good = errors[errors["status"] == "ok"].merge(classes, on="material", how="left", validate="many_to_one")
    scenes = len(set(errors["scene"]))
    means = pd.DataFrame(published_means())
    means = means[(means["quantity"] == "psnr_mean") & means["source"].str.startswith("Bagher")]
    theirs = {name: published_psnr(name) for name in sorted(set(good["material"]) & set(published_names()))}
    rows = []
    for model in models:
        part = good[good["model"] == model]
        if part.empty:
            continue
        data = _data_note(part)
        for item in means[means["model"] == model].itertuples():
            note = (
                f"published: 100 measured materials, four scenes with real environments, 4 to 500 thousand samples a "
                f"pixel, the authors' fits; ours: {data}, {_plural(scenes, 'scene')} generated by this project"
            )
            rows.append((model, BAGHER2016, item.value, item.materials, *_ours(part), note))
        values = {name: psnr[model] for name, psnr in theirs.items() if model in psnr}
        part = part[part["material"].isin(values)]
        if len(part):
            note = (
                f"published: scene, range and foreground not stated, the authors' fits; ours: {_data_note(part)}, "
                f"{_plural(scenes, 'scene')} generated by this project, linear PSNR over the material's pixels; "
                f"same materials on both sides"
            )
            published = float(np.mean([values[name] for name in sorted(set(part["material"]))]))
            rows.append((model, BILGILI2011, published, part["material"].nunique(), *_ours(part), note))
    columns = [
        "model",
        "source",
        "published_db",
        "published_count",
        "ours_db",
        "ours_tonemapped_db",
        "ours_count",
        "note",
    ]
    return pd.DataFrame(rows, columns=columns)


def _ours(part: pd.DataFrame) -> tuple[float, float, int]:
    return float(part["psnr_db"].mean()), float(part["psnr_tonemapped_db"].mean()), int(part["material"].nunique())


def _plural(count: int, noun: str) -> str:
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"


def _data_note(part: pd.DataFrame) -> str:
    materials = part.drop_duplicates("material")
    kinds = _kinds(materials)
    if kinds["standins"] == len(materials):
        return f"{_plural(len(materials), 'built-in stand-in')} (no measurements)"
    told = _plural(len(materials), "material")
    told += f", {kinds['standins']} of them built-in stand-ins" if kinds["standins"] else ""
    return told + (f", {kinds['reconstructions']} of them reconstructed" if kinds["reconstructions"] else "")


def _kinds(materials: pd.DataFrame) -> dict[str, int]:
    """How many of the materials are no measurements: standins, and reconstructions."""
    return {kind: int(materials[column].sum()) for kind, column in KINDS.items()}


def write_tables(
    errors: Sequence[str | os.PathLike],
    brdf: Sequence[str | os.PathLike],
    descriptions: Sequence[str | os.PathLike],
    models: Sequence[str],
    folder: str | os.PathLike,
    pairs: Sequence[str | os.PathLike] = (),
) -> None:
    """Write errors.tsv and brdf.tsv (all rows), summary.tsv, summary_brdf.tsv, wins.tsv and published.tsv."""
    folder = Path(folder)
    all_errors, all_brdf, classes = read_tsv(errors), read_tsv(brdf), read_classes(descriptions)
    words = classes.assign(**{c: classes[c].map({True: "yes", False: "no"}) for c in KINDS.values()})
    write_tsv(folder / "errors.tsv", all_errors.merge(words, on="material", how="left"))
    write_tsv(folder / "brdf.tsv", all_brdf.merge(words, on="material", how="left"))
    write_tsv(folder / "summary.tsv", summarise(all_errors, classes, models))
    write_tsv(folder / "summary_brdf.tsv", summarise_brdf(all_brdf, classes, models))
    joint = read_tsv(pairs) if len(pairs) else None
    duels = [count_wins(all_errors, classes, models, measure=measure, pairs=joint) for measure in RANKED]
    write_tsv(folder / "wins.tsv", pd.concat(duels, ignore_index=True))
    write_tsv(folder / "published.tsv", beside_published(all_errors, classes, models))
