"""The files of a fit below reports/, so that a copy of that folder is complete: ``fits/{model}{ending}`` beside the
pictures of its material."""

import os
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path

from brdfatlas.files import atomic_path

#: Endings of a fit's files, in the order of the page, with what each is for.
ENDINGS: Mapping[str, str] = {
    ".npz": "fit: load_fit, Mitsuba plugin",
    ".json": "parameters as text",
    ".binary": "table in MERL format",
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


def copy_file(source: str | os.PathLike, target: Path) -> None:
    """A copy, whole or not at all."""
    with atomic_path(target) as temporary:
        shutil.copyfile(source, temporary)


def copy_fits(fits: Sequence[str | os.PathLike], folder: str | Path) -> list[str]:
    """Copy the good fits (.npz; failed ones are empty files) and their JSON beside each other; names of the files."""
    folder, written = Path(folder), []
    for path in map(Path, fits):
        if path.stat().st_size:
            copy_file(path, folder / path.name)
            written.append(path.name)
    return written
