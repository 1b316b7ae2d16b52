"""A job fits the models of a paper to a material; what is still right of an earlier job is kept."""

import json
import os
import shutil
import subprocess
import sys
from dataclasses import replace

import pytest

from brdfatlas import load_fit
from brdfatlas.fits import load_reported
from brdfatlas.formats.merl import write_merl
from brdfatlas.models import Entry, read_entries
from brdfatlas.models.loading import BUILTIN
from brdfatlas.pipeline.jobs import fit_job
from brdfatlas.pipeline.logs import logged
from brdfatlas.pipeline.standins import make_standin
from brdfatlas.settings import CONFIG
from snakemake_logger_plugin_brdfatlas import unfinished_fit

NAMES = ("ggx", "gaussian")
CODE = {name: f"code of {name}" for name in NAMES}


@pytest.fixture(scope="module")
def material():
    return make_standin("pink-felt")


@pytest.fixture(scope="module")
def done(tmp_path_factory, material):
    """A folder in which the job has run once."""
    folder = tmp_path_factory.mktemp("done")
    write_merl(folder / "felt.binary", material.table)
    run(folder)
    return folder


@pytest.fixture
def folder(done, tmp_path):
    """A copy of it, every file old."""
    shutil.copytree(done, tmp_path, dirs_exist_ok=True)
    for path in tmp_path.iterdir():
        os.utime(path, (1e9, 1e9))
    return tmp_path


def run(folder, code=CODE, seed=0, **options):
    """The job; returns the names that were fitted, not kept. ``options``: name -> options of an entry."""
    entries = [Entry(name, name, options.get(name, {})).plain for name in NAMES]
    outputs = {name: tuple(str(folder / f"{name}.{kind}") for kind in ("npz", "json")) for name in NAMES}
    old = {name: report_of(folder, name) for name in NAMES}
    fit_job(entries, seed, str(folder / "felt.binary"), False, outputs, code, str(folder / "made"))
    for paths in outputs.values():
        for path in paths:
            assert os.stat(path).st_mtime > 1e9, "Snakemake would make it again"
    return {name for name in NAMES if report_of(folder, name) != old[name]}  # seconds differ from fit to fit


def report_of(folder, name):
    path = folder / f"{name}.json"
    return path.read_bytes() if path.exists() else b""


def test_nothing_is_fitted_again_that_is_still_right(folder):
    content = {path.name: path.read_bytes() for path in folder.iterdir()}
    assert run(folder) == set()
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == content
    run(folder, ggx={"fresnel": "egsr2015"})
    lines = [(folder / "made").read_text().splitlines(), content["made"].decode().splitlines()]
    assert [new == old for new, old in zip(*lines)] == [False, True], "what Snakemake compares changes with a fit"


@pytest.mark.parametrize(
    ("change", "again"),
    [
        ({"code": CODE | {"ggx": "another"}}, {"ggx"}),
        ({"ggx": {"fresnel": "egsr2015"}}, {"ggx"}),
        ({"seed": 1}, set(NAMES)),
    ],
)
def test_a_change_costs_what_it_changes(folder, change, again):
    assert run(folder, **change) == again
    assert load_fit(folder / "ggx.npz").options["fresnel"] == change.get("ggx", {}).get("fresnel", "corrected")


def test_another_material_costs_all(folder, material):
    write_merl(folder / "felt.binary", 2 * material.table)
    assert run(folder) == set(NAMES)


def truncate(path):
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


@pytest.mark.parametrize(
    "damage",
    [
        lambda folder: (folder / "ggx.npz").unlink(),
        lambda folder: (folder / "ggx.json").unlink(),
        lambda folder: truncate(folder / "ggx.npz"),
        lambda folder: truncate(folder / "ggx.json"),
        lambda folder: (folder / "ggx.npz").write_bytes(b""),
        lambda folder: shutil.copy(folder / "gaussian.npz", folder / "ggx.npz"),
        lambda folder: (folder / "ggx.json").write_text(
            json.dumps(json.loads(report_of(folder, "ggx")) | {"status": "failed"})
        ),
    ],
    ids=["fit lost", "report lost", "fit cut off", "report cut off", "mark of a failure", "another fit", "failed"],
)
def test_a_fault_is_repaired_by_the_job_alone(done, folder, damage):
    damage(folder)
    assert run(folder) == {"ggx"}
    assert (folder / "ggx.npz").read_bytes() == (done / "ggx.npz").read_bytes()


