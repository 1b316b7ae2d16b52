"""The files of a fit below reports/, so that a copy of that folder is complete: ``fits/{material}-{model}{ending}``
beside the pictures of its material."""

import os
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from brdfatlas.export.facts import ExportError, with_report
from brdfatlas.export.targets import ENDINGS as TARGET_ENDINGS
from brdfatlas.export.targets import STANDARD, export, stem_of
from brdfatlas.files import atomic_path, digests, read_record, write_json
from brdfatlas.fits import load_fit
from brdfatlas.models.base import FitError

#: Endings of a fit's files, in the order of the page, with what each is for.
ENDINGS: Mapping[str, str] = {
    ".npz": "fit: load_fit, our Mitsuba plugin",
    ".json": "parameters as text",
    ".xml": "Mitsuba material of stock plugins",
    ".mtlx": "MaterialX material",
    ".gltf": "glTF material",
}
#: A fit of more numbers has no JSON here: that of a table takes four times its .npz, and nobody reads it.
MOST_NUMBERS = 5000


def files_of(listing: str | Path, material: str, models: Sequence[str]) -> list[list[str]]:
    """The endings of the files that each fit of a material has there by the listing of :func:`fit_files_job`: what else
    lies there may be of another fit."""
    names = read_record(listing, "files")["files"]
    return [[ending for ending in ENDINGS if f"{stem_of(material, model)}{ending}" in names] for model in models]


def write_fit_files(fits: Sequence[str | os.PathLike], folder: str | os.PathLike) -> list[str]:
    """Copy every good fit ({model}.npz; a failed one is an empty file) into ``folder``, {material}/fits, with its
    parameters as JSON, up to :data:`MOST_NUMBERS`, and the material of each engine that can hold it exactly; returns
    the names of the files. Nothing is removed: what an earlier run made and this one does not is in its record
    (:mod:`brdfatlas.pipeline.leftovers`), and what is not may be the user's own."""
    folder, written = Path(folder), set()
    stems = {path: stem_of(folder.parent.name, path.stem) for path in map(Path, fits)}
    for path, stem in stems.items():
        if not path.stat().st_size:
            continue
        target = folder / f"{stem}.npz"
        with atomic_path(target) as temporary:
            shutil.copyfile(path, temporary)
        written.add(target.name)
        fit = with_report(load_fit(path), path)
        text = ["json"] if sum(np.size(values) for values in fit.parameters.values()) <= MOST_NUMBERS else []
        for name in (*text, *(name for name in STANDARD if name in fit.instance.targets)):
            try:
                written |= {made.name for made in export(fit, name, folder / f"{stem}{TARGET_ENDINGS[name]}")}
            except (ExportError, FitError) as error:
                print(f"{path}: not exported to {name}: {error}")
    return sorted(written)


def fit_files_job(fits: Sequence[str | os.PathLike], folder: str | os.PathLike, listing: str | os.PathLike) -> None:
    """Write the files of a material's fits and a list of them, {"files": {name: SHA-256}}, which changes with any."""
    write_json(listing, {"files": digests(folder, write_fit_files(fits, folder))})
