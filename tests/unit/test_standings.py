"""The page of standings and which figures a material gets."""

import re

import numpy as np
import pandas as pd
import pytest

from brdfatlas import read_merl
from brdfatlas.angles import GRID_SHAPE, above_horizon, theta_h_centres
from brdfatlas.files import read_json, write_json
from brdfatlas.fits import Fit, fit
from brdfatlas.formats.merl import write_merl
from brdfatlas.measures import tables
from brdfatlas.measures.errors import BRDF_MEASURES, IMAGE_MEASURES
from brdfatlas.measures.tsv import write_tsv
from brdfatlas.models import MODELS as REGISTRY
from brdfatlas.reports.standings_page import class_rows, duel_rows, scene_rows, write_standings

CLASSES = pd.DataFrame(
    {
        "material": ["chrome", "nylon"],
        "class": ["specular", "diffuse"],
        "standin": [False, False],
        "reconstructed": [False, False],
    },
)
MODELS = ["tabulated", "ggx", "gaussian"]


def made_up(psnr: dict[str, tuple[float, float]]) -> pd.DataFrame:
    """Errors of one scene: model -> PSNR on chrome and on nylon; NaN is a failure."""
    rows = []
    for model, values in psnr.items():
        for material, value in zip(("chrome", "nylon"), values):
            row = dict.fromkeys(IMAGE_MEASURES, 30.0 - value / 10 if np.isfinite(value) else value)
            status = "failed" if np.isnan(value) else "ok"
            row |= {"psnr_db": value, "psnr_se_db": 0.1, "status": status}
            row |= {"de00_mean": 1000 * 10 ** (-value / 20), "de00_se": 0.0}  # one dB is one dB
            rows.append({"material": material, "model": model, "scene": "room"} | row)
    return pd.DataFrame(rows)


@pytest.fixture
def errors():
    return made_up(
        {
            "tabulated": (40.0, 50.0),
            "ggx": (45.0, 49.0),
            "gaussian": (20.0, np.nan),
            "reference_again": (80.0, 80.0),
        }
    )


def test_the_best_of_a_column_is_marked_and_never_the_noise_floor(errors):
    found = class_rows(tables.summarise(errors, CLASSES, MODELS), MODELS)
    assert [table["class"] for table in found] == ["all", "diffuse", "specular"]
    for table, winner in zip(found, ("ggx", "tabulated", "ggx")):
        best = [row["model"] for row in table["rows"] if row["cells"][0]["best"]]
        assert best == [winner]  # dE00, made to fall with PSNR: the lowest
        best = [row["model"] for row in table["rows"] if row["cells"][-1]["best"]]
        assert best == [winner]  # PSNR: the highest
    failed = {row["model"]: row["failed"] for row in found[0]["rows"]}
    assert failed == {"tabulated": 0, "ggx": 0, "gaussian": 1, "reference_again": 0}


def test_duels_are_antisymmetric(errors):
    duels = duel_rows(tables.count_wins(errors, CLASSES, MODELS, measure="psnr_db"), MODELS, "psnr_db")
    cells = dict(duels["rows"])
    for i, a in enumerate(duels["names"]):
        assert cells[a][i] is None
        for j, b in enumerate(duels["names"]):
            if i != j:
                assert cells[a][j]["wins"] == cells[b][i]["losses"]
                assert cells[a][j]["balance"] == -cells[b][i]["balance"]
    expected = {"count": 2, "wins": 1, "ties": 1, "losses": 0, "balance": 0.5, "difference": 2.0, "apart": False}
    assert cells["ggx"][duels["names"].index("tabulated")] == expected | {"error": pytest.approx(3.0)}, (
        "5 and -1 dB: 2 +- 3"
    )


def test_one_material_gives_no_spread_to_call_a_difference_insignificant_by(errors):
    one = errors[errors["material"] == errors["material"].iloc[0]]
    duels = duel_rows(tables.count_wins(one, CLASSES, MODELS, measure="psnr_db"), MODELS, "psnr_db")
    found = [cell for _, cells in duels["rows"] for cell in cells if cell and cell["difference"] != 0]
    assert found
    assert all(np.isnan(cell["error"]) and cell["apart"] for cell in found)


