"""A finished run knows what it owes: what is lost is made again, and what is not made of it stays; who looks, looks."""

import hashlib
import json
import os
import shutil

import pytest

#: The last jobs list what is in reports/ whenever something there is made again, and say how the fits went.
LIST = {"record_reports", "check_failures"}
#: Lost file -> the rules that make it and what is made of it.
LEAVES = {
    "reports/materials/chrome.html": {"write_material_page"},
    "reports/data/viewer.js": {"write_viewer"},
    "reports/index.html": {"write_index"},
    "reports/standings.html": {"write_standings"},
    "reports/assets/site.css": {"write_assets"},
    "results/verdict.txt": {"check_failures"},
    "results/tables/errors.tsv": {"tabulate_errors"},
}


@pytest.fixture
def lost(finished_run):
    """lost(name): the file moved away; put back, with its time stamp, at the end."""
    moved = []

    def lose(name):
        path = finished_run.root / name
        away = path.with_name(f"{path.name}.away")
        path.rename(away)
        moved.append((away, path))

    yield lose
    for away, path in moved:
        path.unlink(missing_ok=True)
        away.rename(path)


@pytest.mark.parametrize("name", LEAVES)
def test_a_lost_leaf_costs_itself(finished_run, lost, name):
    lost(name)
    planned = finished_run.planned().keys() - {"all"}
    made_of = {"write_standings"} if name.startswith("results/tables") else set()
    assert LEAVES[name] <= planned <= LEAVES[name] | made_of | LIST


@pytest.mark.parametrize(
    ("name", "rule"),
    [
        ("results/fits/chrome/ggx.npz", "fit_dupuy2015"),
        ("results/fits/chrome/ggx.json", "fit_dupuy2015"),
        ("results/renders/chrome/ggx/studio_sphere.exr", "render_material"),
        ("results/materials/chrome.json", "describe_material"),
        ("results/pictures/chrome.json", "draw_pictures"),
    ],
)
def test_a_lost_intermediate_costs_one_job_of_its_kind_and_what_is_made_of_it(finished_run, lost, name, rule):
    lost(name)
    planned = finished_run.planned()
    assert planned[rule] == 1
    assert not planned.keys() & {"make_standin", "prepare_scene", "write_assets"}
    assert planned.get("fit_dupuy2015", 0) == (rule == "fit_dupuy2015")
    assert planned.get("write_material_page", 0) <= 2


def test_lost_pictures_and_figures_are_drawn_again_and_the_pages_that_show_them(finished_run):
    root = finished_run.root
    pages = root / "reports" / "materials" / "chrome"
    names = [
        next(
            name for name in json.loads((root / f"results/{kind}/chrome.json").read_text())[kind] if "lobes" not in name
        )
        for kind in ("pictures", "figures")
    ]
    content = {name: (pages / name).read_bytes() for name in names}
    for name in names:
        (pages / name).unlink()
    planned = finished_run.planned()
    assert planned["draw_pictures"] == planned["draw_figures"] == 1
    assert not [rule for rule in planned if rule.startswith(("fit_", "render_", "measure_"))]
    finished_run.snakemake()
    for name, old in content.items():
        assert (pages / name).read_bytes() == old
    assert finished_run.planned() == {}


def test_a_deleted_material_comes_back_with_its_pictures(finished_run):
    """Its page and its PDF wait for them."""
    root = finished_run.root
    folder = root / "reports/materials/chrome"
    content = {
        path: path.read_bytes() for path in [folder.with_suffix(".html"), *folder.rglob("*.*")] if path.is_file()
    }
    folder.with_suffix(".html").unlink()
    shutil.rmtree(folder)
    finished_run.snakemake("--cores", "1")
    assert {path: path.read_bytes() for path in content} == content
    assert finished_run.planned() == {}


LOOKS = [("--dry-run",), ("--lint",), ("--summary",), ("--dag",), ("--unlock",), ("--report", "{tmp}/report.html")]


def content_of(project):
    files = {}
    for folder in ("results", "reports", "data", "config", "src", "workflow"):
        for path in (project.root / folder).rglob("*"):
            if path.is_file() and "__pycache__" not in path.parts:
                files[path] = hashlib.sha256(path.read_bytes()).hexdigest(), path.stat().st_mtime_ns
    return files


def test_who_looks_changes_no_file(finished_run, tmp_path):
    """Also where something is stale, damaged, left behind by a killed writer or from the future."""
    project = type(finished_run)(tmp_path / "copy")
    shutil.copytree(finished_run.root, project.root, symlinks=True)
    page, fit = project.root / "reports/materials/chrome.html", project.root / "results/fits/chrome/ggx.npz"
    page.write_text("edited by hand")
    fit.write_bytes(fit.read_bytes()[:100])
    (project.root / "results" / ".fit.npz.abcdefgh.npz").touch()
    os.utime(project.root / "results/run.json", (4e9, 4e9))
    (project.root / "data" / "assets").mkdir(parents=True)
    (project.root / "data" / "assets" / "sky.hdr").write_text("my own")
    before = content_of(project)
    for arguments in LOOKS:
        project.snakemake(*(word.format(tmp=tmp_path) for word in arguments))
        assert content_of(project) == before, arguments
