"""Rules of the report, each alone: write_assets, write_material_page, write_model_pages, write_index, write_viewer,
write_uber_texture, typeset_material, write_supplement."""

import json
import math
import re
import shutil
from urllib.parse import unquote

import numpy as np
import pandas as pd
import pytest
from pypdf import PdfReader

from brdfatlas import load_fit
from brdfatlas.export.uber_texture import load_uber_texture
from brdfatlas.reports.formats import number


def table(root, name: str) -> pd.DataFrame:
    return pd.read_csv(root / f"reports/data/{name}.tsv", sep="\t", keep_default_na=False, na_values=["nan"])


def test_write_assets(run_rule):
    page = run_rule("write_assets", "reports/compare.html").read_text(encoding="utf-8")
    for asset in ("site.css", "compare.js", "icon.svg"):
        assert f"assets/{asset}" in page


def test_write_material_page(run_rule, finished_run):
    page = run_rule("write_material_page", "reports/materials/chrome.html").read_text(encoding="utf-8")
    root = finished_run.root
    source = pd.read_csv(root / "results/errors/chrome/images.tsv", sep="\t").set_index(["model", "scene"])["psnr_db"]
    copied = table(root, "materials/chrome/errors").set_index(["model", "scene"])["psnr_db"].astype(float)
    pd.testing.assert_series_equal(copied, source, rtol=1e-8)
    for model in ("ggx", "gaussian"):
        assert f"{source[model, 'studio_sphere']:.1f}" in page
    assert "Stand-in, not a measurement" in page


def test_every_file_of_a_material_is_linked(finished_run):
    """By a page, or by a script of the report for the choices that it offers; nothing else lies in the folder."""
    reports, scene = finished_run.root / "reports", "studio_sphere"
    for material in ("chrome", "pink-felt"):
        page = (reports / f"materials/{material}.html").read_text(encoding="utf-8")
        linked = {
            unquote(href.split("#")[0]) for href in re.findall(rf'(?:href|src)="{re.escape(material)}/([^"]+)"', page)
        }
        linked |= {"thumb.webp"}  # the index
        kinds = re.findall(r'data-choice="(render|de00|diff|flip)"', page)
        assert sorted(kinds) == ["de00", "diff", "flip", "render"]
        for model in ("ggx", "gaussian"):
            # What the page, Compare and the viewer load when it is chosen.
            linked |= {f"renders/{scene}/{model}/{kind}.webp" for kind in kinds}
            linked |= {f"renders/{scene}/{model}/hdr.js", f"tables/{model}.js"}
        linked |= {f"renders/{scene}/reference/{name}" for name in ("render.webp", "hdr.js")} | {"tables/reference.js"}
        linked |= {f"renders/{scene}/reference_again/de00.webp"}
        folder = reports / "materials" / material
        found = {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}
        assert found == linked
    scripts = {name: (reports / f"assets/{name}.js").read_text() for name in ("compare", "viewer", "material")}
    assert "/hdr.js`" in scripts["compare"]
    assert "/tables/$" in scripts["viewer"]
    assert "curves.js" in page


def test_write_fits(run_rule, finished_run):
    """Every fit of the run lies below reports/ and is the one in results/."""
    listing = json.loads(run_rule("write_fits", "results/fit_files/chrome.json").read_text())
    folder = finished_run.root / "reports/materials/chrome/fits"
    assert {path.name for path in folder.iterdir()} == set(listing["files"])
    for model in ("ggx", "gaussian"):
        original = finished_run.root / f"results/fits/chrome/{model}.npz"
        assert load_fit(folder / f"chrome-{model}.npz") == load_fit(original)
        assert (folder / f"chrome-{model}.json").is_file()


