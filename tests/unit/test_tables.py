"""Tables over a run: counted and averaged by hand on small made-up results."""

import numpy as np
import pandas as pd
import pytest

from brdfatlas.files import write_json
from brdfatlas.measures import tables
from brdfatlas.measures.errors import BRDF_MEASURES, IMAGE_MEASURES
from brdfatlas.measures.tsv import read_tsv, write_tsv

CLASSES = pd.DataFrame(
    {
        "material": ["chrome", "nylon", "my-own"],
        "class": ["specular", "diffuse", "diffuse"],
        "standin": [True, True, False],
        "reconstructed": [False, False, True],
    }
)
MODELS = ["ward", "tucker", "absent"]


def errors_of(psnr: dict[tuple[str, str, str], float]) -> pd.DataFrame:
    """Tidy errors from (material, model, scene) -> PSNR; None is a failed render."""
    rows = []
    for (material, model, scene), value in psnr.items():
        row = {"material": material, "model": model, "scene": scene, "status": "failed" if value is None else "ok"}
        row |= dict.fromkeys(IMAGE_MEASURES, np.nan if value is None else 1.0) | {"psnr_se_db": 0.1}
        rows.append(row | {"psnr_db": np.nan if value is None else value})
    return pd.DataFrame(rows)


@pytest.fixture
def errors():
    return errors_of(
        {
            ("chrome", "ward", "a"): 30.0,
            ("chrome", "ward", "b"): 40.0,
            ("nylon", "ward", "a"): 50.0,
            ("nylon", "ward", "b"): None,
            ("my-own", "ward", "a"): 20.0,
            ("my-own", "ward", "b"): 20.0,
            ("chrome", "tucker", "a"): 32.0,  # exactly 2 dB: a tie
            ("chrome", "tucker", "b"): 42.1,  # a win
            ("nylon", "tucker", "a"): 45.0,  # a loss
            ("nylon", "tucker", "b"): 60.0,  # not comparable, ward failed
            ("my-own", "tucker", "a"): np.inf,  # a win
            ("my-own", "tucker", "b"): 19.0,  # a tie
            ("chrome", "reference_again", "a"): 70.0,
        }
    )


def test_means_and_medians_over_what_could_be_judged(errors):
    summary = tables.summarise(errors, CLASSES, MODELS).set_index(["model", "class", "scene"])
    everything = summary.loc[("ward", "all", "all")]
    assert everything["count"] == 5
    assert everything["failed"] == 1
    assert (everything["materials"], everything["standins"]) == (3, 2)
    assert (everything["missing"], summary.loc[("tucker", "all", "all"), "missing"]) == (1, 0)
    assert everything["psnr_db_mean"] == pytest.approx((30 + 40 + 50 + 20 + 20) / 5)
    assert everything["psnr_db_median"] == 30
    assert summary.loc[("ward", "specular", "all"), "psnr_db_mean"] == 35
    assert summary.loc[("ward", "diffuse", "b"), "psnr_db_mean"] == 20
    assert summary.loc[("tucker", "all", "all"), "psnr_db_mean"] == np.inf
    assert summary.loc[("tucker", "all", "all"), "psnr_db_median"] == pytest.approx((42.1 + 45) / 2)
    assert summary.loc[("reference_again", "all", "all"), "psnr_db_mean"] == 70
    assert "glossy" not in summary.index.get_level_values("class")
    assert "absent" not in summary.index.get_level_values("model")


def test_lower_bounds_are_counted(errors):
    errors.loc[0, "psnr_se_db"] = np.inf
    summary = tables.summarise(errors, CLASSES, MODELS).set_index(["model", "class", "scene"])
    assert summary.loc[("ward", "all", "all"), "bounds"] == 1
    assert summary.loc[("ward", "diffuse", "all"), "bounds"] == 0


