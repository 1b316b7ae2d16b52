"""Which model to take for a material, and its files: every candidate fitted, rendered small, ranked by dE00.

    found = brdfatlas.recommend("chrome.binary", budget=64)
    found.winner.model, found.fits[found.winner.model]
    found.save("chrome-recommended")

Fits run in worker processes. So a script keeps its own code behind ``if __name__ == "__main__":``, or asks for
``processes=1``.
"""

import multiprocessing
import os
import pickle
import shutil
import signal
import sys
import tempfile
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from multiprocessing import resource_tracker
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from brdfatlas import interrupts
from brdfatlas.constants import REFERENCE
from brdfatlas.files import (
    ENDINGS,
    FileFault,
    atomic_path,
    check_length,
    check_new_folders,
    digests,
    ours,
    read_record,
    shown,
    write_json,
)
from brdfatlas.fits import Fit, check_material, fit
from brdfatlas.formats.reader import read
from brdfatlas.measured import Measured, MeasuredError
from brdfatlas.measures.recommendation import Candidate, choose
from brdfatlas.models import MODELS, Entry

if TYPE_CHECKING:
    from brdfatlas.measures.errors import Tone
    from brdfatlas.rendering.images import Render

#: Targets that ``target`` may name: materials that hold a model exactly.
TARGETS = ("mitsuba", "materialx", "gltf")
SCENE, BATCHES = "studio_sphere", 8
#: Ending of a file of a recommendation -> its kind.
KINDS = {ending: kind for kind, endings in ENDINGS.items() for ending in endings}
PICTURE, TABLE = "side-by-side.png", "recommendation.json"


@dataclass(frozen=True)
class Row(Candidate):
    """A candidate with the other numbers of its picture; ``reason`` says why one has none."""

    flip: float = float("nan")
    psnr_db: float = float("nan")
    reason: str = ""


@dataclass(frozen=True, eq=False)
class Recommendation:
    """What was tried on a material and what came out best.

    ``rows``: best first, those without a picture last. ``winner``: None where nothing meets the conditions. ``fits``
    and ``renders`` by entry; ``renders["reference"]`` is the material itself, ``tone`` how pictures are shown.
    """

    material: str
    rows: tuple[Row, ...]
    winner: Row | None
    fits: Mapping[str, Fit]
    renders: Mapping[str, "Render"]
    tone: "Tone"

    def table(self) -> str:
        """The rows as text, the winner marked; the last column: formats that hold it exactly, which an engine loads
        without our plugin."""
        lines = [f"  {'model':18} {'dE00':>6} {'FLIP':>7} {'PSNR':>7} {'bytes':>9} {'seconds':>8}  without plugin"]
        for row in self.rows:
            mark = ">" if row is self.winner else " "
            if row.reason:
                lines.append(f"{mark} {row.model:18} {row.reason}")
                continue
            lines.append(
                f"{mark} {row.model:18} {row.de00:6.2f} {row.flip:7.4f} {row.psnr_db:7.2f} {row.bytes:9,} "
                f"{row.seconds:8.2f}  {', '.join(row.targets) or '-'}"
            )
        return "\n".join(lines)

    def save(self, folder: str | os.PathLike) -> list[Path]:
        """Write the winner's fit and all its exports (a MERL table has ``brdfatlas table``), a picture of the material
        beside it, and the table; returns the files. Those of an earlier recommendation go, unless they have changed.
        ValueError without a winner, FileFault (:func:`check_folder`) for a folder that holds other files."""
        if self.winner is None:
            raise ValueError(f"{self.material}: no model meets the conditions, there is nothing to write")
        check_folder(folder, self.material, [self.winner.model])
        folder = Path(folder)
        folder.parent.mkdir(parents=True, exist_ok=True)
        # A full disk or an interrupt leaves the folder as it was, not with half of the files.
        with interrupts.unwound(), tempfile.TemporaryDirectory(prefix=".recommend.", dir=folder.parent) as staged:
            files = self._write(Path(staged))
            folder.mkdir(exist_ok=True)
            earlier = {name for name, unchanged in _earlier(folder).items() if unchanged}
            for path in files:
                os.replace(path, folder / path.name)
        for name in earlier - {path.name for path in files}:
            (folder / name).unlink()
        return [folder / path.name for path in files]

    def _write(self, folder: Path) -> list[Path]:
        """Write what :meth:`save` says into an empty folder."""
        from brdfatlas.export import targets

        assert self.winner is not None
        chosen = self.fits[self.winner.model]
        stem = folder / targets.stem_of(self.material, self.winner.model)
        more = {"dE00 after rendering": f"{self.winner.de00:.3f} (scene {SCENE})"}
        fit_file = Path(f"{stem}.npz")
        chosen.save(fit_file)
        files = [fit_file]
        for target in targets.targets_of(chosen):
            if target != "merl":
                made = targets.export(chosen, target, f"{stem}{targets.ENDINGS[target]}", more)
                files += [path for path in made if path not in files]
        files += [folder / PICTURE, folder / TABLE]
        self.picture(files[-2])
        rows = [asdict(row) for row in self.rows]
        told = {"format": "brdfatlas recommendation 1", "material": self.material, "winner": self.winner.model}
        wrote = digests(folder, [path.name for path in files[:-1]])
        write_json(files[-1], told | {"models": rows, "files": wrote})
        return files

    def picture(self, path: str | os.PathLike, height: int = 384) -> None:
        """The material (left) and the winner's fit (right) under one light, as PNG."""
        from PIL import Image, ImageDraw, PngImagePlugin

        from brdfatlas.rendering.images import tone_map

        assert self.winner is not None
        names = {REFERENCE: self.material, self.winner.model: f"{self.winner.model}  dE00 {self.winner.de00:.2f}"}
        canvas = Image.new("RGB", (2 * height, height + 24), "white")
        draw = ImageDraw.Draw(canvas)
        for column, (name, words) in enumerate(names.items()):
            shown = np.rint(255 * tone_map(self.renders[name].mean, *self.tone)).astype(np.uint8)
            canvas.paste(
                Image.fromarray(shown).resize((height, height), Image.Resampling.BICUBIC), (column * height, 0)
            )
            draw.text((column * height + 6, height + 6), words, fill="black")
        notes = PngImagePlugin.PngInfo()
        notes.add_text("Software", "brdfatlas")
        with atomic_path(path) as temporary:
            canvas.save(temporary, "PNG", pnginfo=notes)


