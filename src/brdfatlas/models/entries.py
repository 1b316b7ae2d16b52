"""Entries: the rows of a comparison, each a model with options. A line of config/models.yaml is one.

    name: {model: CLASS, option: value, ...}

``model`` defaults to the name. So one class with two options stands twice in a run, under two names.
"""

import inspect
from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import asdict, dataclass, field
from functools import cache, cached_property
from itertools import pairwise
from pathlib import Path
from typing import Any

from brdfatlas.constants import REFERENCE, REFERENCE_AGAIN
from brdfatlas.models.base import Model
from brdfatlas.models.given import FETCHED, PUBLISHED
from brdfatlas.models.loading import BUILTIN, load_model, with_options
from brdfatlas.settings import CONFIG, SCHEMAS, ConfigError, check, check_name, located, read_yaml

#: The package's own rows, and the schema of every such file.
TABLE, SCHEMA = CONFIG / "models.yaml", SCHEMAS / "models.schema.yaml"
#: Names that a run uses beside those of entries.
RESERVED = (REFERENCE, REFERENCE_AGAIN)


@dataclass(frozen=True)
class Entry:
    """A row: its name, the name of its model's class, options of the fit, and the files that it needs.

    ``source``: the Python file of a model that is not part of a package; ``parameters``: a file of given parameters,
    which stand in place of a fit. Paths count from the working directory.
    """

    name: str
    model: str
    options: Mapping[str, Any] = field(default_factory=dict)
    source: str | None = None
    parameters: str | None = None

    @classmethod
    def of(cls, name: str, row: Mapping[str, Any] | None, *, ours: bool = False) -> "Entry":
        """From a line of config/models.yaml; None stands for an empty row. ``ours``: of a file in the
        package's own config/, which may name files of its checkout."""
        row = dict(row or {})
        model, source, parameters = (row.pop(key, None) for key in ("model", "source", "parameters"))
        source, parameters = (path and located(path, checkout=ours) for path in (source, parameters))
        return cls(name, model or name, row, source, parameters)

    def __getstate__(self) -> dict[str, Any]:
        """Without a model that is from a file: pickle would not find its class in another process, ``source`` does."""
        return {name: value for name, value in vars(self).items() if name != "instance" or not self.source}

    @cached_property
    def instance(self) -> Model:
        """The model with this entry's options for defaults, and with a title that no other entry has.

        KeyError for an unknown model, ImportError for a file that cannot be used, ValueError for a wrong option.
        """
        plain = load_model(self.model, self.source)
        model = with_options(plain, self.options)
        title = self._title(model.title, plain.title)
        if title != model.title:
            model = copy(model)
            vars(model)["title"] = title
        return model

    def _title(self, told: str, plain: str) -> str:
        """``told``, the title of the model with this entry's options, and what makes it the entry's own; ``plain``:
        that without options. Where neither options nor published parameters tell rows apart, the entry's name does."""
        name = "" if self.name == self.model else f" ({self.name})"
        if self.parameters and self.name.endswith(PUBLISHED):
            return f"{told}, published{'' if self.name == self.model + PUBLISHED else name}"
        if self.parameters:
            return f"{told}, given parameters{name}"
        # two files may hold models of one name with the same options
        return f"{told}{name}" if told == plain or self.source else told

    @property
    def title(self) -> str:
        return self.instance.title

    @property
    def bytes(self) -> int:
        """Storage of one fit, in bytes."""
        return self.instance.bytes

    @property
    def free_parameters(self) -> int:
        """How many numbers one fit has."""
        return self.instance.free_parameters

    @property
    def module(self) -> str:
        """Where the class is: a dotted module of this package, or a Python file."""
        return self.source or BUILTIN.get(self.model) or inspect.getfile(type(self.instance))

    @property
    def family(self) -> str:
        """Whose models are fitted together: the paper or family that has the class; one from outside is its own."""
        module = "" if self.source else BUILTIN.get(self.model, "")
        return module.split(".")[2] if module else f"own_{self.name}"

    @property
    def plain(self) -> dict[str, Any]:
        """The entry as plain values: ``Entry(**entry.plain)`` is the entry again."""
        return asdict(self)


def read_entries(paths: str | Path | Sequence[str | Path]) -> dict[str, Entry]:
    """The entries of a file such as config/models.yaml, or of several, in their order; every option is checked by its
    model.

    ConfigError: one line with file, name and remedy.
    """
    entries: dict[str, Entry] = {}
    for path in [paths] if isinstance(paths, str | Path) else paths:
        found = _entries_of(path)
        if entries.keys() & found.keys():
            raise ConfigError(
                f"{path}: {min(entries.keys() & found.keys())}: another file has this name, choose another"
            )
        entries |= found
        names = sorted(entries, key=str.casefold)
        for name, other in pairwise(names):
            if name.casefold() == other.casefold():  # their files would be one where case makes no difference
                raise ConfigError(f"{path}: {name} and {other} differ in case alone, choose another name for one")
    return entries


def _entries_of(path: str | Path) -> dict[str, Entry]:
    """The entries of one file."""
    file = located(path)
    rows, ours = check(read_yaml(file), read_yaml(SCHEMA), str(path)), Path(file).resolve().parent == CONFIG.resolve()
    entries = {}
    for name, row in rows.items():
        check_name(name, str(path))
        if name in RESERVED:
            raise ConfigError(f"{path}: {name}: this name is reserved, choose another")
        entry = entries[name] = Entry.of(name, row, ours=ours)
        try:
            _ = entry.instance
        except KeyError as error:
            raise ConfigError(f"{path}: {name}: {error.args[0]}; a model of your own needs source: FILE.py") from None
        except (ValueError, ImportError) as error:
            raise ConfigError(f"{path}: {name}: {error}".replace("\n", " ")) from None
        # published fits are fetched when they are asked for: without them their rows are left out (given.why_no_row)
        fetched = bool(entry.parameters) and Path(entry.parameters).parent == FETCHED
        if entry.parameters and not fetched and not Path(entry.parameters).is_file():
            raise ConfigError(f"{path}: {name}: parameters: {entry.parameters}: no such file; correct the path")
    return entries


@cache
def builtin_entries() -> dict[str, Entry]:
    """The entries that the package knows by name, from its own table; models are not loaded."""
    rows = check(read_yaml(TABLE), read_yaml(SCHEMA), str(TABLE))
    return {name: Entry.of(name, row, ours=True) for name, row in rows.items()}