def test_wins_and_ties_as_counted_by_hand(errors):
    wins = tables.count_wins(errors, CLASSES, MODELS, measure="psnr_db").set_index(["model", "other", "class"])
    row = wins.loc[("tucker", "ward", "all")]
    assert (row["count"], row["wins"], row["ties"], row["losses"]) == (5, 2, 2, 1)
    assert row["mean_difference"] == np.inf
    back = wins.loc[("ward", "tucker", "all")]
    assert (back["count"], back["wins"], back["ties"], back["losses"]) == (5, 1, 2, 2)
    specular = wins.loc[("tucker", "ward", "specular")]
    assert (specular["wins"], specular["ties"], specular["losses"]) == (1, 1, 0)
    assert specular["mean_difference"] == pytest.approx((2 + 2.1) / 2)
    assert np.isnan(specular["se_difference"]), "one material has no spread"
    assert "reference_again" not in wins.index.get_level_values("model")


def test_two_perfect_models_tie():
    errors = errors_of({("chrome", "ward", "a"): np.inf, ("chrome", "tucker", "a"): np.inf})
    row = (
        tables.count_wins(errors, CLASSES, MODELS, measure="psnr_db")
        .set_index(["model", "other", "class"])
        .loc["ward", "tucker", "all"]
    )
    assert (row["ties"], row["mean_difference"]) == (1, 0)


def test_a_mean_difference_is_over_materials_with_the_error_of_their_spread():
    """Two scenes of a material say little more than one: each material counts once."""
    psnr = {("chrome", "ward", s): 30.0 for s in "ab"} | {("nylon", "ward", "a"): 30.0}
    psnr |= {("chrome", "tucker", "a"): 32.0, ("chrome", "tucker", "b"): 36.0, ("nylon", "tucker", "a"): 40.0}
    wins = tables.count_wins(errors_of(psnr), CLASSES, MODELS, measure="psnr_db").set_index(["model", "other", "class"])
    row = wins.loc["tucker", "ward", "all"]
    assert (row["materials"], row["mean_difference"]) == (2, pytest.approx((4 + 10) / 2))
    assert row["se_difference"] == pytest.approx(np.std([4, 10], ddof=1) / np.sqrt(2))


def test_a_lower_bound_never_loses_a_duel_and_wins_by_no_less_than_its_value():
    psnr = {("chrome", "ward", s): 40.0 for s in "abc"}
    psnr |= {("chrome", "tucker", "a"): 50.0, ("chrome", "tucker", "b"): 30.0, ("chrome", "tucker", "c"): 30.0}
    errors = errors_of(psnr).assign(psnr_se_db=0.2)
    errors.loc[errors["scene"] == "a", "psnr_se_db"] = [np.inf, 0.2]  # ward is a bound below tucker
    errors.loc[errors["scene"] == "b", "psnr_se_db"] = [np.inf, 0.2]  # ward is a bound above tucker
    row = (
        tables.count_wins(errors, CLASSES, MODELS, measure="psnr_db")
        .set_index(["model", "other", "class"])
        .loc["ward", "tucker", "all"]
    )
    assert (row["wins"], row["ties"], row["losses"]) == (2, 1, 0)
    assert row["mean_difference"] == pytest.approx((0 + 10 + 10) / 3)


def test_published_figures_stand_beside_ours_over_the_same_materials(errors):
    from brdfatlas.models.published import published_psnr

    rows = tables.beside_published(errors, CLASSES, MODELS).set_index(["model", "source"])
    assert rows.loc[("tucker", "Bagher et al. 2016"), "published_db"] == 54.02
    assert rows.loc[("tucker", "Bagher et al. 2016"), "published_count"] == 100
    ward = rows.loc[("ward", "Bilgili et al. 2011")]
    expected = np.mean([published_psnr(name)["ward"] for name in ("chrome", "nylon")])
    assert ward["published_db"] == pytest.approx(expected)
    assert ward["ours_db"] == pytest.approx((30 + 40 + 50) / 3)  # my-own has no published figure
    assert ward["published_count"] == ward["ours_count"] == 2
    assert "2 built-in stand-ins (no measurements)" in ward["note"]
    assert "scene" in ward["note"]
    assert ("ward", "Bagher et al. 2016") not in rows.index


