"""Shared by the hostile cases: tiny inputs, a fit of every model, and the law that each fault obeys."""

import hashlib
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from own_model import OWN_MODEL

import brdfatlas
from brdfatlas.angles import GRID_SHAPE, above_horizon
from brdfatlas.cli import main
from brdfatlas.fits import Fit
from brdfatlas.formats.merl import write_merl


def plausible_fit(name: str, material: str = "felt") -> Fit:
    """A fit of any model that nobody fitted: numbers inside the ranges that the model states."""
    model = brdfatlas.MODELS[name]
    options = model.check_options({})
    parameters = {}
    for parameter in model.parameters_of(options):
        low = parameter.low if np.isfinite(parameter.low) else 0.0
        high = parameter.high if np.isfinite(parameter.high) else low + 0.5
        parameters[parameter.name] = np.full(parameter.shape, low + 0.25 * (high - low), parameter.dtype)
    return Fit(name, material, parameters, options, True)


def state(folder: Path) -> dict[str, str]:
    """What a folder holds: path -> digest of a regular file (of a large one inode, size, time), target of a link,
    kind of all else."""
    found = {}
    for path in sorted(folder.rglob("*")):
        name = str(path.relative_to(folder))
        if "__pycache__" in name:  # Python's own, beside a model's file
            continue
        if path.is_symlink():
            found[name] = f"link to {os.readlink(path)}"
        elif path.is_file() and path.stat().st_size > 2**20:
            found[name] = str([getattr(path.stat(), key) for key in ("st_ino", "st_size", "st_mtime_ns")])
        elif path.is_file():
            found[name] = hashlib.sha256(path.read_bytes()).hexdigest()
        else:
            found[name] = f"mode {path.stat().st_mode:o}"
    return found


@dataclass
class Refused:
    """Run a command that must be refused."""

    capsys: pytest.CaptureFixture
    folder: Path

    def __call__(self, arguments: Sequence[object], *words: str, status: int = 1) -> str:
        """The message, after the law is checked: the exit status, nothing on stdout, one line on stderr that holds
        ``words``, and every file of the folder as it was, none new."""
        before = state(self.folder)
        self.capsys.readouterr()
        try:
            found = main(list(map(str, arguments)))
        except SystemExit as error:
            found = error.code
        out, err = self.capsys.readouterr()
        assert (found, out) == (status, ""), err
        assert err.count("\n") == 1
        assert err.endswith("\n")
        assert "Traceback" not in err
        for word in words:
            assert word in err
        assert state(self.folder) == before
        return err


@pytest.fixture
def refused(capsys: pytest.CaptureFixture, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Refused:
    """refused(arguments, *words): a command line that must be refused; runs in tmp_path."""
    monkeypatch.chdir(tmp_path)
    return Refused(capsys, tmp_path)


@pytest.fixture(scope="session")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with inputs of every kind; links to them are cheap: measured.binary, a fit of every model
    (MODEL.npz), picture.exr, scenes.yaml, probe.exr, model.py."""
    from brdfatlas.rendering.images import Render, save_render

    folder = tmp_path_factory.mktemp("inputs")
    table = np.full((*GRID_SHAPE, 3), 0.1, np.float32)
    table[~above_horizon()] = np.nan
    write_merl(folder / "measured.binary", table)
    for name in brdfatlas.MODELS:
        plausible_fit(name).save(folder / f"{name}.npz")
    batches = np.random.default_rng(0).random((4, 8, 8, 3)).astype(np.float32)
    meta = {"status": "ok", "scene": "a", "exposure": "1.0", "gamma": "2.2"}
    save_render(folder / "picture.exr", Render(batches.mean(0), batches, np.ones((8, 8), bool), meta))
    save_render(folder / "probe.exr", Render(batches[0, :4], batches[:, :4], np.ones((4, 8), bool)))
    (folder / "model.py").write_text(OWN_MODEL)
    (folder / "scenes.yaml").write_text(SCENES)
    return folder


@pytest.fixture
def linked(inputs: Path, tmp_path: Path) -> Callable[[str], Path]:
    """linked(name): one of the inputs in tmp_path, as a hard link."""

    def link(name: str) -> Path:
        os.link(inputs / name, tmp_path / name)
        return tmp_path / name

    return link


SCENES = """
mine:
  geometry: [{shape: sphere, surface: material}]
  camera: {origin: [0, 0, 4], target: [0, 0, 0], fov: 30}
  environment: {kind: file, file: probe.exr}
  exposure: 1.0
  gamma: 2.2
"""
