"""The same run twice gives the same fits and the same images, and the manifest says what was run."""

import hashlib
import json

import pytest

from brdfatlas import __version__


def test_a_second_run_gives_the_same_bytes(finished_run, project):
    wanted = [
        *(f"results/fits/pink-felt/{model}.npz" for model in ("ggx", "gaussian")),
        *(f"results/renders/pink-felt/{model}/studio_sphere.exr" for model in ("reference", "reference_again", "ggx")),
    ]
    project.snakemake("--", *wanted)
    for name in ["results/standins/pink-felt.binary", "results/scenes/studio_sphere.npz", *wanted]:
        assert (project.root / name).read_bytes() == (finished_run.root / name).read_bytes(), name


def test_another_seed_gives_another_image_of_the_same_fit(finished_run):
    images = [
        (finished_run.root / "results/renders/pink-felt" / model / "studio_sphere.exr").read_bytes()
        for model in ("reference", "reference_again")
    ]
    assert images[0] != images[1]


@pytest.fixture(scope="module")
def manifest(finished_run):
    return json.loads((finished_run.root / "results" / "run.json").read_text())


def test_the_manifest_has_what_is_needed_to_repeat_the_run(finished_run, manifest):
    assert manifest["versions"]["brdfatlas"] == __version__
    assert {"python", "numpy", "mitsuba", "drjit", "snakemake"} <= manifest["versions"].keys()
    assert manifest["config"]["seed"] == 0
    assert manifest["config"]["render"]["seed"] == 1
    assert manifest["revision"]
    assert {material["name"] for material in manifest["inputs"]} == {"pink-felt", "chrome"}
    for material in manifest["inputs"]:
        content = (finished_run.root / manifest["binaries"][material["name"]]).read_bytes()
        assert material["sha256"] == hashlib.sha256(content).hexdigest()