def test_all_tables_are_written_and_read_back(errors, tmp_path):
    brdf = pd.DataFrame(
        [("chrome", "ward", 1.0, 2.0, 3.0, 4.0), ("nylon", "ward", np.nan, np.nan, np.nan, np.nan)],
        columns=["material", "model", *BRDF_MEASURES],
    )
    descriptions = []
    for item in CLASSES.to_dict("records"):
        kind = "reconstructed" if item["reconstructed"] else "measured"
        write_json(tmp_path / f"{item['material']}.json", {"name": item["material"], "kind": kind} | item)
        descriptions.append(tmp_path / f"{item['material']}.json")
    write_tsv(tmp_path / "e.tsv", errors)
    write_tsv(tmp_path / "b.tsv", brdf)
    tables.write_tables([tmp_path / "e.tsv"], [tmp_path / "b.tsv"], descriptions, MODELS, tmp_path / "out")
    names = {"errors", "brdf", "summary", "summary_brdf", "wins", "published"}
    assert {path.stem for path in (tmp_path / "out").iterdir()} == names
    rows = read_tsv(tmp_path / "out" / "errors.tsv").set_index("material")
    assert set(rows.loc["my-own", "standin"]) == {"no"}
    assert set(rows.loc["nylon", "standin"]) == {"yes"}
    summary = read_tsv(tmp_path / "out" / "summary_brdf.tsv").set_index(["model", "class"])
    assert summary.loc[("ward", "all"), "count"] == 1
    assert summary.loc[("ward", "all"), "failed"] == 1
    assert summary.loc[("ward", "all"), "loew_e2_mean"] == 2
    back = read_tsv(tmp_path / "out" / "summary.tsv")
    expected = tables.summarise(errors, CLASSES, MODELS)
    pd.testing.assert_frame_equal(back, expected, check_dtype=False, rtol=1e-5)


def test_a_run_in_which_nothing_worked_still_has_tables():
    errors = errors_of({("chrome", "ward", "a"): None})
    summary = tables.summarise(errors, CLASSES, MODELS)
    assert list(summary["count"]) == [0, 0]
    assert summary["psnr_db_mean"].isna().all()
    assert tables.count_wins(errors, CLASSES, MODELS, measure="psnr_db").empty
    assert tables.beside_published(errors, CLASSES, MODELS).empty


def test_duels_are_fought_in_the_chosen_measure_and_decided_by_the_error_of_the_difference():
    errors = errors_of({("chrome", model, scene): 40.0 for model in ("ward", "tucker") for scene in "ab"})
    errors["de00_mean"] = errors["model"].map({"ward": 1.0, "tucker": 1.5})
    errors["de00_se"] = 0.6
    plain = tables.count_wins(errors, CLASSES, MODELS).set_index(["model", "other", "class"])
    assert plain.loc[("ward", "tucker", "all"), "ties"] == 2, "0.5 is less than two errors of two independent values"
    pairs = pd.DataFrame({"material": "chrome", "scene": ["a", "b"], "model": "tucker", "other": "ward"})
    pairs["de00_se"] = [0.1, 0.3]
    duel = tables.count_wins(errors, CLASSES, MODELS, pairs=pairs).set_index(["model", "other", "class"])
    row, back = duel.loc[("ward", "tucker", "all")], duel.loc[("tucker", "ward", "all")]
    assert (row["wins"], row["ties"], row["losses"]) == (back["losses"], back["ties"], back["wins"]) == (1, 1, 0)
    assert row["measure"] == "de00_mean"
    assert row["mean_difference"] == pytest.approx(-0.5)


def test_tables_over_materials_lead_with_a_measure_that_compares_materials(errors):
    columns = list(tables.summarise(errors, CLASSES, MODELS).columns)
    statistics = [name for name in columns if name.endswith(("_mean", "_median"))]
    assert statistics[:2] == ["de00_mean_mean", "de00_mean_median"]
