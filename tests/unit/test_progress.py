"""The progress of a run, on a clock of our own."""

import io
import logging

import pytest

from brdfatlas.pipeline.progress import Progress, duration


class Run:
    """Events as Snakemake sends them."""

    def __init__(self, tmp_path, **options):
        self.now, self.stream, self.recorded = 0.0, io.StringIO(), []
        self.log = tmp_path / "progress.log"
        self.progress = Progress(
            self.log,
            **{"cores": 2, "finished": self.recorded.extend, "environment": {}} | options,
            stream=self.stream,
            clock=lambda: self.now,
        )

    def send(self, event, **fields):
        self.progress.handle(logging.makeLogRecord({"event": event, **fields}))

    def job(self, number, rule, seconds, outputs=(), fails=False):
        self.send("job_info", jobid=number, rule_name=rule, output=list(outputs))
        self.now += seconds
        if fails:
            self.send("job_error", jobid=number)
        else:
            self.send("job_finished", job_id=number)


def test_time_left_is_jobs_times_the_mean_of_their_rule(tmp_path):
    run = Run(tmp_path, cores=1)
    run.send("run_info", stats={"fit_model": 10, "render_material": 5, "all": 1, "total": 16})
    assert run.progress.seconds_left() is None
    run.job(1, "fit_model", 2.0)
    run.job(2, "fit_model", 4.0)
    run.job(3, "render_material", 10.0)
    # 8 fits of 3 s, 4 renders of 10 s, one job of a rule not seen yet at the mean of all, 16 / 3 s
    assert run.progress.seconds_left() == pytest.approx(8 * 3 + 4 * 10 + 16 / 3)
    assert "3 of 16 jobs, fits 2 of 10, renders 1 of 5" in run.progress.line()
    assert f"{3 / 16 * 60:.1f} jobs a minute" in run.progress.line()


def test_cores_that_were_busy_share_what_is_left(tmp_path):
    run = Run(tmp_path, cores=2)
    run.send("run_info", stats={"fit_model": 12, "total": 12})
    for first in (1, 3):
        for number in (first, first + 1):
            run.send("job_info", jobid=number, rule_name="fit_model", output=[])
        run.now += 5.0
        for number in (first, first + 1):
            run.send("job_finished", job_id=number)
    assert run.progress.seconds_left() == pytest.approx(8 * 5.0 / 2)


def test_the_terminal_hears_now_and_then_and_the_log_the_same(tmp_path):
    run = Run(tmp_path)
    run.send("run_info", stats={"fit_model": 100, "total": 100})
    for number in range(100):
        run.job(number, "fit_model", 6.0)
    printed = run.stream.getvalue().splitlines()
    assert len(printed) == 10, "600 s, a line a minute where no person watches"
    logged = run.log.read_text().splitlines()
    assert [line.split(" ", 2)[2] for line in logged] == [line.removeprefix("progress: ") for line in printed]


def test_ci_hears_the_end_only(tmp_path):
    run = Run(tmp_path, environment={"CI": "true"})
    run.send("run_info", stats={"fit_model": 100, "total": 100})
    for number in range(100):
        run.job(number, "fit_model", 6.0, fails=number == 7)
    assert run.stream.getvalue() == ""
    run.progress.close_log()
    (line,) = run.stream.getvalue().splitlines()
    assert "99 of 100 jobs" in line
    assert "1 failed" in line


def test_outputs_are_passed_on_without_flags_and_only_of_finished_jobs(tmp_path):
    run = Run(tmp_path)
    run.send("run_info", stats={"render_material": 2, "total": 2})
    run.job(1, "render_material", 1.0, ["results/renders/a/b/c.exr (update)", "results/x.json"])
    run.job(2, "render_material", 1.0, ["results/y.json"], fails=True)
    assert run.recorded == ["results/renders/a/b/c.exr", "results/x.json"]


def test_a_full_disk_does_not_stop_the_run(tmp_path):
    def full(paths):
        raise OSError(28, "No space left on device")

    run = Run(tmp_path, finished=full)
    run.send("run_info", stats={"fit_model": 1, "total": 1})
    run.job(1, "fit_model", 1.0, ["a"])
    assert run.progress.done["fit_model"] == 1


@pytest.mark.parametrize(("seconds", "text"), [(0, "0 s"), (89, "89 s"), (420, "7 min"), (11_100, "3 h 05 min")])
def test_durations_read_well(seconds, text):
    assert duration(seconds) == text
