"""What runs made in reports/ is listed; what an earlier run left there goes, and nothing of the user's."""

import hashlib
import json
import os
import time

import pytest

from brdfatlas.files import atomic_path
from brdfatlas.pipeline.leftovers import missing_files, record_reports_job

RECORD = "results/reports.tsv"


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Two materials with a page and a listed picture each, recorded; and a file of the user's."""
    monkeypatch.chdir(tmp_path)
    for name in ("chrome", "nylon"):
        (tmp_path / f"reports/materials/{name}/renders").mkdir(parents=True)
        (tmp_path / f"reports/materials/{name}.html").write_text(name)
        (tmp_path / f"reports/materials/{name}/renders/a.webp").write_text(name)
        (tmp_path / "results/pictures").mkdir(parents=True, exist_ok=True)
        (tmp_path / f"results/pictures/{name}.json").write_text(json.dumps({"pictures": {"renders/a.webp": "0"}}))
    (tmp_path / "reports/materials/mine.html").write_text("notes")
    record("chrome", "nylon")
    return tmp_path


def record(*names, said=None):
    pages = [f"reports/materials/{name}.html" for name in names]
    listings = {f"results/pictures/{name}.json": f"reports/materials/{name}" for name in names}
    record_reports_job([*pages, *listings], listings, RECORD, (said if said is not None else []).append)


def test_what_left_the_run_leaves_the_report(folder):
    record("chrome")
    left = sorted(str(path.relative_to(folder)) for path in (folder / "reports").rglob("*") if path.is_file())
    assert left == [
        "reports/materials/chrome.html",
        "reports/materials/chrome/renders/a.webp",
        "reports/materials/mine.html",
    ]
    assert not (folder / "reports/materials/nylon").exists()


def test_a_page_that_somebody_changed_stays_and_is_told(folder):
    (folder / "reports/materials/nylon.html").write_text("nylon, with my remarks")
    said = []
    record("chrome", said=said)
    assert (folder / "reports/materials/nylon.html").read_text() == "nylon, with my remarks"
    assert said == ["reports/materials/nylon.html: not part of this run, but changed since it was made; kept"]


@pytest.mark.parametrize("name", ["data/assets/sky.hdr", "reports/../data/assets/sky.hdr", "results/fits/a.npz"])
def test_nothing_outside_of_reports_is_removed_whatever_the_record_says(folder, name):
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("x")
    with open(folder / RECORD, "a") as handle:
        handle.write(f"{hashlib.sha256(b'x').hexdigest()}\t{name}\n")
    record("chrome")
    assert path.exists()


def test_what_a_killed_writer_left_goes_once_it_is_old(folder):
    with atomic_path("results/a.json") as temporary:
        old = temporary
    new = old.with_name(f"{old.name}.new")
    mine = [folder / "reports" / name for name in (".hidden", ".notes.markdown", ".a.json.a_c0efgh.json")]
    for path in (old, new, *mine):
        path.touch()
    for path in (old, *mine):
        os.utime(path, (time.time() - 7200,) * 2)
    record("chrome", "nylon")
    assert not old.exists()
    assert all(path.exists() for path in (new, *mine))


def test_missing_files_of_a_listing(folder):
    listing, pages = "results/pictures/chrome.json", "reports/materials/chrome"
    assert missing_files(listing, pages) == []
    (folder / pages / "renders/a.webp").unlink()
    assert [path.name for path in missing_files(listing, pages)] == ["a.webp"]
    assert missing_files("results/pictures/gone.json", pages) == []
    for damaged in ("{", "[]", "null", '{"pictures": 1}'):
        (folder / listing).write_text(damaged)
        assert missing_files(listing, pages) == []