def _earlier(folder: Path) -> dict[str, bool]:
    """Names of the files in a folder that an earlier recommendation wrote -> whether they are still what it wrote."""
    with suppress(ValueError, OSError, AttributeError):
        wrote = read_record(folder / TABLE, "files")["files"]
        return {
            name: digests(folder, [name]) == {name: digest}
            for name, digest in wrote.items()
            if Path(name).name == name and (folder / name).is_file()
        }
    return {}


def check_folder(folder: str | os.PathLike, material: str, models: Iterable[str]) -> None:
    """Refuse, before any fit, a folder in which :meth:`Recommendation.save` could not write, or whose files it would
    replace that are not of an earlier recommendation or were changed since. FileFault, one line; TypeError for what is
    no path."""
    from brdfatlas.export import targets

    check_length(folder)
    if folder == "-":
        raise FileFault("-: several files are written, standard output cannot hold them; name a folder")
    where = Path(folder).absolute()
    parent = next(path for path in (where, *where.parents) if os.path.lexists(path))
    if not os.fspath(folder) or not parent.is_dir() or not os.access(parent, os.W_OK | os.X_OK):
        raise FileFault(f"{shown(folder) or repr('')}: no folder that can be written to; name another")
    check_new_folders((Path(folder), *Path(folder).parents), shown(folder))
    if parent == where and any(where.iterdir()) and not (where / TABLE).exists():
        raise FileFault(f"{shown(folder)}: holds files that are not of an earlier recommendation; name a new folder")
    endings = [".npz", *(ending for target, ending in targets.ENDINGS.items() if target != "merl")]
    earlier = _earlier(where)
    for name in [
        PICTURE,
        TABLE,
        *(targets.stem_of(material, model) + ending for model in models for ending in endings),
    ]:
        path = where / name
        if os.path.lexists(path) and (path.is_symlink() or not path.is_file() or not ours(path, KINDS[path.suffix])):
            raise FileFault(f"{shown(Path(folder) / name)}: is not of an earlier recommendation; name a new folder")
        if not earlier.get(name, True):
            raise FileFault(f"{shown(Path(folder) / name)}: was changed since brdfatlas wrote it; name a new folder")
    of = material
    with suppress(ValueError, OSError):  # none, or an empty one
        of = read_record(where / TABLE, "material")["material"]
    if of != material:
        raise FileFault(f"{shown(folder)}: holds the recommendation for {shown(of)}; name a new folder")


