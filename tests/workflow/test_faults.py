"""Faults: after a kill, a full disk, damage, a wrong clock the next run completes, with the results of a quiet run."""

import contextlib
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from brdfatlas import load_fit

SMALL = {"materials": ["pink-felt"], "models": ["ggx"], "pdf": False}
FIT = "results/fits/pink-felt/ggx"
RENDERS = "results/renders/pink-felt"
ERRORS = "results/errors/pink-felt/images.tsv"
#: Enough of the run for most faults: stand-in, fit, scene, three renders, errors.
TARGET = ["--", ERRORS]


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory, new_project):
    """A quiet run up to the errors of one material."""
    project = new_project(tmp_path_factory.mktemp("undisturbed"))
    project.configure(**SMALL)
    project.snakemake(*TARGET)
    return project


@pytest.fixture
def finished(undisturbed, tmp_path):
    """A copy of the quiet run, to be disturbed."""
    return copy_run(undisturbed, tmp_path / "copy")


def copy_run(project, destination: Path):
    """A copy of a project with all that its runs made."""
    return type(project)(Path(shutil.copytree(project.root, destination, symlinks=True)))


def results(project) -> list[Path]:
    """Files of the results folder."""
    return [path for path in (project.root / "results").rglob("*") if path.is_file()]


def remove(project, *names: str) -> None:
    for name in names:
        path = project.root / name
        shutil.rmtree(path) if path.is_dir() else path.unlink()


@contextlib.contextmanager
def running(project, *arguments: str) -> Iterator[subprocess.Popen]:
    """Snakemake at work in the background, in a process group of its own."""
    env = os.environ | {"PYTHONPATH": str(project.root / "src")}
    command = [sys.executable, "-m", "snakemake", "--cores", "2", *arguments]
    with open(project.root / "background.log", "w") as log:
        process = subprocess.Popen(
            command, cwd=project.root, env=env, stdout=log, stderr=log, text=True, start_new_session=True
        )
    try:
        yield process
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()


def wait_for(condition: Callable[[], object], process: subprocess.Popen, seconds: float = 300.0) -> object:
    """The first true value of ``condition`` while the process lives."""
    deadline = time.monotonic() + seconds
    while time.monotonic() < deadline:
        value = condition()
        if value:
            return value
        assert process.poll() is None, "the run ended before it could be disturbed"
        time.sleep(0.05)
    raise AssertionError("the moment to disturb the run did not come")


def jobs_of(project, script: str) -> list[int]:
    """Processes that run a script of this copy of the project."""
    found = []
    for entry in Path("/proc").iterdir():
        if not entry.name.isdigit():
            continue
        with contextlib.suppress(OSError):
            command = (entry / "cmdline").read_bytes().split(b"\0")
            here = os.readlink(entry / "cwd") == str(project.root)
            if here and any(Path(os.fsdecode(part)).name.endswith(script) for part in command):
                found.append(int(entry.name))
    return found


needs_proc = pytest.mark.skipif(not Path("/proc/self/cmdline").exists(), reason="finds processes in /proc")


@needs_proc
def test_a_killed_job_is_run_again(finished, undisturbed, differences):
    remove(finished, f"{FIT}.npz", f"{FIT}.json", ERRORS)
    with running(finished, *TARGET) as process:
        for job in wait_for(lambda: jobs_of(finished, "fit_models.py"), process):
            os.kill(job, signal.SIGKILL)
        assert process.wait(300) != 0
    assert not (finished.root / f"{FIT}.json").exists()
    finished.snakemake(*TARGET)
    assert differences(finished, undisturbed) == []


@needs_proc
@pytest.mark.parametrize(("script", "keys"), [("fit_models.py", {"seed": 1}), ("render_material.py", {"render": {}})])
def test_after_a_job_killed_at_what_has_changed_the_next_run_comes_to_it_again(finished, script, keys):
    """Its outputs are there again, of the time before the change."""
    finished.configure(**{key: value or {"size": 16, "samples": 16, "batches": 4} for key, value in keys.items()})
    owed = finished.planned(*TARGET)
    assert owed
    with running(finished, *TARGET) as process:
        for job in wait_for(lambda: jobs_of(finished, script), process):
            os.kill(job, signal.SIGKILL)
        assert process.wait(300) != 0
    assert owed.keys() - {"prepare_scene"} <= finished.planned().keys()
    finished.snakemake()
    assert finished.planned() == {}