def test_write_model_pages(run_rule, finished_run):
    page = run_rule("write_model_pages", "reports/models/ggx.html").read_text(encoding="utf-8")
    fits = table(finished_run.root, "models/ggx/fits").set_index("material")
    assert sorted(fits.index) == ["chrome", "pink-felt"]
    report = json.loads((finished_run.root / "results/fits/chrome/ggx.json").read_text())
    assert fits.loc["chrome", "objective"] == pytest.approx(report["objective"], rel=1e-8)
    assert fits.loc["chrome", "bad_cells"] == 0
    albedo = max(report["physics"]["max_albedo"])
    assert fits.loc["chrome", "max_albedo"] == pytest.approx(albedo, rel=1e-8)
    assert number(albedo) in page
    assert "Dupuy" in page


def test_write_index(run_rule, finished_run):
    page = run_rule("write_index", "reports/index.html").read_text(encoding="utf-8")
    root = finished_run.root
    models, errors = table(root, "models").set_index("model"), table(root, "errors")
    for model in ("ggx", "gaussian"):
        mine = errors[errors["model"] == model]
        mean = mine["psnr_db"].astype(float).mean()
        assert models.loc[model, "psnr_db_mean"] == pytest.approx(mean, rel=1e-6)
        middle = mine["de00_mean"].astype(float).median()
        assert models.loc[model, "de00_mean_median"] == pytest.approx(middle, rel=1e-6)
        assert f"{middle:.2f}" in page
    assert "2 of 2 materials are stand-ins" in page
    script = (root / "reports/data/atlas.js").read_text()
    atlas = json.loads(script.removeprefix("window.ATLAS=").rstrip(";\n"))
    assert [m["name"] for m in atlas["materials"]] == ["pink-felt", "chrome"]
    assert all(value is None or value > 0 or math.isinf(value) for value in atlas["values"]["psnr_db"])


def test_write_viewer(run_rule):
    """The small run has no factor model: reference and fits are shown by the tables that draw_figures left."""
    page = run_rule("write_viewer", "reports/viewer.html")
    text = page.read_text(encoding="utf-8")
    assert "The reference and the fits come from tables" in text
    assert "rendered from their factors" not in text
    for material in ("chrome", "pink-felt"):
        tables = {path.stem for path in (page.parent / f"materials/{material}/tables").iterdir()}
        assert tables == {"reference", "ggx", "gaussian"}


def test_write_uber_texture(finished_run, tmp_path):
    """With a factor model each fit is a row of a texture, and the viewer names the texture and holds the fits."""
    project = type(finished_run)(tmp_path / "project")
    shutil.copytree(finished_run.root, project.root)
    project.configure(models=["ggx", "g_from_d"])
    done = project.snakemake("--", "reports/viewer.html")
    assert {"write_uber_texture": 1, "write_viewer": 1}.items() <= project.jobs(done.stdout).items()
    texture = load_uber_texture(project.root / "reports/data/models/g_from_d/uber-texture-1.exr")
    assert texture.materials == texture.standins == ("pink-felt", "chrome")
    fitted = load_fit(project.root / "results/fits/chrome/g_from_d.npz")
    for name, values in texture.parameters("chrome").items():
        np.testing.assert_array_equal(values, fitted.parameters[name])
    page = (project.root / "reports/viewer.html").read_text(encoding="utf-8")
    assert "2 fits are rendered from their factors" in page
    assert "data/models/g_from_d/uber-texture-1.exr" in page
    assert "g_from_d" in (project.root / "reports/data/viewer.js").read_text(encoding="utf-8")


def test_typeset_material(run_rule):
    reader = PdfReader(run_rule("typeset_material", "results/pdf/chrome.pdf"))
    assert len(reader.pages) == 4, "fits, the reference in every slot, curves and numbers, parameters"
    assert "stand-in, not a measurement" in reader.pages[0].extract_text()


def test_write_supplement(run_rule, finished_run):
    """The parts are there once each has been set; the overview and four pages a material follow."""
    finished_run.snakemake("--", "results/pdf/chrome.pdf", "results/pdf/pink-felt.pdf")
    finished_run.snakemake("--", "reports/supplement.pdf")
    reader = PdfReader(run_rule("write_supplement", "reports/supplement.pdf"))
    assert len(reader.pages) == 2 + 4 * 2
    assert [item.title for item in reader.outline] == ["Overview", "pink felt (stand-in)", "chrome (stand-in)"]
