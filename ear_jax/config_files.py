"""Settings as files: TOML, or the JSON of a run. Imports no JAX."""

from __future__ import annotations

import dataclasses
import json
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ear_jax.config import Config, from_dict
from ear_jax.errors import RunError, UsageError
from ear_jax.files.documents import Damaged, parse, verified

Settings = dict[str, Any]  # nested, as in `dataclasses.asdict(config)`; may be a part of all


def read_settings(path: Path) -> Settings:
    """Reads the settings in a file, which may be a part of all.

    Args:
      path: a TOML file as `ear config` prints it, JSON of the same form, or the config.json of a run or its directory.

    Raises:
      UsageError: there is no such file, or it holds no settings.
      RunError: it cannot be read.
    """
    file = path / "config.json" if path.is_dir() else path
    try:
        text = file.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise UsageError(f"no file {file}; `ear config FAMILY` prints one to begin with") from None
    except (OSError, UnicodeDecodeError) as error:
        raise RunError(f"{file} cannot be read: {getattr(error, 'strerror', None) or 'it is not text'}") from None
    try:
        read: Any = parse(text) if file.suffix == ".json" else tomllib.loads(text)
        if file.name == "config.json":  # a run's; one that was copied may have been edited
            read = verified(read)
    except Damaged as error:
        raise RunError(f"{file} is damaged: {error}") from None
    except (ValueError, RecursionError) as error:
        kind = "JSON" if file.suffix == ".json" else "TOML"
        raise UsageError(f"{file} is not {kind}: {error}") from None
    settings: Settings = read.get("config", read) if isinstance(read, dict) else read
    try:
        from_dict({"family": "", **settings} if isinstance(settings, dict) else settings)
    except UsageError as error:
        raise UsageError(f"{file}: {error}") from None
    return settings


def with_settings(base: Config, settings: Settings) -> Config:
    """Returns a configuration in which the given settings replace those of `base`."""
    config: Config = from_dict(merged(dataclasses.asdict(base), settings))
    return config


def to_toml(config: Config) -> str:
    """Writes all settings as TOML that `read_settings` reads; a setting that is None is left out, as a comment."""
    tree = dataclasses.asdict(config)
    lines = [_line(name, value) for name, value in tree.items() if not isinstance(value, dict)]
    for name, table in tree.items():
        if isinstance(table, dict):
            lines += ["", f"[{name}]", *(_line(key, value) for key, value in table.items())]
    return "\n".join(lines) + "\n"


def _line(name: str, value: Any) -> str:
    if value is None:
        return f"# {name} ="
    # Strings, booleans and lists of strings are the same in TOML as in JSON; so are numbers, which are finite here.
    return f"{name} = {json.dumps(list(value) if isinstance(value, tuple) else value, ensure_ascii=False)}"


def merged(base: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """Merges nested dictionaries; the second wins."""
    both = dict(base)
    for name, value in changes.items():
        both[name] = merged(base.get(name, {}), value) if isinstance(value, dict) else value
    return both