def test_what_an_earlier_run_fitted_anew_is_rendered_and_judged_by_the_next(finished):
    """Also where the run between ended after the fits."""
    change_a_model(finished)
    finished.snakemake("--until", "fit_dupuy2015")
    planned = finished.planned()
    assert not any(rule.startswith("fit_") for rule in planned)
    assert {"render_material", "measure_errors", "draw_figures", "write_fits", "write_viewer"} <= planned.keys()


@needs_proc
def test_after_a_killed_snakemake_the_next_run_completes_once_unlocked(finished, undisturbed, differences):
    remove(finished, RENDERS, ERRORS)
    with running(finished, *TARGET) as process:
        wait_for(lambda: jobs_of(finished, "render_material.py"), process)
        os.kill(process.pid, signal.SIGKILL)  # its jobs live on, as after a real kill
        process.wait()
        assert list((finished.root / ".snakemake" / "locks").iterdir()), "the dead run left its lock"
        refused = finished.snakemake(*TARGET, check=False)
        assert refused.returncode != 0
        assert "--unlock" in refused.stdout
        finished.snakemake("--unlock")
        finished.snakemake(*TARGET)
    assert differences(finished, undisturbed) == []


DAMAGED = {
    f"{FIT}.npz": "render_material",
    f"{RENDERS}/ggx/studio_sphere.exr": "measure_errors",
    f"{FIT}.json": "measure_errors",
}