def test_a_model_that_lost_a_picture_is_never_marked_best():
    """gaussian has the highest mean, over the easier material alone."""
    errors = made_up({"tabulated": (40.0, 50.0), "ggx": (45.0, 49.0), "gaussian": (60.0, np.nan)})
    summary = tables.summarise(errors, CLASSES, MODELS)
    best = {row["model"]: row["cells"][0]["best"] for row in class_rows(summary, MODELS)[0]["rows"]}
    assert best == {"tabulated": False, "ggx": True, "gaussian": False}
    best = {row["model"]: row["cells"][-1]["best"] for row in scene_rows(summary, MODELS)["rows"]}
    assert best == {"tabulated": False, "ggx": True, "gaussian": False}


def test_every_scene_has_its_own_order():
    one = made_up({"tabulated": (40.0, 50.0), "ggx": (45.0, 49.0), "reference_again": (80.0, 80.0)})
    other = made_up({"tabulated": (60.0, 60.0), "ggx": (20.0, 20.0), "reference_again": (80.0, 80.0)})
    summary = tables.summarise(pd.concat([one, other.assign(scene="hall")]), CLASSES, MODELS)
    found = scene_rows(summary, MODELS)
    assert found["names"] == ["room", "hall"]
    rows = {row["model"]: row["cells"] for row in found["rows"]}
    room = (1000 * 10**-2.0 + 1000 * 10**-2.5) / 2
    assert [cell["value"] for cell in rows["tabulated"]] == pytest.approx([room, 1, (room + 1) / 2])
    assert [cell["best"] for cell in rows["tabulated"]] == [False, True, True]
    assert [cell["best"] for cell in rows["ggx"]] == [True, False, False]
    assert not any(cell["best"] for cell in rows["reference_again"])
    assert scene_rows(tables.summarise(one, CLASSES, MODELS), MODELS)["names"] == []


def test_what_is_no_measurement_is_told_without_any_render(errors, tmp_path):
    """They are counted from the descriptions of the materials."""
    gone = errors.assign(status="failed", **dict.fromkeys(IMAGE_MEASURES, np.nan))
    summary = tables.summarise(gone, CLASSES.assign(standin=[True, False], reconstructed=[False, True]), MODELS)
    write_tsv(tmp_path / "t" / "summary.tsv", summary)
    write_tsv(tmp_path / "t" / "summary_brdf.tsv", summary)
    write_tsv(tmp_path / "t" / "wins.tsv", tables.count_wins(errors, CLASSES, MODELS))
    write_tsv(tmp_path / "t" / "published.tsv", tables.beside_published(errors, CLASSES, MODELS))
    page = tmp_path / "standings.html"
    write_standings(page, tables=tmp_path / "t", data=tmp_path, figure=tmp_path / "none.svg", models=MODELS)
    assert "1 of 2 materials are stand-ins" in page.read_text()
    assert "1 of 2 materials are reconstructions, not measurements." in page.read_text()


def test_the_page_shows_the_tables_and_copies_them(errors, tmp_path):
    brdf = pd.DataFrame([("chrome", "ggx", 1.0, 2.0, 3.0, 4.0)], columns=["material", "model", *BRDF_MEASURES])
    write_tsv(tmp_path / "e.tsv", errors)
    write_tsv(tmp_path / "b.tsv", brdf)
    files = []
    for item in CLASSES.to_dict("records"):
        files.append(tmp_path / f"{item['material']}.json")
        write_json(files[-1], {"name": item["material"]} | item)
    tables.write_tables([tmp_path / "e.tsv"], [tmp_path / "b.tsv"], files, MODELS, tmp_path / "tables")
    page = tmp_path / "site" / "standings.html"
    data = tmp_path / "site" / "data"
    write_standings(page, tables=tmp_path / "tables", data=data, figure=tmp_path / "none.svg", models=MODELS)
    text = page.read_text()
    assert "1 – 1 – 0" in text
    assert "No model of this run has a published figure" in text
    for link in re.findall(r'href="(data/[^"]+)"', text):
        assert (page.parent / link).is_file()
    assert "not measurements" not in text


