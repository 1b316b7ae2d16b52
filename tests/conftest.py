"""Shared by all tests: a small copy of the project in which workflow tests run Snakemake."""

import fcntl
import json
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest
import yaml

#: Before any test imports NumPy: idle BLAS threads spin.
for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(name, "1")

# A shell ignores interrupts for what it runs in the background, and what tests start would inherit that.
signal.signal(signal.SIGINT, signal.default_int_handler)

ROOT = Path(__file__).resolve().parent.parent
#: Made by a run; a copy of the project starts without them.
GENERATED = shutil.ignore_patterns("results", ".snakemake", ".venv", ".git", "*.egg-info")
TINY = {
    "materials": ["pink-felt", "chrome"],
    "models": ["ggx", "gaussian"],
    "scenes": ["studio_sphere"],
    "render": {"size": 24, "samples": 8, "batches": 4},
    "pdf": False,
}


@dataclass(frozen=True)
class Project:
    """A copy of the project with its own sources, configuration and results."""

    root: Path

    def configure(self, **changes) -> None:
        """Change keys of config/config.yaml."""
        path = self.root / "config" / "config.yaml"
        config = yaml.safe_load(path.read_text())
        path.write_text(yaml.safe_dump(config | changes, sort_keys=False))

    def snakemake(self, *arguments: str, check: bool = True, **environment: str) -> subprocess.CompletedProcess:
        """Run Snakemake in the copy; the output is in ``stdout``, messages included."""
        command = [sys.executable, "-m", "snakemake", "--cores", "2", *arguments]
        source = self.root / "src" if (self.root / "src").exists() else ROOT / "src"
        env = os.environ | {"PYTHONPATH": str(source), "COLUMNS": "200"} | environment
        done = subprocess.run(
            command, cwd=self.root, env=env, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, timeout=900
        )
        assert not check or done.returncode == 0, done.stdout[-6000:]
        return done

    def planned(self, *arguments: str) -> dict[str, int]:
        """rule -> number of jobs that a dry run would start."""
        return self.jobs(self.snakemake("--dry-run", *arguments).stdout)

    @staticmethod
    def jobs(output: str) -> dict[str, int]:
        """rule -> number of jobs, from the table that Snakemake prints of a run or a plan."""
        jobs: dict[str, int] = {}
        table = output.rsplit("Job stats:", 1)[-1] if "Job stats:" in output else ""
        for line in table.splitlines()[3:]:
            words = line.split()
            if len(words) != 2 or not words[1].isdigit():
                break
            if words[0] != "total":
                jobs[words[0]] = int(words[1])
        return jobs


def copy_project(destination: Path) -> Project:
    """Copy what a run needs; time stamps are kept, so compiled kernels are found again."""
    for part in ("Snakefile", "workflow", "profiles", "config", "src"):
        source = ROOT / part
        if source.is_dir():
            shutil.copytree(source, destination / part, ignore=GENERATED, symlinks=True)
        else:
            shutil.copy2(source, destination / part)
    project = Project(destination)
    project.configure(**TINY)
    return project


@pytest.fixture(scope="module", autouse=True)
def own_models() -> Iterator[None]:
    """Models that a file's tests made known are forgotten: which files share a process is chance."""
    from brdfatlas.models import MODELS  # not before the threads are set

    with MODELS.restored():
        yield


@pytest.fixture(scope="session")
def shared() -> Path:
    """Data of others that no test may need: beside the project, or where BRDFATLAS_SHARED says."""
    folder = Path(os.environ.get("BRDFATLAS_SHARED", ROOT.parent / "shared"))
    if not (folder / "data").is_dir():
        pytest.skip("needs public data that are not part of the project")
    return folder


@pytest.fixture
def project(tmp_path: Path) -> Project:
    """A fresh small project without results."""
    return copy_project(tmp_path)


@pytest.fixture(scope="session")
def project_in() -> Callable[[Path], Project]:
    """project_in(folder): what is in a folder as a project, with nothing copied."""
    return Project


@pytest.fixture(scope="session")
def finished_run(tmp_path_factory: pytest.TempPathFactory) -> Project:
    """The small project after a complete run. Tests may read it and plan in it, and must restore what they change."""
    if "PYTEST_XDIST_WORKER" not in os.environ:
        project = copy_project(tmp_path_factory.mktemp("finished"))
        project.snakemake()
        return project
    # Processes side by side: one of them runs it, each has a copy.
    run = tmp_path_factory.getbasetemp().parent / "finished"
    with open(f"{run}.lock", "w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not run.exists():
            first = copy_project(tmp_path_factory.mktemp("unfinished"))
            first.snakemake()
            first.root.rename(run)
    return Project(shutil.copytree(run, tmp_path_factory.mktemp("finished") / "run", symlinks=True))


@pytest.fixture(scope="session")
def new_project() -> Callable[[Path], Project]:
    """new_project(folder): a fresh small project there."""
    return copy_project


#: What a run notes of itself tells of times and differs between equal runs.
NOTES = {"logs", "benchmarks", "progress.log"}


def result_files(project: Project) -> dict[str, Path]:
    """Files of the results folder by name, without the run's notes of itself."""
    root = project.root / "results"
    # Hidden files are what a killed writer leaves; the report's last job removes them.
    files = (path for path in root.rglob("*") if path.is_file() and not path.name.startswith("."))
    return {str(path.relative_to(root)): path for path in files if path.relative_to(root).parts[0] not in NOTES}


def what_counts(path: Path) -> object:
    """What must be equal of a file: its bytes; of JSON all but the measured seconds."""
    if path.suffix != ".json":
        return path.read_bytes()
    value = json.loads(path.read_text())
    return {key: item for key, item in value.items() if key != "seconds"} if isinstance(value, dict) else value


def differing_results(project: Project, other: Project) -> list[str]:
    """Names of results that two runs do not have in common, or that differ."""
    mine, theirs = result_files(project), result_files(other)
    return sorted(
        name
        for name in mine.keys() | theirs.keys()
        if name not in mine or name not in theirs or what_counts(mine[name]) != what_counts(theirs[name])
    )


@pytest.fixture(scope="session")
def differences() -> Callable[[Project, Project], list[str]]:
    """differences(project, other): names of results that are not the same in both."""
    return differing_results
