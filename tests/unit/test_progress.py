"""The progress of a run, from events as Snakemake sends them; time is the events' own."""

import logging
import os
import subprocess
import sys

import pytest

from snakemake_logger_plugin_brdfatlas import LogHandler, duration


class Run:
    def __init__(self, monkeypatch, folder, **environment):
        monkeypatch.chdir(folder)
        monkeypatch.delenv("CI", raising=False)
        for name, value in environment.items():
            monkeypatch.setenv(name, value)
        self.now, self.log = 1_700_000_000.0, folder / "results" / "progress.log"
        self.progress = LogHandler(None, None)

    def send(self, event, **fields):
        self.progress.handle(logging.makeLogRecord({"event": event, "created": self.now, **fields}))

    def job(self, number, rule, seconds, fails=False):
        self.send("job_info", jobid=number, rule_name=rule)
        self.now += seconds
        self.send("job_error", jobid=number) if fails else self.send("job_finished", job_id=number)


@pytest.fixture
def run(monkeypatch, tmp_path):
    return Run(monkeypatch, tmp_path)


def test_time_left_is_jobs_times_the_mean_of_their_rule(run):
    run.send("run_info", stats={"fit_model": 10, "render_material": 5, "all": 1, "total": 16})
    assert run.progress.seconds_left() is None
    run.job(1, "fit_model", 2.0)
    run.job(2, "fit_model", 4.0)
    run.job(3, "render_material", 10.0)
    # 8 fits of 3 s, 4 renders of 10 s, one job of a rule not seen yet at the mean of all, 16 / 3 s
    assert run.progress.seconds_left() == pytest.approx(8 * 3 + 4 * 10 + 16 / 3)
    assert "3 of 16 jobs, fits 2 of 10, renders 1 of 5" in run.progress.line()
    assert f"{3 / 16 * 60:.1f} jobs a minute" in run.progress.line()


def test_the_rules_of_all_papers_count_as_fits(run):
    run.send("run_info", stats={"fit_dupuy2015": 2, "fit_own_mine": 2, "total": 4})
    run.job(1, "fit_dupuy2015", 2.0)
    run.job(2, "fit_own_mine", 2.0)
    assert "2 of 4 jobs, fits 2 of 4" in run.progress.line()


def test_jobs_that_ran_beside_each_other_share_what_is_left(run):
    run.send("run_info", stats={"fit_model": 12, "total": 12})
    for first in (1, 3):
        for number in (first, first + 1):
            run.send("job_info", jobid=number, rule_name="fit_model")
        run.now += 5.0
        for number in (first, first + 1):
            run.send("job_finished", job_id=number)
    assert run.progress.seconds_left() == pytest.approx(8 * 5.0 / 2)


def test_the_terminal_hears_now_and_then_and_the_log_the_same(run, capsys):
    run.send("run_info", stats={"fit_model": 100, "total": 100})
    for number in range(100):
        run.job(number, "fit_model", 6.0)
    printed = capsys.readouterr().err.splitlines()
    assert len(printed) == 10, "600 s, a line a minute where no person watches"
    logged = run.log.read_text().splitlines()
    assert [line.split(" ", 2)[2] for line in logged] == [line.removeprefix("progress: ") for line in printed]


def test_ci_hears_the_end_only(monkeypatch, tmp_path, capsys):
    run = Run(monkeypatch, tmp_path, CI="true")
    run.send("run_info", stats={"fit_model": 100, "total": 100})
    for number in range(100):
        run.job(number, "fit_model", 6.0, fails=number == 7)
    assert capsys.readouterr().err == ""
    run.progress.close()
    run.progress.close()
    (line,) = capsys.readouterr().err.splitlines()
    assert "99 of 100 jobs" in line
    assert "1 failed" in line


def test_a_job_whose_process_ended_in_a_fit_is_told_with_its_model(run, tmp_path, capsys):
    (tmp_path / "log").write_text("results/fits/felt/ggx.npz: ok\nfitting mine to felt\n")
    run.send("job_error", jobid=1, log=["log", "lost.log"])
    (line,) = capsys.readouterr().err.splitlines()
    assert "while fitting mine to felt" in line
    assert "(log)" in line


def test_who_only_looks_leaves_no_trace(run, capsys):
    """A dry run tells of jobs that it does not run."""
    run.send("run_info", stats={"fit_model": 1, "total": 1})
    run.send("job_info", jobid=1, rule_name="fit_model")
    run.progress.close()
    assert capsys.readouterr().err == ""
    assert not run.log.exists()


def test_a_full_disk_does_not_stop_the_run(run):
    (run.log.parent).write_text("no folder")
    run.send("run_info", stats={"fit_model": 1, "total": 1})
    run.job(1, "fit_model", 100.0)
    assert run.progress.done["fit_model"] == 1


def test_snakemake_finds_it_and_calls_it(tmp_path):
    """The events of the Snakemake that is installed have the fields that are used here."""
    (tmp_path / "Snakefile").write_text('rule fit_model:\n    output: "a"\n    shell: "touch {output}"\n')
    command = [sys.executable, "-m", "snakemake", "--cores", "1", "--logger", "brdfatlas"]
    done = subprocess.run(command, cwd=tmp_path, env=os.environ | {"CI": "1"}, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "progress: 1 of 1 jobs, fits 1 of 1" in done.stderr
    assert "1 of 1 jobs" in (tmp_path / "results" / "progress.log").read_text()
    (tmp_path / "Snakefile").write_text(
        'rule fit_model:\n    output: "b"\n    log: "fit.log"\n    shell: "echo fitting mine to felt > {log}; exit 3"\n'
    )
    done = subprocess.run(command, cwd=tmp_path, env=os.environ | {"CI": "1"}, capture_output=True, text=True)
    assert "the process ended while fitting mine to felt" in done.stderr


@pytest.mark.parametrize(("seconds", "text"), [(0, "0 s"), (89, "89 s"), (420, "7 min"), (11_100, "3 h 05 min")])
def test_durations_read_well(seconds, text):
    assert duration(seconds) == text