def recommend(
    measured: Measured | str | os.PathLike,
    *,
    budget: int | None = None,
    target: str | None = None,
    models: Sequence[str] | None = None,
    seed: int = 0,
    processes: int = 2,
    size: int = 96,
    samples: int = 64,
    progress: Callable[[str], object] | None = None,
) -> Recommendation:
    """Fit every candidate, render all in one pass, rank by dE00.

    ``budget``: at most so many bytes. ``target``: "mitsuba", "materialx" or "gltf", whose own material must be exactly
    the model; only such models are fitted then. ``models``: entries to try, all by default. ``size`` in pixels and
    ``samples`` a pixel, 8 or more, of the pictures. ``progress`` is called with a line after each step, and before them
    with what was assumed of the file or looks wrong in it.

    Raises ValueError (MeasuredError) for a file that cannot be read, an unknown target or a number out of range,
    TypeError for what is no path or no names, KeyError for an unknown model, ChildProcessError where a worker process
    ends, as it does where a script has its own code outside ``if __name__ == "__main__":``. A model without a
    fit for this material has a row with the reason.
    """
    from brdfatlas.rendering.scenes import check_settings

    _check(budget, target, models, processes)
    check_settings(size, samples, BATCHES, where="")
    tell = progress or (lambda line: None)
    measured = measured if isinstance(measured, Measured) else read(measured)
    check_material(measured, seed)
    if not np.nanmax(measured.table, initial=0) > 0:
        raise MeasuredError(
            f"{measured.path or measured.name}: black, no value is above 0; there is nothing to choose by"
        )
    for warning in measured.provenance.warnings:
        tell(f"{measured.path or measured.name}: {warning}")
    models = [models] if isinstance(models, str) else MODELS if models is None else models
    entries = [MODELS.entry(name) for name in dict.fromkeys(models)]
    if target is not None:
        entries = [entry for entry in entries if target in entry.instance.targets]
    fits: dict[str, Fit] = {}
    reasons: dict[str, str] = {}
    for count, (name, outcome) in enumerate(_fit_all(measured, entries, seed, processes), 1):
        if isinstance(outcome, Fit):
            fits[name], seconds = outcome, outcome.report["seconds"]
            note = "given parameters" if seconds is None else f"{seconds:.2f} s"
        else:
            reasons[name] = note = outcome
        tell(f"fit {count}/{len(entries)} {name}: {note}")
    fits = {entry.name: fits[entry.name] for entry in entries if entry.name in fits}
    tell(f"rendering {len(fits)} fits, {size} x {size}")
    renders, tone, bad = _render(measured, fits, size, samples, seed)
    rows = _rows(entries, fits, renders, tone, reasons | bad)
    conditions = {"budget": budget, "target": target}
    winner = choose(rows, **conditions)  # type: ignore[arg-type]
    return Recommendation(measured.name, tuple(rows), winner, fits, renders, tone)  # type: ignore[arg-type]


def _check(budget: Any, target: Any, models: Any, processes: Any) -> None:
    """ValueError or TypeError for arguments of :func:`recommend` that are none."""
    if target is not None and target not in TARGETS:
        raise ValueError(f"unknown target {target!r}; known targets: {', '.join(TARGETS)}")
    if not isinstance(processes, int | np.integer) or processes < 1:
        raise ValueError(f"processes {processes!r}: a whole number from 1 is wanted")
    if budget is not None and not (isinstance(budget, int | float | np.number) and budget >= 0):
        raise ValueError(f"budget {budget!r}: a number of bytes from 0 is wanted")
    if models is not None and (isinstance(models, bytes) or not isinstance(models, Iterable)):
        raise TypeError(f"models {models!r}: names of models are wanted")


# Fits in workers -------------------------------------------------------------------------------------------------

_measured: Measured | None = None  # of a worker: threads of one process may each fit another material

_starting = threading.Lock()  # so that each thread knows which workers are its own


def _start_worker(path: Path) -> None:
    """A worker ends with the process that it works for, also where that is killed, and takes its file along."""
    global _measured
    _measured = pickle.loads(path.read_bytes())
    sys.stdout = sys.stderr  # what models print is no part of a result
    parent = multiprocessing.parent_process()
    assert parent is not None

    def follow() -> None:
        parent.join()
        shutil.rmtree(path.parent, ignore_errors=True)
        os._exit(1)

    threading.Thread(target=follow, daemon=True).start()


@contextmanager
def _without_interrupts() -> Iterator[None]:
    """What is started in the block never sees Ctrl-C, which a terminal sends to every process; one that comes
    meanwhile reaches this process afterwards."""
    resource_tracker.ensure_running()  # else the first worker starts it, which lets interrupts through again
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def _apart_from_folder() -> Iterator[None]:
    """What is started in the block imports nothing from the working folder, where a `struct.py` of somebody may be."""
    before = os.environ.get("PYTHONSAFEPATH")
    os.environ["PYTHONSAFEPATH"] = "1"
    try:
        yield
    finally:
        if before is None:
            del os.environ["PYTHONSAFEPATH"]
        else:
            os.environ["PYTHONSAFEPATH"] = before


def _work(entry: Entry, seed: int) -> tuple[str, Fit | str]:
    assert _measured is not None
    return _fit_one(_measured, entry, seed)


