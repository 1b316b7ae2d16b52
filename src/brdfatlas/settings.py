"""Settings from YAML, completed and checked against a JSON schema. Every fault is one line: file, key, remedy."""

import re
from collections.abc import Mapping
from copy import deepcopy
from pathlib import Path
from typing import Any

import jsonschema
import yaml

from brdfatlas.files import check_regular

#: Names that become folders, wildcards and addresses: nothing that a shell, a path or a page could misread.
NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]*\Z")


class ConfigError(ValueError):
    """The configuration cannot be used; the message is one line that names file, key and remedy."""


def read_yaml(path: str | Path) -> Any:
    """Parse a YAML file. ConfigError names the file and the line of a syntax error."""
    try:
        return yaml.safe_load(check_regular(path).read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise ConfigError(f"{path}: no such file") from None
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read ({error.strerror})") from None
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path}: not UTF-8 text (byte {error.start}); save it as UTF-8") from None
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        where = f"line {mark.line + 1}: " if mark else ""
        raise ConfigError(f"{path}: {where}not YAML ({getattr(error, 'problem', None) or error})") from None


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


def check(value: Any, schema: Mapping[str, Any], source: str) -> Any:
    """Completed ``value``, or ConfigError with the first fault: file, key, what is wrong, what is allowed."""
    value = complete({} if value is None else value, schema)
    errors = sorted(jsonschema.Draft202012Validator(schema).iter_errors(value), key=lambda e: list(map(str, e.path)))
    if not errors:
        return value
    error = errors[0]
    key = ".".join(map(str, error.absolute_path)) or "(top level)"
    known = ", ".join(error.schema.get("properties", {})) if error.validator == "additionalProperties" else ""
    message = error.message if len(error.message) < 200 else error.message[:200] + " ..."
    help_text = f"; known keys: {known}" if known else _meaning(error.schema)
    raise ConfigError(f"{source}: {key}: {message}{help_text}".replace("\n", " "))


def _meaning(schema: Mapping[str, Any]) -> str:
    return f" ({schema['description']})" if "description" in schema else ""


def check_name(name: str, source: str) -> str:
    """``name`` if it can be a folder, a wildcard and a page; else ConfigError."""
    if not isinstance(name, str) or not NAME.match(name):
        raise ConfigError(f"{source}: {name!r} is not a usable name: letters, digits, '.', '_' and '-' only")
    return name
