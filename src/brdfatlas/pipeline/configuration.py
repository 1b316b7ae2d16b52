"""The configuration: read, completed with defaults, checked. Every fault is one line with file, key and remedy."""

import json
import os
import re
import sys
import time
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from brdfatlas.rendering.scenes import SceneError, check_settings
from brdfatlas.settings import SCHEMAS, ConfigError, check, check_name, read_yaml, typed


def read_assets(path: str | Path) -> dict[str, dict[str, Any]]:
    """config/assets.yaml: name of a file in data/assets -> where it comes from."""
    assets = check(read_yaml(path), read_yaml(SCHEMAS / "assets.schema.yaml"), str(path))
    return {check_name(name, str(path)): source for name, source in assets.items()}


def read_rgl(path: str | Path) -> dict[str, str]:
    """config/rgl.yaml: name of a material of the RGL database -> its address."""
    source = check(read_yaml(path), read_yaml(SCHEMAS / "rgl.schema.yaml"), str(path))
    return {check_name(name, str(path)): source["url"].replace("{name}", name) for name in source["materials"]}


def check_samples(config: Mapping[str, Any], scenes: Mapping[str, Mapping[str, Any]]) -> None:
    """ConfigError, naming file and key, if the settings of a run give a scene less than a sample a batch."""
    render = config["render"]
    for name, scene in scenes.items():
        try:
            check_settings(render["size"], scene["samples"] or render["samples"], render["batches"])
        except SceneError as error:
            place = f"{config['scenes_file']}: {name}" if scene["samples"] else "config: render"
            raise ConfigError(str(error).replace("render", place, 1)) from None


def files_of_scene(name: str, scene: Mapping[str, Any], source: str, assets: Iterable[str]) -> list[str]:
    """The light probe and the meshes that a scene reads; ``assets``: names of those in data/assets that can be fetched.

    ConfigError, naming ``source``, scene, key and remedy, for a file that is not there.
    """
    named = {f"geometry.{number}": shape["file"] for number, shape in enumerate(scene["geometry"])}
    named["environment"] = scene["environment"]["file"]
    files = {key: file for key, file in named.items() if file}
    for key, file in files.items():
        if not Path(file).exists():
            fetched = Path(file) in [Path("data/assets") / asset for asset in assets]
            remedy = "`snakemake assets` fetches it" if fetched else "correct the path or leave the scene out"
            raise ConfigError(f"{source}: {name}.{key}.file: {file}: no such file; {remedy}")
        fault = time_fault(file)
        if fault:
            raise ConfigError(f"{source}: {name}.{key}.file: {file}: {fault}")
    return list(files.values())


def time_fault(path: str | os.PathLike) -> str:
    """What is wrong with the time stamp of an input, "" if nothing: Snakemake fails every job whose input is newer than
    what the job has just made."""
    try:
        ahead = os.stat(path).st_mtime > time.time() + 60
    except OSError:
        return ""
    return "its time stamp lies in the future; set it with `touch`, or correct the clock" if ahead else ""


def check_writable(folders: Iterable[str | os.PathLike]) -> None:
    """ConfigError for a folder of the project in which this user cannot write, or make it where it is not there."""
    for folder in folders:
        place = Path(folder) if Path(folder).exists() else Path.cwd()
        if not os.access(place, os.W_OK | os.X_OK):
            raise ConfigError(f"{place}: cannot be written to; make it writable for this user")


def choose(wanted: str | list[str], known: list[str], key: str, source: str) -> list[str]:
    """The names that ``wanted`` selects: all of ``known``, or the list itself, checked and without doubles."""
    if wanted == "all":
        return list(known)
    for name in wanted:
        if name not in known:
            raise ConfigError(f"{source}: {key}: {name!r} is not known; known: {', '.join(known)}")
    return list(dict.fromkeys(wanted))


def check_configfiles(paths: Iterable[str | Path]) -> None:
    """ConfigError for a configuration file with a fault that Snakemake, which reads it, says nothing of: a key that
    stands twice, a number that is not decimal."""
    for path in paths:
        if Path(path).suffix != ".json":
            read_yaml(path)
            continue
        try:
            json.loads(Path(path).read_text(encoding="utf-8"), object_pairs_hook=_once)
        except ValueError as error:
            raise ConfigError(f"{path}: not usable JSON ({error})") from None


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """The mapping of pairs whose keys stand once."""
    found = dict(pairs)
    if len(found) < len(pairs):
        keys = [key for key, _ in pairs]
        raise ValueError(f"key {next(key for key in keys if keys.count(key) > 1)!r} stands twice")
    return found


def read_config(config: Mapping[str, Any], source: str = "config") -> dict[str, Any]:
    """The main configuration, completed and checked."""
    schema = read_yaml(SCHEMAS / "config.schema.yaml")
    if "merl_folder" in config:
        print(f"{source}: merl_folder is deprecated since 0.2.0, use measured_folder; it still works", file=sys.stderr)
    config = check(typed(dict(config), schema), schema, source)
    for key in ("measured_folder", "merl_folder"):
        config[key] = os.path.expanduser(config[key])
        folder = Path(config[key])
        if re.search(r"\$[\w{]", config[key]) and not folder.exists():
            raise ConfigError(f"{source}: {key}: {folder}: variables are not expanded, ~ is; write the path itself")
        if folder.exists() and not folder.is_dir():
            raise ConfigError(f"{source}: {key}: {folder}: not a folder; name the folder that holds the files")
        # A rule could take a measurement there for what it makes itself, and make it again.
        for own in ("results", "reports"):
            if folder.resolve().is_relative_to(Path(own).resolve()):
                raise ConfigError(f"{source}: {key}: {folder}: in {own}, which runs write; keep measurements elsewhere")
    return config