@pytest.fixture
def material(tmp_path):
    """A rough surface as a MERL file, a good fit of it, a failed one."""
    lobe = 0.1 + 2 * np.exp(-((theta_h_centres() / 0.3) ** 2))
    table = np.broadcast_to(lobe[:, None, None, None], (*GRID_SHAPE, 3)).copy()
    table[~above_horizon()] = np.nan
    write_merl(tmp_path / "stuff.binary", table)
    fit("ggx", read_merl(tmp_path / "stuff.binary")).save(tmp_path / "fits" / "ggx.npz")
    (tmp_path / "fits" / "gaussian.npz").write_bytes(b"")
    write_json(tmp_path / "fits" / "ggx.json", {"status": "ok"})
    write_json(tmp_path / "fits" / "gaussian.json", {"status": "failed", "reason": "no"})
    return tmp_path


TABLES = ("tables/ggx.js", "tables/reference.js")


def files_in(folder):
    return {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}


def test_a_material_gets_lobes_and_the_functions_of_the_fits_that_it_has(material):
    from brdfatlas.figures.jobs import figures_job

    stale = material / "out" / "functions" / "gaussian.svg"
    stale.parent.mkdir(parents=True)
    stale.write_text("left by an earlier run")
    figures_job(
        material / "stuff.binary", ["ggx", "gaussian"], material / "fits", material / "out", material / "list.json"
    )
    assert list(read_json(material / "list.json")["figures"]) == [
        "curves.js",
        "functions.svg",
        "functions/ggx.svg",
        "lobes.svg",
        "tables/ggx.js",
        "tables/reference.js",
    ]
    assert files_in(material / "out") == {"functions/ggx.svg", "lobes.svg", "functions.svg", "curves.js", *TABLES}
    assert "GGX" in (material / "out" / "lobes.svg").read_text()


def test_a_factor_model_gets_curves_slices_weights_and_its_convergence(material):
    from brdfatlas.figures.jobs import figures_job

    flat = {item.name: np.full(item.shape, 0.5, item.dtype) for item in REGISTRY["g_from_d"].parameters}
    Fit("g_from_d", "stuff", flat).save(material / "fits" / "g_from_d.npz")
    details = {"channels": [{"history": [1.0, 0.5, 0.4]}] * 3}
    write_json(material / "fits" / "g_from_d.json", {"status": "ok", "details": details})
    args = (material / "stuff.binary", ["ggx", "g_from_d"], material / "fits", material / "out")
    figures_job(*args, material / "list.json")
    expected = {"lobes.svg", "functions/ggx.svg", "functions/g_from_d.svg", "convergence/g_from_d.svg"}
    # The viewer shows a factor model by its factors: it has no table.
    expected |= {"slices.webp", "weights.svg", "functions.svg", "curves.js", *TABLES}
    assert set(read_json(material / "list.json")["figures"]) == expected
    assert files_in(material / "out") == expected
    # The next time it fails; and somebody has put a file there.
    write_json(material / "fits" / "g_from_d.json", {"status": "failed"})
    (material / "out" / "functions" / "mine.svg").touch()
    figures_job(*args, material / "list.json")
    expected = {"lobes.svg", "functions/ggx.svg", "functions.svg", "curves.js", "functions/mine.svg", *TABLES}
    assert files_in(material / "out") == expected


def test_a_material_without_any_fit_still_shows_its_own_lobes(material):
    from brdfatlas.figures.jobs import figures_job

    figures_job(material / "stuff.binary", ["gaussian"], material / "fits", material / "out", material / "list.json")
    assert list(read_json(material / "list.json")["figures"]) == ["curves.js", "lobes.svg", "tables/reference.js"]
    assert (material / "out" / "lobes.svg").stat().st_size > 1000
