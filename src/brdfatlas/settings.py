"""Settings from YAML, completed and checked against a JSON schema. Every fault is one line: file, key, remedy."""

import json
import math
import re
from collections.abc import Mapping
from copy import deepcopy
from itertools import chain
from pathlib import Path
from typing import Any

import jsonschema
import yaml

from brdfatlas.constants import LONGEST_NAME, NAME
from brdfatlas.files import check_regular

#: The package's own config/ and workflow/schemas/: links in a checkout, copies in an installed package.
CONFIG, SCHEMAS = (Path(__file__).with_name(name) for name in ("config", "schemas"))
#: Values that a file may hold, with aliases written out; ours have some hundreds.
MOST_VALUES = 100_000


class ConfigError(ValueError):
    """The configuration cannot be used; the message is one line that names file, key and remedy."""


def located(path: str | Path, *, checkout: bool = False) -> str:
    """``path``, or the package's own file where the working directory lacks this file of config/: a study in a folder
    of its own takes from the package what it does not state itself. ``checkout``: of any folder beside config/ too."""
    own = CONFIG.joinpath(*Path(path).parts[1:]) if Path(path).parts[:1] == ("config",) else None
    if checkout and own is None:
        own = CONFIG.resolve().parent / path
    return str(own if own and not Path(path).exists() and own.exists() else path)


class _Loader(yaml.SafeLoader):
    """YAML whose keys are text and stand once, and whose numbers are decimal: YAML 1.1 takes 010 for 8, 1:30 for 90."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[str, Any]:
        seen = set()
        for key, _ in node.value:
            if key.tag == "tag:yaml.org,2002:merge":
                continue
            text = isinstance(key, yaml.ScalarNode) and key.tag == "tag:yaml.org,2002:str"
            fault = "is no text, quote it" if not text else "stands twice" if key.value in seen else ""
            if fault:
                shown = key.value if isinstance(key, yaml.ScalarNode) else "a list"
                raise yaml.constructor.ConstructorError(None, None, f"key {shown!r} {fault}", key.start_mark)
            seen.add(key.value)
        return super().construct_mapping(node, deep)

    def decimal(self, node: yaml.ScalarNode) -> int | float:
        whole = node.tag == "tag:yaml.org,2002:int"
        value = self.construct_yaml_int(node) if whole else self.construct_yaml_float(node)
        if re.search(r"[:_]", node.value) or (whole and not re.fullmatch(r"[-+]?(0|[1-9]\d*)", node.value)):
            fault = f"{node.value} would be read as {value}; write decimal digits, or quote a text"
            raise yaml.constructor.ConstructorError(None, None, fault, node.start_mark)
        return value


for _tag in ("int", "float"):
    _Loader.add_constructor(f"tag:yaml.org,2002:{_tag}", _Loader.decimal)


def _values(node: yaml.Node | None, known: dict[int, int]) -> int:
    """How many values a node stands for; aliases multiply, so ten lines can be more than any memory holds."""
    if not isinstance(node, yaml.CollectionNode):
        return 1
    if id(node) not in known:
        known[id(node)] = MOST_VALUES  # a node inside itself
        parts = chain.from_iterable(node.value) if isinstance(node, yaml.MappingNode) else node.value
        known[id(node)] = 1 + sum(_values(part, known) for part in parts)
    return known[id(node)]


def _parse(text: str) -> Any:
    loader = _Loader(text)
    try:
        node = loader.get_single_node()
        if _values(node, {}) > MOST_VALUES:
            raise ValueError(f"more than {MOST_VALUES:,} values, its aliases written out; write fewer")
        return loader.construct_document(node) if node else None
    finally:
        loader.dispose()


def read_yaml(path: str | Path) -> Any:
    """Parse a YAML file. ConfigError names the file and the line of a syntax error, of a key that is no text or stands
    twice, and of a number that is not decimal."""
    if not Path(path).exists():
        raise ConfigError(f"{path}: no such file")
    if not Path(path).is_file():
        raise ConfigError(f"{path}: not a regular file")
    try:
        return _parse(check_regular(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read ({error.strerror})") from None
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path}: not UTF-8 text (byte {error.start}); save it as UTF-8") from None
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        mark = getattr(error, "problem_mark", None)
        where = f"line {mark.line + 1}: " if mark else ""
        raise ConfigError(f"{path}: {where}not usable YAML ({getattr(error, 'problem', None) or error})") from None


def complete(value: Any, schema: Mapping[str, Any]) -> Any:
    """``value`` with the schema's defaults filled in, at every depth."""
    if isinstance(value, Mapping):
        value = dict(value)
        for key, part in schema.get("properties", {}).items():
            if key not in value and "default" in part:
                value[key] = deepcopy(part["default"])
            if key in value:
                value[key] = complete(value[key], part)
        extra = schema.get("additionalProperties")
        if isinstance(extra, Mapping):
            for key in value.keys() - schema.get("properties", {}).keys():
                value[key] = complete(value[key], extra)
    return value


def _is_integer(_, value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)


#: An integer is written as one: 1.0e+30 is none. A number is finite: .nan would pass every range.
_TYPES = jsonschema.Draft202012Validator.TYPE_CHECKER.redefine_many(
    {
        "integer": _is_integer,
        "number": lambda _, value: _is_integer(_, value) or (isinstance(value, float) and math.isfinite(value)),
    }
)
_Validator = jsonschema.validators.extend(jsonschema.Draft202012Validator, type_checker=_TYPES)


def check(value: Any, schema: Mapping[str, Any], source: str) -> Any:
    """Completed ``value``, or ConfigError with the first fault: file, key, what is wrong, what is allowed."""
    value = complete({} if value is None else value, schema)
    errors = sorted(_Validator(schema).iter_errors(value), key=lambda e: list(map(str, e.path)))
    if not errors:
        return value
    error = errors[0]
    key = ".".join(map(str, error.absolute_path)) or "(top level)"
    known = ", ".join(error.schema.get("properties", {})) if error.validator == "additionalProperties" else ""
    message = error.message if len(error.message) < 200 else error.message[:200] + " ..."
    help_text = f"; known keys: {known}" if known else _allowed(error.schema)
    raise ConfigError(f"{source}: {key}: {message}{help_text}".replace("\n", " "))


def _allowed(schema: Mapping[str, Any]) -> str:
    low, high = schema.get("minimum"), schema.get("maximum")
    limits = f"; allowed: {low} to {high}" if None not in (low, high) else ""
    return limits + (f" ({schema['description']})" if "description" in schema else "")


def typed(value: Any, schema: Mapping[str, Any]) -> Any:
    """``value`` with text read as number or boolean where the schema wants one: what Snakemake's ``--config`` gives for
    ``strict=true`` and ``'render={size: 32}'``."""
    if isinstance(value, Mapping):
        parts = schema.get("properties", {})
        return {key: typed(item, parts.get(key, {})) for key, item in value.items()}
    if isinstance(value, str) and schema.get("type") in ("integer", "number", "boolean"):
        try:
            return json.loads(value)
        except ValueError:
            return value
    return value


def check_name(name: str, source: str) -> str:
    """``name`` if it can be a folder, a wildcard and a page; else ConfigError."""
    if not isinstance(name, str) or not NAME.match(name):
        raise ConfigError(f"{source}: {name!r} is not a usable name: letters, digits, '.', '_' and '-' only")
    if len(name) > LONGEST_NAME:
        raise ConfigError(f"{source}: {name[:20]}...: a name has at most {LONGEST_NAME} characters; shorten it")
    return name
