"""The package without the project around it: an installed copy has its data and renders."""

import os
import shutil
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import numpy as np
import pytest
from rendering_materials import variant

from brdfatlas.pipeline.standins import write_standin
from brdfatlas.rendering.images import load_render

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    """The wheel, unpacked."""
    folder = tmp_path_factory.mktemp("wheel")
    source = folder / "project"
    source.mkdir()
    for name in ("src", "config", "workflow"):
        ignored = shutil.ignore_patterns("__pycache__", "*.egg-info")
        shutil.copytree(ROOT / name, source / name, symlinks=True, ignore=ignored)
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, source / name)
    build = ["-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation", "--no-index", "-w", str(folder)]
    subprocess.run([sys.executable, *build, str(source)], check=True, capture_output=True)
    with zipfile.ZipFile(next(folder.glob("brdfatlas-*.whl"))) as wheel:
        wheel.extractall(folder / "installed")
    return folder / "installed"


ALONE = """
import os, sys

class Blocked:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in sys.argv[1].split():
            raise ImportError(f"{name} is not installed")

sys.meta_path.insert(0, Blocked())
before = dict(os.environ)
import numpy as np
from threadpoolctl import threadpool_info
threads = [pool["num_threads"] for pool in threadpool_info()]
import brdfatlas
assert dict(os.environ) == before, "the environment is the user's"
assert [pool["num_threads"] for pool in threadpool_info()][: len(threads)] == threads, "so are the threads"
fit = brdfatlas.fit("ggx", brdfatlas.read_merl("chrome.binary"))
fit.save("ggx.npz")
up = np.array([0.0, 0.0, 1.0])
value = brdfatlas.load_fit("ggx.npz").evaluate(up, up)
assert value.shape == (3,) and np.isfinite(value).all() and (value > 0).all()
assert np.array_equal(value, fit.evaluate(up, up))
"""
#: Not among the dependencies of `pip install brdfatlas`.
EXTRAS = "pandas snakemake typst mitsuba drjit matplotlib skimage PIL OpenEXR jinja2 pypdf requests"


def test_fits_need_no_extra(installed, tmp_path):
    """`pip install brdfatlas`: read, fit, save, load, evaluate with all else blocked; nothing outside is changed."""
    write_standin("chrome", tmp_path / "chrome.binary")
    done = subprocess.run(
        [sys.executable, "-c", ALONE, EXTRAS],
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(installed)},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    declared = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert not {name.lower() for name in declared["dependencies"]} & set(EXTRAS.lower().split())


def test_an_installed_package_has_all_it_reads(installed, tmp_path):
    """From the wheel alone, in an empty folder: a stand-in, its fit, a picture of it."""
    variant()  # skips without a usable libLLVM
    work = tmp_path / "work"
    work.mkdir()
    for command in (
        ["standin", "chrome", "-o", "chrome.binary"],
        ["fit", "ggx", "chrome.binary", "-o", "ggx.npz"],
        ["render", "ggx.npz", "--spp", "16", "--size", "8", "-o", "ggx.exr"],
    ):
        done = subprocess.run(
            [sys.executable, "-m", "brdfatlas", *command],
            cwd=work,
            env=os.environ | {"PYTHONPATH": str(installed)},
            capture_output=True,
            text=True,
        )
        assert done.returncode == 0, done.stderr
    render = load_render(work / "ggx.exr")
    assert np.isfinite(render.mean).all()
    assert render.mean[render.mask].max() > 0
    assert render.meta["standin"] == "true"