@pytest.mark.parametrize("name", DAMAGED)
def test_a_damaged_result_stops_its_job_with_its_name_and_the_remedy(finished, undisturbed, differences, name):
    path = finished.root / name
    whole, status = path.read_bytes(), path.stat()
    path.write_bytes(whole[: len(whole) // 2])
    os.utime(path, ns=(status.st_atime_ns, status.st_mtime_ns))
    done = finished.snakemake("--forcerun", DAMAGED[name], *TARGET, check=False)
    assert done.returncode == 1
    said = [line for line in done.stdout.splitlines() if "is damaged, delete it" in line]
    assert said
    assert all(name in line for line in said)
    path.unlink()
    finished.snakemake("--forcerun", DAMAGED[name], *TARGET, name)
    assert differences(finished, undisturbed) == []


@contextlib.contextmanager
def mounted(folder: Path, *options: str) -> Iterator[None]:
    """Something mounted on ``folder``; skips where this user may not."""
    folder.mkdir(parents=True, exist_ok=True)
    done = subprocess.run(["mount", *options, str(folder)], capture_output=True, text=True)
    if done.returncode:
        pytest.skip(f"this user cannot mount: {done.stderr.strip()}")
    try:
        yield
    finally:
        subprocess.run(["umount", "-l", str(folder)], check=True)


def test_after_a_full_disk_the_next_run_completes(finished, undisturbed, differences):
    remove(finished, RENDERS, ERRORS)
    with mounted(finished.root / RENDERS, "-t", "tmpfs", "-o", "size=16k", "tmpfs"):
        done = finished.snakemake(*TARGET, check=False)
        assert done.returncode == 1
        assert "No space left on device" in done.stdout
        whole = [path for path in (finished.root / RENDERS).rglob("*.exr") if not path.name.startswith(".")]
        assert whole == [], "no render is there that is not whole"
    finished.snakemake(*TARGET)
    assert differences(finished, undisturbed) == []


@pytest.mark.parametrize(("folder", "named"), [("results", "results"), (".", ".snakemake")])
def test_after_a_folder_that_cannot_be_written_the_next_run_completes(
    finished, undisturbed, differences, folder, named
):
    closed = finished.root / folder
    with mounted(closed, "--bind", str(closed)):
        subprocess.run(["mount", "-o", "remount,ro,bind", str(closed)], check=True)
        done = finished.snakemake("--forcerun", "measure_errors", *TARGET, check=False)
    assert done.returncode == 1
    assert f"{named}: cannot be written to" in done.stdout
    assert "Traceback" not in done.stdout
    finished.snakemake("--forcerun", "measure_errors", *TARGET)
    assert differences(finished, undisturbed) == []


def change_a_model(project) -> None:
    path = project.root / "config" / "models.yaml"
    path.write_text(path.read_text().replace("ggx: {}", "ggx: {fresnel: egsr2015}"))


def test_without_snakemakes_records_nothing_old_stands_as_new(finished, undisturbed, differences):
    """What is still right is kept."""
    remove(finished, ".snakemake")
    finished.snakemake(*TARGET)
    assert f"{FIT}.npz: kept" in (finished.root / "results/logs/fit_dupuy2015/pink-felt.log").read_text()
    assert differences(finished, undisturbed) == []
    assert not finished.planned(*TARGET)
    change_a_model(finished)
    remove(finished, ".snakemake")
    finished.snakemake(*TARGET)
    assert load_fit(finished.root / f"{FIT}.npz").options["fresnel"] == "egsr2015"
    assert f"{RENDERS.removeprefix('results/')}/ggx/studio_sphere.exr" in differences(finished, undisturbed)


def test_results_of_the_future_stop_the_run_with_a_remedy_that_works(finished, undisturbed, differences):
    """As after a clock that was set back; Snakemake would fail all that is made of them."""
    for path in results(finished):
        os.utime(path, (time.time() + 86400,) * 2)
    change_a_model(finished)
    done = finished.snakemake(*TARGET, check=False)
    assert done.returncode == 1
    assert "of a time to come" in done.stdout
    remedy = done.stdout.split("`")[1]
    (finished.root / "reports").mkdir(exist_ok=True)
    subprocess.run(remedy, shell=True, cwd=finished.root, check=True)
    finished.snakemake("--forceall", *TARGET)
    assert load_fit(finished.root / f"{FIT}.npz").options["fresnel"] == "egsr2015"
    shutil.copy(undisturbed.root / "config" / "models.yaml", finished.root / "config" / "models.yaml")
    finished.snakemake(*TARGET)
    assert differences(finished, undisturbed) == []


def test_a_run_without_cores_is_refused(finished):
    """Snakemake would wait without end."""
    change_a_model(finished)
    done = finished.snakemake("--cores", "0", *TARGET, check=False)
    assert done.returncode == 1
    assert "--cores 0: " in done.stdout
    assert "fit_dupuy2015" in finished.jobs(finished.snakemake("--cores", "0", "--dry-run", *TARGET).stdout)


BROKEN = '''
"""A model that fails."""

from brdfatlas.models.dupuy2015 import ggx


class Broken(ggx.GGX):
    name = "broken"
    title = "Broken"

    def fit(self, *arguments, **options):
        raise RuntimeError("the lamp is out <script>alert('reason')</script>")
'''


@pytest.mark.slow
def test_failures_stop_nothing_but_are_told_in_report_and_exit_status(undisturbed, tmp_path):
    """A model that raises, a file cut short, files with hostile names: all of a run, to the report."""
    project = copy_run(undisturbed, tmp_path / "copy")
    merl = project.root / "data" / "merl"
    merl.mkdir(parents=True)
    good = project.root / "results" / "standins" / "pink-felt.binary"
    good.rename(merl / "felt.binary")
    (merl / "half.binary").write_bytes((merl / "felt.binary").read_bytes()[:10_000_000])
    hostile = ["a b; touch pwned.binary", "$(touch pwned).binary", "<script>alert('name')<script>.binary", "..binary"]
    for name in [*hostile, "new\nline.binary"]:
        (merl / name).symlink_to("felt.binary")
    (project.root / "broken.py").write_text(BROKEN)
    models = project.root / "config" / "models.yaml"
    models.write_text("ggx: {}\nbroken: {source: broken.py}\n")
    project.configure(**SMALL | {"materials": "all", "models": "all"})

    done = project.snakemake(check=False)
    assert done.returncode == 1
    assert "1 of 2 fits failed" in done.stdout
    told = next(line for line in done.stdout.splitlines() if line.startswith("broken on felt: "))
    assert "RuntimeError: the lamp is out" in told
    assert json.loads((project.root / "results/fits/felt/ggx.json").read_text())["status"] == "ok"
    assert (project.root / "results" / "errors" / "felt" / "images.tsv").stat().st_size > 0
    pages = {path: path.read_text() for path in (project.root / "reports").rglob("*.html")}
    index = pages[project.root / "reports" / "index.html"]
    assert "the lamp is out" in "".join(pages.values())
    assert "half.binary: truncated" in index
    for path, text in pages.items():
        assert "<script>alert" not in text, path
    assert not list(project.root.rglob("pwned*"))
    outside = {path.name for path in tmp_path.iterdir()}
    assert outside == {"copy"}
    # Mended, the next run ends well.
    (project.root / "broken.py").write_text(BROKEN.replace("raise", "return super().fit(*arguments, **options) #"))
    project.snakemake()
    assert "the lamp is out" not in (project.root / "reports" / "models" / "broken.html").read_text()
    # An older file of the same size in the place of a measured one: nothing of the first stays.
    os.utime(merl / "felt.binary", ns=(0, 0))
    planned = project.planned()
    assert planned["fit_dupuy2015"] == planned["fit_own_broken"] == 1
    assert planned["render_material"] == planned["measure_errors"] == planned["write_material_page"] == 1
