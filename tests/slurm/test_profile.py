"""The small run through a real Slurm with the cluster profile: complete, and equal to the local run."""

import subprocess

import pytest
import yaml

SMALL = {"materials": ["pink-felt"], "models": ["ggx"], "pdf": False}
#: Through fit, renders and errors: what runs on nodes in numbers. The pages after them are rules like these.
TARGET = "results/errors/pink-felt/images.tsv"
#: Of the profile, only what this Slurm lacks (accounting) and what a test need not wait for.
PROFILE = [
    *("--profile", "workflow/profiles/slurm", "--jobs", "2", "--latency-wait", "10"),
    *("--slurm-status-command", "squeue", "--slurm-no-account", "--slurm-init-seconds-before-status-checks", "3"),
    *("--seconds-between-status-checks", "2"),
]


@pytest.fixture(scope="module")
def on_slurm(slurm, tmp_path_factory, new_project):
    """A run through Slurm in which the fit asks for too little memory at first; and what it said."""
    project = new_project(tmp_path_factory.mktemp("on_slurm"))
    project.configure(**SMALL)
    path = project.root / "workflow" / "profiles" / "slurm" / "config.yaml"
    profile = yaml.safe_load(path.read_text())
    profile["set-resources"]["fit_dupuy2015"] = {"mem_mb": "60 if attempt == 1 else 2500"}
    path.write_text(yaml.safe_dump(profile))
    done = project.snakemake(*PROFILE, "--", TARGET)
    return project, done.stdout


def slurm_jobs() -> list[list[str]]:
    """(state, requested memory) of every job that this Slurm knows."""
    done = subprocess.run(
        ["squeue", "--noheader", "--states=all", "--format=%T %m"], capture_output=True, text=True, check=True
    )
    return [line.split() for line in done.stdout.splitlines()]


def test_the_run_completes_through_slurm(on_slurm):
    project, _ = on_slurm
    assert (project.root / TARGET).stat().st_size > 0
    states = [state for state, _ in slurm_jobs()]
    assert states.count("COMPLETED") == 5  # stand-in, scene, fit, renders, errors
    assert "Nothing to be done" in project.snakemake("--", TARGET).stdout


def test_a_job_killed_for_its_memory_comes_back_with_more(on_slurm):
    jobs = slurm_jobs()
    assert [memory for state, memory in jobs if state != "COMPLETED"] == ["60M"]
    assert ["COMPLETED", "2500M"] in jobs


def test_results_equal_those_of_a_local_run(on_slurm, tmp_path, new_project, differences):
    project, _ = on_slurm
    local = new_project(tmp_path)
    local.configure(**SMALL)
    local.snakemake("--", TARGET)
    assert differences(project, local) == []
