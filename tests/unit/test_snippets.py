"""The snippets of README.md and docs/: each runs as it stands, on built-in stand-ins, or is listed with a reason."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
#: Commands that are not run here, by how they begin, each with the reason.
NOT_RUN = {
    "make ": "sets up and runs everything; CI calls it",
    "snakemake ": "a download, or hours; tests/workflow runs the small ones",
    "pip install": "downloads",
    ". .venv/bin/activate": "a matter of the shell",
    "brdfatlas recommend ": "many fits, a minute; tests/unit/test_recommend.py runs it small",
}
#: Names that a Python block takes from the text around it: page and the block's first line -> how they are made.
GIVEN = {
    ("README.md", "import brdfatlas"): "import numpy as np\nwi = wo = np.array([[0.6, 0, 0.8]])",
    ("mitsuba.md", "from brdfatlas.rendering.jobs import render_models"): """
import brdfatlas
from brdfatlas.rendering.scenes import prepare_scene, read_scenes
scene = prepare_scene("studio_sphere", read_scenes()["studio_sphere"], 16, 8)
measured, fit = brdfatlas.read("chrome.binary"), brdfatlas.load_fit("chrome-ggx.npz")
""",
}


def blocks(language: str) -> list[tuple[str, str]]:
    """(page, text) of every fenced block of a language."""
    fence = re.compile(rf"^```{language}\n(.*?)^```", re.M | re.S)
    return [(page.name, text) for page in PAGES for text in fence.findall(page.read_text())]


def commands() -> list[str]:
    """Every command of every block once, in the order of the pages, without its comment."""
    lines = [re.sub(r"\s+#.*", "", line) for _, text in blocks("bash") for line in text.splitlines()]
    return list(dict.fromkeys(filter(None, lines)))


def reason(command: str) -> str:
    return next((reason for start, reason in NOT_RUN.items() if command.startswith(start)), "")


def test_paths_and_links_of_the_pages_exist():
    rooms = "|".join(path.name for path in [*ROOT.iterdir(), *(ROOT / "src" / "brdfatlas").iterdir()] if path.is_dir())
    gone = []
    for page in [*PAGES, ROOT / "config" / "README.md", ROOT / "examples" / "own-study" / "README.md"]:
        text = page.read_text()
        named = re.findall(rf"`((?:{rooms})/[\w./-]*)`", text)
        places = (ROOT, ROOT / "src" / "brdfatlas", page.parent)
        gone += [(page.name, path) for path in named if not made(path) and not any((b / path).exists() for b in places)]
        links = re.findall(r"\]\(([^)#:]+?)(?:#[^)]*)?\)", text)
        gone += [(page.name, link) for link in links if not (page.parent / link).exists()]
    assert not gone


def made(path: str) -> bool:
    """Whether a run or a person makes what is there."""
    return path.split("/")[0] in ("results", "reports", "data", "site")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A reader's folder: a measured file, the examples, and the commands on the path."""
    folder = tmp_path_factory.mktemp("reader")
    shutil.copytree(ROOT / "examples", folder / "examples")
    run(folder, "brdfatlas standin chrome -o chrome.binary")
    return folder


def run(folder: Path, *lines: str) -> None:
    environment = {"PYTHONPATH": str(ROOT / "src"), "PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}"}
    script = "\n".join(["set -eux", *lines])
    done = subprocess.run(
        ["bash", "-c", script], cwd=folder, env=os.environ | environment, capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 0, done.stdout[-1000:] + done.stderr[-3000:]


def test_every_block_has_a_language_and_every_reason_a_command():
    for page in PAGES:
        opened = re.findall(r"^```(.*)\n(?:.*\n)*?```$", page.read_text(), re.M)
        assert set(opened) <= {"python", "bash", "yaml", "toml", "text"}, f"{page.name}: {opened}"
    for start in NOT_RUN:
        assert any(command.startswith(start) for command in commands()), f"{start}: no such command, strike it out"
    first = {(page, text.splitlines()[0]) for page, text in blocks("python")}
    assert first >= GIVEN.keys()


def test_commands_run_in_the_order_of_the_pages(folder):
    lines = [command for command in commands() if not reason(command)]
    assert len(lines) >= 10
    run(folder, *lines)
    assert (folder / "chrome.png").exists()
    assert (folder / "chrome.gltf").exists()


def test_python_runs(folder):
    """All blocks in one process, each with its own names, after the commands."""
    run(folder, "[ -f chrome-ggx.npz ] || brdfatlas fit ggx chrome.binary -o chrome-ggx.npz")
    script = folder / "snippets.py"
    parts = [(page, GIVEN.get((page, text.splitlines()[0]), ""), text) for page, text in blocks("python")]
    script.write_text(
        f"for page, given, text in {parts!r}:\n"
        "    names = {}\n"
        "    exec(compile(given, 'given', 'exec'), names)\n"
        "    exec(compile(text, page, 'exec'), names)\n"
    )
    run(folder, "python snippets.py")
