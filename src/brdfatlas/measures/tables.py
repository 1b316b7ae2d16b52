"""Tables over a whole run: means and medians per model, wins and ties, our figures beside published ones.

All are pure functions of the tidy tables of :mod:`brdfatlas.measures.errors` and of the descriptions of the materials.
"""

import os
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from brdfatlas.constants import REFERENCE_AGAIN
from brdfatlas.files import read_record
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
from brdfatlas.measures.tsv import BRDF, ERRORS, PAIRS, read_tsv, write_tsv
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
    facts = [read_record(path, "name", "class", "standin") for path in descriptions]
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
    columns = ["measure", "model", "other", "class", "count", "wins", "ties", "losses"]
    columns += ["materials", "mean_difference", "se_difference"]
    parts = []
    for class_name, members in _groups(good):
        values, errors_of = (
            members.pivot(index=PICTURE, columns="model", values=column) for column in (measure, ranked.error)
        )
        present = [model for model in models if model in values]
        # model and other along the last two axes
        a, b = np.broadcast_arrays(*_beside(values[present].to_numpy(float)))
        a_error, b_error = np.broadcast_arrays(*_beside(errors_of[present].to_numpy(float)))
        both = ~(np.isnan(a) | np.isnan(b))
        own = _joint_table(joint, values.index, present)
        apart, margin, difference = significant(a, a_error, b, b_error, own), ranked.margin(a, b), subtract(a, b)
        bounded = np.isinf(np.where(a < b, a_error, b_error))
        margin, difference = np.where(bounded, 0.0, margin), np.where(bounded, 0.0, difference)
        count, wins, losses = (
            np.sum(both & chosen, 0) for chosen in (True, apart & (margin > tie_db), apart & (margin < -tie_db))
        )
        spread = _over_materials(np.where(both, difference, 0.0), both, values.index.get_level_values("material"))
        i, j = np.nonzero(~np.eye(len(present), dtype=bool))
        names, counted = (
            np.array(present, object),
            zip(columns[4:], (count, wins, count - wins - losses, losses, *spread)),
        )
        named = {"measure": measure, "model": names[i], "other": names[j], "class": class_name}
        parts.append(pd.DataFrame(named | {column: table[i, j] for column, table in counted}))
    return pd.concat(parts, ignore_index=True) if parts else pd.DataFrame(columns=columns)


def _beside(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(pictures, models) as the first and as the second of every pair of models."""
    return values[:, :, None], values[:, None, :]


def _joint_table(joint: pd.Series, pictures: pd.MultiIndex, models: Sequence[str]) -> np.ndarray:
    """:func:`.ranking.joint_errors` as (pictures, models, models); NaN for what it has not."""
    table = np.full((len(pictures), len(models), len(models)), np.nan)
    keys, names = joint.index.to_frame(index=False), pd.Index(models)
    place = pictures.get_indexer(pd.MultiIndex.from_frame(keys[PICTURE])) if len(keys) else np.zeros(0, int)
    first, second = names.get_indexer(keys["model"]), names.get_indexer(keys["other"])
    keep = (place >= 0) & (first >= 0) & (second >= 0)
    table[place[keep], first[keep], second[keep]] = joint.to_numpy(float)[keep]
    return table


def _over_materials(
    values: np.ndarray, there: np.ndarray, materials: pd.Index
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Along the pictures, of which ``there`` says which count: materials, mean of their means, its standard error by
    their spread (NaN for one material alone)."""
    places, names = pd.factorize(materials)
    sums, counts = (np.zeros((len(names), *values.shape[1:])) for _ in range(2))
    np.add.at(sums, places, values)
    np.add.at(counts, places, there)
    known = counts > 0
    count = known.sum(0)
    with np.errstate(invalid="ignore", divide="ignore"):
        means = sums / counts
        mean = np.where(known, means, 0).sum(0) / count
        squares = np.where(known, (means - mean) ** 2, 0).sum(0)
        spread = np.sqrt(squares / (count - 1) / count)
    return count, mean, np.where((count > 1) & np.isfinite(mean), spread, np.nan)


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
    all_errors, all_brdf, classes = read_tsv(errors, ERRORS), read_tsv(brdf, BRDF), read_classes(descriptions)
    words = classes.assign(**{c: classes[c].map({True: "yes", False: "no"}) for c in KINDS.values()})
    write_tsv(folder / "errors.tsv", all_errors.merge(words, on="material", how="left"))
    write_tsv(folder / "brdf.tsv", all_brdf.merge(words, on="material", how="left"))
    write_tsv(folder / "summary.tsv", summarise(all_errors, classes, models))
    write_tsv(folder / "summary_brdf.tsv", summarise_brdf(all_brdf, classes, models))
    joint = read_tsv(pairs, PAIRS) if len(pairs) else None
    duels = [count_wins(all_errors, classes, models, measure=measure, pairs=joint) for measure in RANKED]
    write_tsv(folder / "wins.tsv", pd.concat(duels, ignore_index=True))
    write_tsv(folder / "published.tsv", beside_published(all_errors, classes, models))
