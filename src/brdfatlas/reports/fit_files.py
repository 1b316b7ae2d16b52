"""The files of a fit below reports/, so that a copy of that folder is complete: ``fits/{model}{ending}`` beside the
pictures of its material."""

import os
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path

from brdfatlas.export.fit_json import export_json
from brdfatlas.files import atomic_path, digests, write_json
from brdfatlas.fits import load_fit

#: Endings of a fit's files, in the order of the page, with what each is for.
ENDINGS: Mapping[str, str] = {
    ".npz": "fit: load_fit, Mitsuba plugin",
    ".json": "parameters as text",
    ".xml": "Mitsuba scene",
    ".mtlx": "MaterialX",
    ".gltf": "glTF",
}


def fits_folder(material_folder: str | Path) -> Path:
    """Where the fits of a material lie, given the folder of its pictures."""
    return Path(material_folder) / "fits"


def files_of(material_folder: str | Path, model: str) -> list[str]:
    """The endings of the files that a fit has there."""
    folder = fits_folder(material_folder)
    return [ending for ending in ENDINGS if (folder / f"{model}{ending}").is_file()]


def write_fit_files(fits: Sequence[str | os.PathLike], folder: str | os.PathLike) -> list[str]:
    """Copy every good fit (.npz; a failed one is an empty file) into ``folder`` and write its parameters as JSON beside
    it; returns the names of the files. Files of an earlier run that this one does not write are removed."""
    folder, written = Path(folder), set()
    for path in map(Path, fits):
        if not path.stat().st_size:
            continue
        target = folder / path.name
        with atomic_path(target) as temporary:
            shutil.copyfile(path, temporary)
        export_json(load_fit(path), target.with_suffix(".json"))
        written |= {target.name, target.with_suffix(".json").name}
    for path in folder.glob("*"):
        if path.name not in written and path.suffix in ENDINGS:
            path.unlink()
    return sorted(written)


def fit_files_job(fits: Sequence[str | os.PathLike], folder: str | os.PathLike, listing: str | os.PathLike) -> None:
    """Write the files of a material's fits and a list of them, {"files": {name: SHA-256}}, which changes with any."""
    write_json(listing, {"files": digests(folder, write_fit_files(fits, folder))})
