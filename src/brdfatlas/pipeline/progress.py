"""Progress that a person can follow: what is done, how fast, how long it will take; and the ledger of outputs.

A handler of Snakemake's log: it follows the events of jobs, prints a line now and then, and keeps the same lines in
a file. In CI (the variable CI is set) only the file gets them, and the terminal one line at the end.
"""

import atexit
import logging
import os
import re
import sys
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TextIO

#: Rules whose finished jobs say how far materials and models are, with the word for them.
STAGES = {"write_material_page": "materials", "fit_model": "fits", "render_material": "renders"}
#: Snakemake marks outputs with flags, as in "a.exr (update)".
FLAGS = re.compile(r" \([a-z_, ]+\)$")


class Progress(logging.Handler):
    """Follows a run. ``cores``: how many jobs can run at once; ``finished``: called with the outputs of each job."""

    def __init__(
        self,
        log: str | os.PathLike,
        cores: int = 1,
        *,
        finished: Callable[[Sequence[str]], None] | None = None,
        stream: TextIO | None = None,
        clock: Callable[[], float] = time.monotonic,
        environment: Mapping[str, str] = os.environ,
    ) -> None:
        super().__init__(logging.INFO)
        self.log, self.cores, self.finished, self.clock = Path(log), max(1, cores), finished, clock
        self.stream = stream or sys.stderr
        self.quiet = bool(environment.get("CI"))
        self.every = 10.0 if self.stream.isatty() else 60.0
        self.start: float | None = None
        self.said = 0.0
        self.totals: dict[str, int] = {}
        self.done: Counter[str] = Counter()
        self.failed = 0
        self.seconds: Counter[str] = Counter()
        self.rules: dict[int, str] = {}
        self.outputs: dict[int, list[str]] = {}
        self.started: dict[int, float] = {}

    def emit(self, record: logging.LogRecord) -> None:
        """Follow one event; other records are not ours."""
        event = getattr(record, "event", None)
        if event is None:
            return
        follow = getattr(self, f"_{event}", None)
        if follow:
            with suppress(OSError):  # a full disk must not stop the run from saying so itself
                follow(record)

    def _run_info(self, record: logging.LogRecord) -> None:
        self.totals = {rule: count for rule, count in record.stats.items() if rule != "total"}
        if self.start is None:
            self.start = self.said = self.clock()
            atexit.register(self.close_log)

    def _job_info(self, record: logging.LogRecord) -> None:
        self.rules[record.jobid] = record.rule_name
        self.outputs[record.jobid] = [FLAGS.sub("", str(path)) for path in record.output]
        self.started[record.jobid] = self.clock()

    def _job_finished(self, record: logging.LogRecord) -> None:
        rule = self.rules.pop(record.job_id, None)
        if rule is None:
            return
        self.done[rule] += 1
        self.seconds[rule] += self.clock() - self.started.pop(record.job_id, self.clock())
        if self.finished:
            self.finished(self.outputs.pop(record.job_id, []))
        if self.clock() - self.said >= self.every:
            self.say()

    def _job_error(self, record: logging.LogRecord) -> None:
        self.failed += 1
        self.rules.pop(record.jobid, None)
        self.started.pop(record.jobid, None)

    def seconds_left(self) -> float | None:
        """Expected seconds: jobs still to do times the mean duration of their rule, on the cores that were busy so
        far. A rule that has not run yet counts with the mean of all. None before the first job has finished."""
        done = sum(self.done.values())
        if not done or self.start is None:
            return None
        mean = sum(self.seconds.values()) / done
        work = 0.0
        for rule, total in self.totals.items():
            each = self.seconds[rule] / self.done[rule] if self.done[rule] else mean
            work += max(0, total - self.done[rule]) * each
        busy = sum(self.seconds.values()) / max(1e-9, self.clock() - self.start)
        return work / min(max(busy, 1.0), self.cores)

    def line(self) -> str:
        """The state of the run in one line."""
        done, total = sum(self.done.values()), sum(self.totals.values())
        parts = [f"{done} of {total} jobs"]
        parts += [
            f"{word} {self.done[rule]} of {self.totals[rule]}" for rule, word in STAGES.items() if rule in self.totals
        ]
        elapsed = 0.0 if self.start is None else self.clock() - self.start
        if done and elapsed > 0:
            parts.append(f"{60 * done / elapsed:.1f} jobs a minute")
        if self.failed:
            parts.append(f"{self.failed} failed")
        left = self.seconds_left()
        parts.append(f"about {duration(left)} left" if left and done < total else f"{duration(elapsed)} so far")
        return "progress: " + ", ".join(parts)

    def say(self, last: bool = False) -> None:
        """Print the line, and keep it with the time of day in the log."""
        self.said = self.clock()
        line = self.line()
        self.log.parent.mkdir(parents=True, exist_ok=True)
        with open(self.log, "a", encoding="utf-8") as handle:
            handle.write(f"{time.strftime('%Y-%m-%d %H:%M:%S')} {line.removeprefix('progress: ')}\n")
        if last or not self.quiet:
            print(line, file=self.stream, flush=True)

    def close_log(self) -> None:
        """The last line of a run in which a job has finished or failed."""
        if self.done or self.failed:
            with suppress(OSError, ValueError):
                self.say(last=True)


def duration(seconds: float) -> str:
    """ "42 s", "7 min", "3 h 05 min"."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 90 else f"{minutes // 60} h {minutes % 60:02d} min"
