"""Rules measure_errors, tabulate_errors, draw_pictures, draw_bars, each alone, numbers checked against the files."""

import hashlib
import json
import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest
from PIL import Image

from brdfatlas import load_fit, read_merl
from brdfatlas.figures.pictures import read_hdr
from brdfatlas.measures.errors import IMAGE_MEASURES
from brdfatlas.measures.tsv import read_tsv
from brdfatlas.objectives import log_deviation
from brdfatlas.rendering.images import load_render


def picture_of(project, model, scene="studio_sphere", material="pink-felt"):
    return load_render(project.root / "results" / "renders" / material / model / f"{scene}.exr")


def test_measure_errors(run_rule, finished_run):
    table = read_tsv(run_rule("measure_errors", "results/errors/pink-felt/images.tsv")).set_index(["model", "scene"])
    assert set(table.index.get_level_values("model")) == {"ggx", "gaussian", "reference_again"}
    assert set(table["status"]) == {"ok"}
    for measure in IMAGE_MEASURES:
        assert table[measure].notna().all(), measure

    # An independent sum over pairs of different batches.
    reference, image = picture_of(finished_run, "reference"), picture_of(finished_run, "ggx")
    differences = (image.batches.astype(float) - reference.batches)[:, reference.mask]
    n = len(differences)
    pairs = [np.mean(differences[i] * differences[j]) for i in range(n) for j in range(n) if i != j]
    peak = reference.mean[reference.mask].max()
    row = table.loc[("ggx", "studio_sphere")]
    assert np.isfinite(row["psnr_se_db"])
    assert row["psnr_db"] == pytest.approx(10 * np.log10(peak**2 / np.mean(pairs)), abs=0.01)
    assert row["psnr_db"] == pytest.approx(20 * np.log10(peak / row["rmse"]), abs=0.01)
    again = picture_of(finished_run, "reference_again")
    plain = np.mean((again.mean - reference.mean)[reference.mask] ** 2, dtype=float)
    floor = table.loc[("reference_again", "studio_sphere")]
    assert floor["psnr_db"] == pytest.approx(10 * np.log10(peak**2 / plain), abs=0.01)

    brdf = read_tsv(finished_run.root / "results" / "errors" / "pink-felt" / "brdf.tsv").set_index("model")
    measured = read_merl(finished_run.root / "results" / "standins" / "pink-felt.binary")
    for model in ("ggx", "gaussian"):
        fitted = load_fit(finished_run.root / "results" / "fits" / "pink-felt" / f"{model}.npz")
        expected = log_deviation(fitted.table(), measured.table)
        assert brdf.loc[model, "log_deviation"] == pytest.approx(expected, rel=1e-5)


def test_the_tables_of_brdf_measures_belong_to_the_same_job(run_rule):
    assert "log_deviation" in run_rule("measure_errors", "results/errors/chrome/brdf.tsv").read_text()


def test_tabulate_errors(run_rule, finished_run):
    summary = read_tsv(run_rule("tabulate_errors", "results/tables/summary.tsv"))
    summary = summary.set_index(["model", "class", "scene"])
    files = [finished_run.root / "results" / "errors" / name / "images.tsv" for name in ("pink-felt", "chrome")]
    rows = read_tsv(files).set_index("model")
    for model in ("ggx", "gaussian"):
        mean = rows.loc[model, "psnr_db"].mean()
        assert summary.loc[(model, "all", "all"), "psnr_db_mean"] == pytest.approx(mean, rel=1e-5)  # 6 digits
        assert summary.loc[(model, "all", "all"), "standins"] == summary.loc[(model, "all", "all"), "count"] == 2
    wins = read_tsv(finished_run.root / "results" / "tables" / "wins.tsv")
    wins = wins[wins["measure"] == "psnr_db"].set_index(["model", "other", "class"])
    difference = rows.loc["ggx", "psnr_db"].to_numpy() - rows.loc["gaussian", "psnr_db"].to_numpy()
    lower = np.where(difference < 0, rows.loc["ggx", "psnr_se_db"], rows.loc["gaussian", "psnr_se_db"])
    difference = np.where(np.isinf(lower), 0, difference)  # a difference to a lower bound below counts as 0
    row = wins.loc[("ggx", "gaussian", "all")]
    assert row["wins"] == (difference > 2).sum()
    assert row["losses"] == (difference < -2).sum()
    assert row["mean_difference"] == pytest.approx(difference.mean(), abs=1e-3)


def test_draw_pictures(run_rule, finished_run):
    listing = json.loads(run_rule("draw_pictures", "results/pictures/chrome.json").read_text())["pictures"]
    folder = finished_run.root / "reports" / "materials" / "chrome"
    names = ("reference/render.webp", "ggx/de00.webp", "ggx/hdr.js")
    assert {f"renders/studio_sphere/{name}" for name in names} <= set(listing)
    for name, digest in listing.items():
        if name.endswith(".webp"):
            with Image.open(folder / name) as image:
                assert image.size == (24, 24)
        assert hashlib.sha256((folder / name).read_bytes()).hexdigest() == digest
    image = picture_of(finished_run, "ggx", material="chrome")
    back = read_hdr(folder, "studio_sphere", "ggx")
    np.testing.assert_allclose(back, image.mean, rtol=2 ** (1 / 12) - 1)  # half a step of green and one of its ratios
    map_alpha = np.array(Image.open(folder / "renders/studio_sphere/ggx/de00.webp"))[..., 3]
    np.testing.assert_array_equal(map_alpha == 255, image.mask)


def test_pictures_that_somebody_removed_come_back(finished_run):
    lost = finished_run.root / "reports/materials/pink-felt/renders/studio_sphere/reference/render.webp"
    lost.unlink()
    assert finished_run.jobs(finished_run.snakemake().stdout).get("draw_pictures") == 1
    assert lost.stat().st_size > 100


def test_draw_bars(run_rule):
    root = ElementTree.parse(run_rule("draw_bars", "reports/assets/bar-de00.svg")).getroot()
    assert "ΔE00" in root.find("{http://www.w3.org/2000/svg}title").text


def test_draw_figures(run_rule, finished_run):
    listing = json.loads(run_rule("draw_figures", "results/figures/chrome.json").read_text())["figures"]
    figures = ["curves.js", "functions.svg", "functions/gaussian.svg", "functions/ggx.svg", "lobes.svg"]
    assert list(listing) == [*figures, "tables/gaussian.js", "tables/ggx.js", "tables/reference.js"]
    for name, digest in listing.items():
        content = (finished_run.root / "reports" / "materials" / "chrome" / name).read_bytes()
        assert not name.endswith(".svg") or ElementTree.fromstring(content.decode()).tag.endswith("svg")
        assert hashlib.sha256(content).hexdigest() == digest


def test_lobes_that_somebody_removed_come_back(finished_run):
    lost = finished_run.root / "reports/materials/pink-felt/lobes.svg"
    lost.unlink()
    finished_run.snakemake()
    assert "<svg" in lost.read_text()


def test_draw_summary(run_rule):
    assert "<svg" in run_rule("draw_summary", "reports/assets/summary.svg").read_text()


def test_write_standings(run_rule, finished_run):
    page = run_rule("write_standings", "reports/standings.html").read_text()
    wins = read_tsv(finished_run.root / "reports" / "data" / "wins.tsv")
    wins = wins[wins["measure"] == "de00_mean"].set_index(["model", "other", "class"])
    row = wins.loc[("ggx", "gaussian", "all")]
    assert f"{row['wins']:.0f} – {row['ties']:.0f} – {row['losses']:.0f}" in page
    assert "stand-ins, not measurements" in page
