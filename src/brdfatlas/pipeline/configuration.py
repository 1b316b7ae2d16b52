"""The configuration: read, completed with defaults, checked. Every fault is one line with file, key and remedy."""

import inspect
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from brdfatlas.models import BUILTIN, MODELS
from brdfatlas.rendering.scenes import SceneError, check_settings
from brdfatlas.settings import ConfigError, check, check_name, read_yaml

SCHEMAS = Path("workflow") / "schemas"
#: Names that the pipeline uses beside models.
RESERVED = {"reference", "reference_again"}


def read_models(path: str | Path) -> dict[str, dict[str, Any]]:
    """config/models.yaml: name -> {"model": the name, "options": of its fit, "module": its module or file,
    "source": the file of a model that is not part of an installed package, else None}.

    Registers the models that have a source. Each model's own options are checked by the model.
    """
    models = check(read_yaml(path), read_yaml(SCHEMAS / "models.schema.yaml"), str(path))
    for name, options in models.items():
        check_name(name, str(path))
        if name in RESERVED:
            raise ConfigError(f"{path}: {name}: this name is reserved, choose another")
        options = models[name] = dict(options or {})
        source = options.pop("source", None)
        if source:
            MODELS.register_file(name, source)
        try:
            MODELS[name].check_options(options)
        except KeyError as error:
            raise ConfigError(f"{path}: {name}: {error.args[0]}; a model of your own needs source: FILE.py") from None
        except (ValueError, ImportError) as error:
            raise ConfigError(f"{path}: {name}: {error}".replace("\n", " ")) from None
        models[name] = _model(name, options, source)
    return models


def _model(name: str, options: dict[str, Any], source: str | None = None) -> dict[str, Any]:
    module = source or BUILTIN.get(name) or inspect.getfile(type(MODELS[name]))
    return {"model": name, "options": options, "module": module, "source": source}


def read_variants(ablation: Mapping[str, Any], models: Mapping[str, Mapping[str, Any]]) -> dict[str, dict[str, Any]]:
    """The fits of an ablation, "model.variant" -> what :func:`read_models` gives for a model, with the variant's
    options put over those of the models file.

    ConfigError for an unknown model or an option that it does not have.
    """
    variants = {}
    for name in ablation["models"]:
        if name not in models and name not in MODELS:
            raise ConfigError(f"config: ablation.models: {name!r} is not known; known: {', '.join(MODELS)}")
        entry = models.get(name) or _model(name, {})
        for variant, options in ablation["variants"].items():
            check_name(variant, "config: ablation.variants")
            options = {**entry["options"], **options}
            try:
                MODELS[name].check_options(options)
            except ValueError as error:
                raise ConfigError(f"config: ablation.variants.{variant}: {error}") from None
            variants[f"{name}.{variant}"] = {**entry, "options": options}
    taken = variants.keys() & models.keys()
    if taken:
        raise ConfigError(f"config: ablation.variants: a model is already called {min(taken)!r}; rename the variant")
    return variants


def read_assets(path: str | Path) -> dict[str, dict[str, Any]]:
    """config/assets.yaml: name of a file in data/assets -> where it comes from."""
    assets = check(read_yaml(path), read_yaml(SCHEMAS / "assets.schema.yaml"), str(path))
    return {check_name(name, str(path)): source for name, source in assets.items()}


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
    return list(files.values())


def choose(wanted: str | list[str], known: list[str], key: str, source: str) -> list[str]:
    """The names that ``wanted`` selects: all of ``known``, or the list itself, checked and without doubles."""
    if wanted == "all":
        return list(known)
    for name in wanted:
        if name not in known:
            raise ConfigError(f"{source}: {key}: {name!r} is not known; known: {', '.join(known)}")
    return list(dict.fromkeys(wanted))


def read_config(config: Mapping[str, Any], source: str = "config") -> dict[str, Any]:
    """The main configuration, completed and checked."""
    return check(dict(config), read_yaml(SCHEMAS / "config.schema.yaml"), source)
