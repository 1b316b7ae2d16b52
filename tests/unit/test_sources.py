"""What a result depends on: a model's own file, what it imports, and no other model."""

from pathlib import Path

import pytest

from brdfatlas.models.loading import BUILTIN
from brdfatlas.pipeline import sources
from brdfatlas.pipeline.sources import imports_of, list_sources, module_path, sources_of

#: What a model is made of, as its paper says: a metric changed, or fits that others start from.
STARTS = {"sgd", "g_from_d"}
BUILT_ON = {
    "independent_g": STARTS,
    "bivariate_g": STARTS | {"independent_g"},
    "low_rank": STARTS | {"independent_g", "bivariate_g"},
}


def test_a_model_depends_on_itself_and_shared_parts_and_on_no_model_but_those_it_is_built_on():
    own = {name: str(module_path(module)) for name, module in BUILTIN.items()}
    for name, module in BUILTIN.items():
        found = {path for path in sources_of(module)}
        assert any(own[name].endswith(path) for path in found)
        strangers = {other for other, path in own.items() if path != own[name] and any(path.endswith(p) for p in found)}
        assert strangers == BUILT_ON.get(name, set()), f"{name} depends on {strangers}"


def test_imports_are_followed_and_inits_are_not(tmp_path):
    found = sources_of("brdfatlas.fits")
    assert any(path.endswith("measured.py") for path in found)
    assert not any(path.endswith("__init__.py") for path in found)


def test_a_model_file_of_a_user(tmp_path):
    path = tmp_path / "mine.py"
    path.write_text("from brdfatlas.models.base import Model\nimport numpy\n")
    found = sources_of(str(path))
    assert any(name.endswith("mine.py") for name in found)
    assert any(name.endswith("measured.py") for name in found)
    assert imports_of(path) == ("brdfatlas.models.base", "brdfatlas.models.base.Model")


def test_an_absent_module_is_an_error():
    with pytest.raises(FileNotFoundError, match=r"brdfatlas\.nothing"):
        sources_of("brdfatlas.nothing")


def test_the_list_changes_with_a_file_and_only_then(tmp_path):
    """What the workflow declares: the same file, untouched, until the content of a source changes."""
    model = tmp_path / "mine.py"
    model.write_text("from brdfatlas.models.base import Model\n")
    listing = Path(list_sources(tmp_path / "lists", str(model), "brdfatlas.fits"))
    listed = {line.split("\t")[0] for line in listing.read_text().splitlines()}
    assert listed == set(sources_of(str(model), "brdfatlas.fits"))
    before = listing.stat().st_mtime_ns, listing.stat().st_ino
    model.touch()
    sources._checksum.cache_clear()
    assert Path(list_sources(tmp_path / "lists", str(model), "brdfatlas.fits")) == listing
    assert (listing.stat().st_mtime_ns, listing.stat().st_ino) == before
    model.write_text("from brdfatlas.models.base import Model  # changed\n")
    sources._checksum.cache_clear()
    list_sources(tmp_path / "lists", str(model), "brdfatlas.fits")
    assert listing.stat().st_ino != before[1]
    other = tmp_path / "elsewhere" / "mine.py"
    other.parent.mkdir()
    other.write_text("")
    assert list_sources(tmp_path / "lists", str(other), "brdfatlas.fits") != str(listing)
