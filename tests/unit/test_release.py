"""What stands in several places says the same: version, papers, dependencies."""

import re
import tomllib
from itertools import chain
from pathlib import Path

import yaml

import brdfatlas
from brdfatlas.models import MODELS

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
CITATION = yaml.safe_load((ROOT / "CITATION.cff").read_text())


def test_one_version():
    assert brdfatlas.__version__ == PROJECT["version"] == CITATION["version"]
    assert f"## {PROJECT['version']}" in (ROOT / "CHANGELOG.md").read_text()


def test_the_papers_of_the_models_are_cited_as_the_models_cite_them():
    cited = {item["doi"]: item for item in CITATION["references"] if "doi" in item}
    papers = {MODELS[name].paper.doi: MODELS[name].paper for name in MODELS if MODELS[name].paper.doi}
    three = {"10.1111/cgf.12675", "10.1111/j.1467-8659.2011.02072.x", "10.1145/2907941"}
    assert three <= cited.keys()
    for doi in cited.keys() & papers.keys():
        assert cited[doi]["title"].lower() == papers[doi].title.lower()
        assert cited[doi]["year"] == papers[doi].year
        for author in cited[doi]["authors"]:
            assert author["family-names"] in papers[doi].authors


def test_every_direct_dependency_has_its_licence():
    stated = [*PROJECT["dependencies"], *chain(*PROJECT["optional-dependencies"].values())]
    direct = {re.split(r"[\[<>=~! ]", line)[0] for line in stated} - {"brdfatlas"}
    rows = re.findall(r"^\| ([\w-]+) \| (\S.*?) \| (\S.*?) \|$", (ROOT / "docs" / "licences.md").read_text(), re.M)
    assert {name for name, _, _ in rows} - {"package", "---"} == direct
    assert len(PROJECT["dependencies"]) == len(set(PROJECT["dependencies"]))
