"""Models by name, imported when they are asked for.

A name is that of an entry (:mod:`.entries`) or of a class (:mod:`.loading`). A model from outside joins by an entry
point in the group ``brdfatlas.models`` (name = "package.module:Class"), or by ``source: path/to/model.py`` in
config/models.yaml.
"""

import os
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from brdfatlas.models.base import Model
from brdfatlas.models.entries import Entry, builtin_entries, read_entries
from brdfatlas.models.loading import BUILTIN, installed_models, is_ours, load_model, load_model_file, own_faults

__all__ = [
    "MODELS",
    "Entry",
    "Registry",
    "is_ours",
    "load_model",
    "load_model_file",
    "name_sources",
    "own_faults",
    "read_entries",
    "use_entries",
]
#: Environment variable with the files of models outside the working directory that a run names: its jobs inherit it.
SOURCES = "BRDFATLAS_SOURCES"


class Registry(Mapping[str, Model]):
    """Models by the names of entries, each with its entry's options; the order is that of tables and pages."""

    def __init__(self) -> None:
        self._own: dict[str, Entry] = {}

    def use(self, entries: Iterable[Entry]) -> None:
        """Make entries known to this process, in place of others of the same names."""
        self._own.update({entry.name: entry for entry in entries})

    def register_file(self, name: str, path: str | Path) -> None:
        """Make the model of a Python file known to this process."""
        self.use([Entry(name, name, source=str(path))])

    @contextmanager
    def restored(self) -> Iterator[None]:
        """What is made known within a block is forgotten after it."""
        before = dict(self._own)
        try:
            yield
        finally:
            self._own = before

    def entry(self, name: str) -> Entry:
        """The entry of a name, or a class without options. KeyError names what is known."""
        known = self._own.get(name) or builtin_entries().get(name)
        if known:
            return known
        if name in BUILTIN or name in installed_models():
            return Entry(name, name)
        known = ", ".join(self)
        raise KeyError(
            f"unknown model {name!r}; known: {known} (a model of one's own: `brdfatlas fit --source FILE.py`)"
        )

    def trusts(self, source: str | Path) -> bool:
        """Whether a file may be run because a fit names it: it lies below the working directory, or the user named it
        (registered in this process, or in a models file). Links count as what they lead to."""
        named = [*self._sources().values(), *os.environ.get(SOURCES, "").split(os.pathsep)]
        path = os.path.realpath(source)
        below = Path(path).is_relative_to(os.path.realpath(os.getcwd()))
        return below or path in {os.path.realpath(name) for name in named if name}

    def source_of(self, entry: str, model: str) -> str | None:
        """The file that the user named for an entry of a class of this name, else for the class; None where nobody did,
        or where two files hold such a class."""
        named = self._sources()
        files = {source for (_, known), source in named.items() if known == model}
        return named.get((entry, model)) or (files.pop() if len(files) == 1 else None)

    def _sources(self) -> dict[tuple[str, str], str]:
        """Files of models that the user named, by the names of the entry and of its class."""
        entries = [*self._own.values(), *builtin_entries().values()]
        return {(entry.name, entry.model): entry.source for entry in entries if entry.source}

    def __iter__(self) -> Iterator[str]:
        return iter(dict.fromkeys([*builtin_entries(), *installed_models(), *self._own]))

    def __len__(self) -> int:
        return len(list(iter(self)))

    def __getitem__(self, name: str) -> Model:
        return self.entry(name).instance


MODELS = Registry()


def name_sources(entries: Iterable[Entry]) -> None:
    """Let this process and its children load fits of the models of a run, wherever their files lie."""
    os.environ[SOURCES] = os.pathsep.join(os.path.realpath(entry.source) for entry in entries if entry.source)


def use_entries(entries: Iterable[Mapping[str, Any]]) -> None:
    """Make the entries of a run known to a job, from their plain values (``Entry.plain``)."""
    MODELS.use(Entry(**entry) for entry in entries)