def test_a_fit_of_other_settings_is_not_that_of_a_report_beside_it(folder, tmp_path_factory):
    """As a job leaves it that is killed between the two, or a person who copies one file of another run."""
    other = tmp_path_factory.mktemp("other")
    shutil.copytree(folder, other, dirs_exist_ok=True)
    run(other, ggx={"fresnel": "egsr2015"})
    shutil.copy(other / "ggx.npz", folder / "ggx.npz")
    with pytest.raises(ValueError, match=r"ggx\.npz: not the fit that its report is about; delete it, the next run"):
        load_reported(folder / "ggx.npz", json.loads(report_of(folder, "ggx")), "ggx", "felt")
    assert run(folder) == {"ggx"}
    assert load_fit(folder / "ggx.npz").options["fresnel"] == "corrected"


def ending_job(folder, end):
    """Run a job, with its log, of a model whose fit ends by ``end``; returns that process."""
    source = folder / "ending.py"
    source.write_text(
        "import os\nfrom brdfatlas.models.dupuy2015 import ggx\n\n\nclass Ending(ggx.GGX):\n    name = 'ending'\n\n"
        f"    def fit(self, *arguments, **options):\n        print('mine')\n        {end}\n"
    )
    paths = {"ending": (str(folder / "ending.npz"), str(folder / "ending.json"))}
    job = [[Entry("ending", "ending", source=str(source)).plain], 0, str(folder / "felt.binary"), False, paths]
    code = (
        "from brdfatlas.pipeline.jobs import fit_job\nfrom brdfatlas.pipeline.logs import logged\n"
        f"with logged('log'): fit_job(*{job}, {{'ending': ''}}, 'made')"
    )
    return subprocess.run([sys.executable, "-c", code], cwd=folder)


def test_a_model_that_ends_the_process_well_leaves_no_report_of_an_earlier_fit(folder):
    """Snakemake would take it for that of the job."""
    for kind in ("npz", "json"):
        shutil.copy(folder / f"ggx.{kind}", folder / f"ending.{kind}")
    assert ending_job(folder, "os._exit(0)").returncode == 0
    assert not (folder / "ending.json").exists()


def test_a_reason_says_model_and_material_once(folder):
    assert ending_job(folder, "raise RuntimeError('dark')").returncode == 0
    reason = json.loads(report_of(folder, "ending"))["reason"]
    assert reason.endswith("dark")
    assert "on felt" not in reason
    assert f"ending on felt failed: {reason}" in (folder / "log").read_text()


def test_the_log_names_the_model_that_ended_the_process_and_no_other(folder):
    assert ending_job(folder, "os._exit(3)").returncode == 3
    assert unfinished_fit(folder / "log") == "fitting ending to felt"
    with logged(folder / "log"):
        run(folder, seed=1)
    assert unfinished_fit(folder / "log") == ""
    (folder / "felt.binary").unlink()
    with pytest.raises(SystemExit), logged(folder / "log"):
        run(folder, seed=2)
    assert unfinished_fit(folder / "log") == ""


def test_a_worker_that_a_model_spawns_does_not_run_the_job_again(tmp_path):
    """Its workers would end at once, and a pool starts new ones for ever."""
    script = tmp_path / ".snakemake" / "scripts" / "job.py"
    script.parent.mkdir(parents=True)
    script.write_text(
        "import multiprocessing\nfrom brdfatlas.pipeline.logs import logged\nwith logged('log'):\n"
        "    worker = multiprocessing.get_context('spawn').Process(target=abs, args=(1,))\n"
        "    worker.start()\n    worker.join()\n    assert worker.exitcode == 0\n"
    )
    assert subprocess.run([sys.executable, script], cwd=tmp_path).returncode == 0


def test_a_row_of_given_parameters_follows_its_file(folder):
    row, code = Entry("mine", "ngan", parameters=str(folder / "mine.csv")), {"mine": ""}
    paths = {"mine": (str(folder / "mine.npz"), str(folder / "mine.json"))}
    for kd in (0.1, 0.2):
        header = "material,kd_r,kd_g,kd_b,ks_1,ks_2,ks_3,f0,m"
        (folder / "mine.csv").write_text(f"{header}\nfelt,{kd},{kd},{kd},0.1,0.05,0.02,0.2,0.1\n")
        fit_job([row.plain], 0, str(folder / "felt.binary"), False, paths, code, str(folder / "made"))
        assert load_fit(folder / "mine.npz").parameters["kd"] == pytest.approx(kd)


def test_the_models_of_a_paper_are_one_family_and_one_of_a_user_s_own_is_alone():
    entries = read_entries(CONFIG / "models.yaml")
    rooms = {name: module.split(".")[2] for name, module in BUILTIN.items()}
    assert all(entry.family == rooms[entry.model] for entry in entries.values())
    own = replace(entries["ggx"], name="mine", source="examples/lambertian.py")
    assert own.family == "own_mine"
    assert own.family not in rooms.values()
