"""The package without the project around it: an installed copy has its data and renders."""

import os
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
from rendering_materials import variant

from brdfatlas.rendering.images import load_render

ROOT = Path(__file__).resolve().parents[2]


def test_an_installed_package_has_all_it_reads(tmp_path):
    """From the wheel alone, in an empty folder: a stand-in, its fit, a picture of it."""
    variant()  # skips without a usable libLLVM
    source = tmp_path / "project"
    source.mkdir()
    for name in ("src", "config", "workflow"):
        ignored = shutil.ignore_patterns("__pycache__", "*.egg-info")
        shutil.copytree(ROOT / name, source / name, symlinks=True, ignore=ignored)
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, source / name)
    build = ["-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation", "--no-index", "-w", str(tmp_path)]
    subprocess.run([sys.executable, *build, str(source)], check=True, capture_output=True)
    with zipfile.ZipFile(next(tmp_path.glob("brdfatlas-*.whl"))) as wheel:
        wheel.extractall(tmp_path / "installed")
    work = tmp_path / "work"
    work.mkdir()
    for command in (
        ["standin", "chrome", "-o", "chrome.binary"],
        ["fit", "ggx", "chrome.binary", "-o", "ggx.npz"],
        ["render", "ggx.npz", "--spp", "16", "--size", "8", "-o", "ggx.exr"],
    ):
        done = subprocess.run(
            [sys.executable, "-m", "brdfatlas.cli", *command],
            cwd=work,
            env=os.environ | {"PYTHONPATH": str(tmp_path / "installed")},
            capture_output=True,
            text=True,
        )
        assert done.returncode == 0, done.stderr
    render = load_render(work / "ggx.exr")
    assert np.isfinite(render.mean).all()
    assert render.mean[render.mask].max() > 0
    assert render.meta["standin"] == "true"
