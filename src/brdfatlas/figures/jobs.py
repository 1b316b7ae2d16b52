"""Which figures a material gets. The body of the rule draw_figures."""

import json
import os
from collections.abc import Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from brdfatlas.constants import REFERENCE
from brdfatlas.figures.curves import function_curves, plot_curves
from brdfatlas.figures.factors import plot_convergence, plot_slices, plot_weights, slice_of
from brdfatlas.figures.functions import plot_functions
from brdfatlas.figures.lobes import lobe_curves, plot_lobes
from brdfatlas.figures.samples import plot_samples
from brdfatlas.figures.tables import has_few_products, table_file, write_table
from brdfatlas.files import digests, read_record, write_json, write_text
from brdfatlas.fits import Fit, known_details, load_fit
from brdfatlas.formats.reader import read
from brdfatlas.measured import extend
from brdfatlas.models import MODELS

#: What an earlier run, with other fits, may have drawn beside what every run draws.
SOMETIMES = ("functions.svg", "slices.webp", "weights.svg", "samples.svg")
OF_A_FIT = ("functions/{}.svg", "convergence/{}.svg", "tables/{}.js")


def titles_of(models: Sequence[str]) -> dict[str, str]:
    """name -> title for legends; a name where two models share a title."""
    titles = {name: MODELS[name].title for name in models}
    shared = {title for title in titles.values() if list(titles.values()).count(title) > 1}
    return {name: name if title in shared else title for name, title in titles.items()}


def load_fits(models: Sequence[str], folder: str | os.PathLike) -> dict[str, Fit]:
    """The fits in ``folder`` ({model}.npz, {model}.json) that did not fail, in order."""
    folder = Path(folder)
    good = [name for name in models if read_record(folder / f"{name}.json", "status")["status"] == "ok"]
    return {name: load_fit(folder / f"{name}.npz") for name in good}


def figures_job(
    binary: str | os.PathLike,
    models: Sequence[str],
    fits: str | os.PathLike,
    folder: str | os.PathLike,
    listing: str | os.PathLike,
) -> None:
    """Draw the figures of one material into ``folder`` and write a list of them, {"figures": {file: SHA-256}}, which
    changes with any of them.

    lobes.svg with every model that has a fit (the reference alone if none has); the numbers of the page's charts in
    curves.js, functions.svg with the functions of all fits; functions/{model}.svg where a fit has named functions;
    convergence/{model}.svg where its report has a curve for each channel; slices.webp and weights.svg where a fit is a
    sum of products; samples.svg of scattered data; tables/{model}.js for the viewer, of the reference and of every fit
    that is not shown by its factors. What an earlier run drew of these models and this one does not is removed.
    """
    folder = Path(folder)
    measured, loaded, titles = read(binary), load_fits(models, fits), titles_of(models)
    factors = {name: fit.factors() for name, fit in loaded.items()}
    drawn, slices = set(), {}

    def written(name: str, table: np.ndarray) -> np.ndarray:
        """The table extended, and written for the viewer if that has no factors to show the model by."""
        if factors.get(name) is not None:
            slices[titles[name]] = slice_of(table)
        full = extend(table, measured.valid)
        if not has_few_products(factors.get(name)):
            path = table_file(folder, name)
            write_table(path, f"{folder.name}/{name}", full)
            drawn.add(path.relative_to(folder).as_posix())
        return full

    reference = written(REFERENCE, measured.table)
    # One table at a time: those of all models would be a gigabyte.
    lobes = lobe_curves(reference, ((name, written(name, fit.table())) for name, fit in loaded.items()))
    charts = function_curves({name: fit.functions() for name, fit in loaded.items()})
    content = json.dumps({"functions": charts, "lobes": lobes}, separators=(",", ":"))
    # A script, for a page from a file may run one, but not read a file.
    write_text(folder / "curves.js", f"window.ATLAS_CURVES({content});\n")
    plot_lobes(
        lobes if loaded else lobes | {"models": {"reference, no fit": lobes["reference"]}}, titles, folder / "lobes.svg"
    )
    drawn |= {"curves.js", "lobes.svg"}
    if plot_curves(charts, titles, folder / "functions.svg"):
        drawn.add("functions.svg")
    if plot_samples(measured, folder / "samples.svg"):
        drawn.add("samples.svg")
    if slices:
        plot_slices(measured, slices, folder / "slices.webp")
        plot_weights(measured, folder / "weights.svg")
        drawn |= {"slices.webp", "weights.svg"}
    for name, fit in loaded.items():
        drawn |= _draw_fit(fit, titles[name], read_record(Path(fits) / f"{name}.json", "status"), folder, name)
    of_fits = (pattern.format(name) for pattern in OF_A_FIT for name in models)
    for name in chain(SOMETIMES, of_fits):
        if name not in drawn:
            (folder / name).unlink(missing_ok=True)
    write_json(listing, {"figures": digests(folder, sorted(drawn))})


def _draw_fit(fit: Fit, title: str, report: Mapping[str, Any], folder: Path, name: str) -> set[str]:
    """The figures of one fit below ``folder``; returns their names there."""
    drawn, file = set(), f"{name}.svg"
    if plot_functions(fit, folder / "functions" / file):
        drawn.add(f"functions/{file}")
    channels = known_details(report)["channels"]
    if channels and plot_convergence(channels, folder / "convergence" / file, title=title):
        drawn.add(f"convergence/{file}")
    return drawn
