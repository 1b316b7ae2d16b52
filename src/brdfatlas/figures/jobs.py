"""Which figures a material and a run get. The body of the rules draw_figures and draw_summary."""

import os
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from brdfatlas.figures.factors import plot_convergence, plot_factors, plot_slices, plot_weights
from brdfatlas.figures.functions import plot_functions
from brdfatlas.figures.lobes import plot_lobes
from brdfatlas.figures.summary import plot_summary
from brdfatlas.files import digests, read_json, write_json
from brdfatlas.fits import Fit, load_fit
from brdfatlas.formats import read
from brdfatlas.measures.tsv import read_tsv
from brdfatlas.models import MODELS


def register(model_files: Mapping[str, str]) -> None:
    """Make models outside the package known: name -> path."""
    for name, path in model_files.items():
        MODELS.register_file(name, path)


def titles_of(models: Sequence[str]) -> dict[str, str]:
    """name -> title for legends; a name where two models share a title."""
    titles = {name: MODELS[name].title for name in models}
    shared = {title for title in titles.values() if list(titles.values()).count(title) > 1}
    return {name: name if title in shared else title for name, title in titles.items()}


def load_fits(models: Sequence[str], folder: str | os.PathLike) -> dict[str, Fit]:
    """The fits in ``folder`` ({model}.npz, {model}.json) that did not fail, in order."""
    folder = Path(folder)
    good = [name for name in models if read_json(folder / f"{name}.json")["status"] == "ok"]
    return {name: load_fit(folder / f"{name}.npz") for name in good}


def has_factors(fit: Fit) -> bool:
    """Whether a fit is one of Bagher et al. 2016 or of their kind, drawn as curves and slices: a diffuse part or a
    table over (theta_h, theta_d), and factors over the cells of the grid."""
    names = set(fit.parameters)
    return "b" in names or ("rho_d" in names and bool({"d", "u"} & names))


def figures_job(
    binary: str | os.PathLike,
    models: Sequence[str],
    model_files: Mapping[str, str],
    fits: str | os.PathLike,
    folder: str | os.PathLike,
    listing: str | os.PathLike,
) -> None:
    """Draw the figures of one material into ``folder`` and write a list of them, {"figures": {name: SHA-256}}, which
    changes with any of them.

    lobes.svg with every model that has a fit (the reference alone if none has); functions-{model}.svg where a model has
    an NDF and a Fresnel curve; for factor models factors-{model}.svg, convergence-{model}.svg, slices.webp and
    weights.svg. Figures of an earlier run that this one does not draw are removed.
    """
    register(model_files)
    folder = Path(folder)
    measured, loaded, titles = read(binary), load_fits(models, fits), titles_of(models)
    tables = {titles[name]: fit.table() for name, fit in loaded.items()}
    plot_lobes(measured.table, measured.valid, tables or {"reference, no fit": measured.table}, folder / "lobes.svg")
    drawn = {"lobes.svg"}
    factored = {titles[name]: fit for name, fit in loaded.items() if has_factors(fit)}
    if factored:
        plot_slices(measured, factored, folder / "slices.webp")
        plot_weights(measured, folder / "weights.svg")
        drawn |= {"slices.webp", "weights.svg"}
    for name, fit in loaded.items():
        title = titles[name]
        others = {titles[other]: loaded[other] for other in loaded if other != name}
        path = folder / f"functions-{name}.svg"
        if plot_functions(fit, path, others=others, title=title):
            drawn.add(path.name)
        path = folder / f"factors-{name}.svg"
        if title in factored and plot_factors({title: fit}, path):
            drawn.add(path.name)
        path = folder / f"convergence-{name}.svg"
        channels = (read_json(Path(fits) / f"{name}.json").get("details") or {}).get("channels")
        if title in factored and channels and plot_convergence(channels, path, title=title):
            drawn.add(path.name)
    for pattern in ("functions-*.svg", "factors-*.svg", "convergence-*.svg", "slices.webp", "weights.svg"):
        for path in folder.glob(pattern):
            if path.name not in drawn:
                path.unlink()
    write_json(listing, {"figures": digests(folder, sorted(drawn))})


def summary_job(
    errors: Iterable[str | os.PathLike],
    descriptions: Iterable[str | os.PathLike],
    models: Sequence[str],
    model_files: Mapping[str, str],
    path: str | os.PathLike,
) -> None:
    """Draw the sorted PSNR curves of all models over all materials (Bagher et al. 2016, Fig. 8)."""
    register(model_files)
    facts = [read_json(item) for item in descriptions]
    diffuseness = {item["name"]: item["diffuseness"] for item in facts}
    plot_summary(read_tsv(errors), diffuseness, path, titles=titles_of(models), models=models)
