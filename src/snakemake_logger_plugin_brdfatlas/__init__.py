"""Progress that a person can follow: what is done, how fast, how long it will take.

A logger plugin of Snakemake (``--logger brdfatlas``, set in the default profile; Snakemake finds it by the name of this
package). It prints a line now and then and keeps the same lines in results/progress.log. In CI (the variable CI is set)
only the file gets them, and the terminal one line at the end.
"""

import os
import re
import sys
import time
from collections import Counter
from contextlib import suppress
from logging import LogRecord
from pathlib import Path

from snakemake_interface_logger_plugins.base import LogHandlerBase
from snakemake_interface_logger_plugins.common import LogEvent

LOG = Path("results") / "progress.log"
#: What the names of rules begin with whose finished jobs say how far materials and models are; the word for them.
STAGES = {"write_material_page": "materials", "fit_": "fits", "render_material": "renders"}


class LogHandler(LogHandlerBase):
    """Follows the events of a run's jobs. Time is that of the events."""

    writes_to_stream = False  # Snakemake's own lines stay
    writes_to_file = False
    has_filter = True  # every event counts, also where Snakemake shows few
    has_formatter = True
    needs_rulegraph = False

    def __post_init__(self) -> None:
        self.every = 10.0 if sys.stderr.isatty() else 60.0
        self.start = self.now = self.said = 0.0
        self.totals: dict[str, int] = {}
        self.done: Counter[str] = Counter()
        self.seconds: Counter[str] = Counter()
        self.running: dict[int, tuple[str, float]] = {}
        self.failed = 0

    def emit(self, record: LogRecord) -> None:
        """Follow one event; other records are not ours."""
        event, self.now = getattr(record, "event", None), record.created
        if event == LogEvent.RUN_INFO:
            self.totals = {rule: count for rule, count in record.stats.items() if rule != "total"}
            self.start = self.start or self.now
            self.said = self.said or self.now
        elif event == LogEvent.JOB_INFO:
            self.running[record.jobid] = record.rule_name, self.now
        elif event == LogEvent.JOB_ERROR:
            self.failed += 1
            self.running.pop(record.jobid, None)
            for path in getattr(record, "log", None) or ():
                if at_work := unfinished_fit(path):
                    print(f"the process ended while {at_work}: its code, memory or a kill ({path})", file=sys.stderr)
        elif event == LogEvent.JOB_FINISHED and record.job_id in self.running:
            rule, begun = self.running.pop(record.job_id)
            self.done[rule] += 1
            self.seconds[rule] += self.now - begun
            if self.now - self.said >= self.every:
                self.say(sys.stderr if not os.environ.get("CI") else None)

    def seconds_left(self) -> float | None:
        """Expected seconds: jobs still to do times the mean duration of their rule, shared by as many as ran at once
        so far. A rule that has not run yet counts with the mean of all. None before the first job has finished."""
        done = sum(self.done.values())
        if not done:
            return None
        spent = sum(self.seconds.values())
        work = 0.0
        for rule, total in self.totals.items():
            each = self.seconds[rule] / self.done[rule] if self.done[rule] else spent / done
            work += max(0, total - self.done[rule]) * each
        return work / max(1.0, spent / max(1e-9, self.now - self.start))

    def line(self) -> str:
        """The state of the run in one line."""
        done, total, elapsed = sum(self.done.values()), sum(self.totals.values()), self.now - self.start
        parts = [f"{done} of {total} jobs"]
        for start, word in STAGES.items():
            rules = [rule for rule in self.totals if rule.startswith(start)]
            if rules:
                parts.append(
                    f"{word} {sum(self.done[rule] for rule in rules)} of {sum(self.totals[rule] for rule in rules)}"
                )
        if done and elapsed > 0:
            parts.append(f"{60 * done / elapsed:.1f} jobs a minute")
        if self.failed:
            parts.append(f"{self.failed} failed")
        left = self.seconds_left()
        parts.append(f"about {duration(left)} left" if left and done < total else f"{duration(elapsed)} so far")
        return ", ".join(parts)

    def say(self, stream=None) -> None:
        """Keep the line with the time of day in the log, and print it. A full disk must not stop the run from saying
        so itself."""
        self.said = self.now
        line = self.line()
        with suppress(OSError):
            LOG.parent.mkdir(parents=True, exist_ok=True)
            with open(LOG, "a", encoding="utf-8") as handle:
                handle.write(f"{time.strftime('%Y-%m-%d %H:%M:%S', time.localtime(self.now))} {line}\n")
        if stream:
            with suppress(OSError):
                print(f"progress: {line}", file=stream, flush=True)

    def close(self) -> None:
        """The last line of a run in which a job has finished or failed."""
        if self.done or self.failed:
            self.say(sys.stderr)
            self.done, self.failed = Counter(), 0
        super().close()


def unfinished_fit(path: str) -> str:
    """ "fitting MODEL to MATERIAL" where the log of a job ends in that fit, without a result or a fault; else ""."""
    try:
        text = "\n" + Path(path).read_text(encoding="utf-8", errors="replace")
    except OSError:
        return ""
    _, begun, rest = text.rpartition("\nfitting ")
    line, _, said = rest.partition("\n")
    return "" if not begun or re.search(r"^Traceback|: (ok|failed|absent)$", said, re.MULTILINE) else f"fitting {line}"


def duration(seconds: float) -> str:
    """ "42 s", "7 min", "3 h 05 min"."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 90 else f"{minutes // 60} h {minutes % 60:02d} min"