def _fit_one(measured: Measured, entry: Entry, seed: int) -> tuple[str, Fit | str]:
    """A fit, or in one line why there is none: a model that fails must not hide what the others can do."""
    try:
        return entry.name, fit(entry, measured, seed=seed)
    except (MemoryError, OSError):
        raise
    except Exception as error:
        return entry.name, f"{type(error).__name__}: {error}".splitlines()[0]


def _fit_all(
    measured: Measured, entries: Sequence[Entry], seed: int, processes: int
) -> Iterator[tuple[str, Fit | str]]:
    """Outcomes as they come. Large fits first, because they take longest and nobody should wait for a last one."""
    order = sorted(entries, key=lambda entry: -entry.bytes)
    may_have_workers = not multiprocessing.current_process().daemon  # as the workers of a multiprocessing.Pool are
    if processes <= 1 or len(order) < 2 or not may_have_workers:
        yield from (_fit_one(measured, entry, seed) for entry in order)
        return
    context = multiprocessing.get_context("spawn")
    mine: set[multiprocessing.process.BaseProcess] = set()
    with interrupts.unwound(), tempfile.TemporaryDirectory(prefix="brdfatlas.") as folder:
        # Not an argument of the workers: one that ends before it has read so much keeps its starter waiting for ever.
        path = Path(folder) / "measured"
        try:
            path.write_bytes(pickle.dumps(measured))
        except OSError as error:
            raise OSError(error.errno, f"{error.strerror}; set TMPDIR to a folder with room", folder) from None
        with ProcessPoolExecutor(min(processes, len(order)), context, _start_worker, (path,)) as pool:
            try:
                with _starting, _apart_from_folder(), _without_interrupts():
                    others = set(multiprocessing.active_children())
                    try:
                        futures = [pool.submit(_work, entry, seed) for entry in order]
                    finally:
                        mine = set(multiprocessing.active_children()) - others
                yield from (future.result() for future in as_completed(futures))
            except BrokenProcessPool:
                raise ChildProcessError(
                    "a worker process ended: it was killed, for want of memory perhaps, or the script that calls "
                    'recommend has its own code outside `if __name__ == "__main__":`; ask for processes=1'
                ) from None
            except BaseException:  # nobody waits for the rest
                for worker in mine:
                    worker.terminate()
                raise


# Pictures --------------------------------------------------------------------------------------------------------


def _render(
    measured: Measured, fits: Mapping[str, Fit], size: int, samples: int, seed: int
) -> tuple[dict[str, "Render"], "Tone", dict[str, str]]:
    """Pictures of the reference and of all fits that are finite where it was measured; why others have none."""
    from brdfatlas.measures.errors import Tone
    from brdfatlas.rendering import use_variant
    from brdfatlas.rendering.jobs import render_models
    from brdfatlas.rendering.scenes import prepare_scene, read_scenes

    use_variant()
    definition = read_scenes()[SCENE]
    scene = prepare_scene(SCENE, definition, size)
    tables: dict[str, np.ndarray | None] = {REFERENCE: None}
    bad = {}
    for name, fitted in fits.items():
        table = fitted.table()
        if np.isfinite(table[:, :, : measured.valid.shape[2]][measured.valid]).all():
            tables[name] = table
        else:
            bad[name] = "the fit is not finite where the material was measured"
    renders = render_models(scene, measured, tables, samples=samples, batches=BATCHES, seed=seed)
    return renders, Tone(float(definition["exposure"]), float(definition["gamma"])), bad


def _rows(
    entries: Iterable[Entry],
    fits: Mapping[str, Fit],
    renders: Mapping[str, "Render"],
    tone: "Tone",
    reasons: Mapping[str, str],
) -> list[Row]:
    """A row an entry, least dE00 first."""
    from brdfatlas.measures.errors import image_errors

    rows = []
    for entry in entries:
        model = entry.instance
        known: dict[str, Any] = {
            "model": entry.name,
            "reciprocal": model.reciprocal,
            "status": model.status,
            "targets": model.targets,
        }
        if entry.name in reasons:
            rows.append(Row(de00=float("nan"), bytes=entry.bytes, reason=reasons[entry.name], **known))
            continue
        errors = image_errors(renders[REFERENCE], renders[entry.name], tone)
        seconds = fits[entry.name].report["seconds"]
        known |= {"bytes": fits[entry.name].bytes, "seconds": float("nan") if seconds is None else seconds}
        shown = {"de00": errors["de00_mean"], "flip": errors["flip_mean"], "psnr_db": errors["psnr_db"]}
        rows.append(Row(**shown, **known))
    return sorted(rows, key=lambda row: (not np.isfinite(row.de00), np.nan_to_num(row.de00), row.bytes, row.model))
