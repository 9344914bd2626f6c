"""Families by name: those of this package, those that installed packages offer, and a user's own file."""

from __future__ import annotations

import importlib.util
import sys
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

from ear_jax.envs.ant_dir import AntDir
from ear_jax.envs.family import Family
from ear_jax.envs.halfcheetah_run_jump import HalfCheetahRunJump
from ear_jax.envs.halfcheetah_vel import HalfCheetahVel
from ear_jax.envs.hopper_vel import HopperVel
from ear_jax.envs.validation import check_family
from ear_jax.envs.walker_vel import WalkerVel
from ear_jax.errors import UsageError, unknown
from ear_jax.quiet import register_environment

FAMILIES: dict[str, type[Family]] = {
    family.name: family for family in (HalfCheetahVel, AntDir, HopperVel, WalkerVel, HalfCheetahRunJump)
}
ENTRY_POINTS = "ear_jax.families"  # the group in which an installed package offers its own

for _name, _family in FAMILIES.items():
    register_environment("ear_" + _name.replace("-", "_"), _family)


def find_family(name: str) -> type[Family]:
    """A family's class by its name, or by `path/to/file.py:ClassName`, whose code is then run.

    Raises:
      UsageError: there is none, or the file does not hold one.
    """
    if name in FAMILIES:
        return FAMILIES[name]
    if ":" in name:
        return _from_file(*name.rsplit(":", 1))
    offered = {point.name: point for point in entry_points(group=ENTRY_POINTS)}
    if name not in offered:
        raise unknown("family", name, (*FAMILIES, *offered))
    return offered[name].load()


def make_family(name: str, engine: str = "auto", **options: Any) -> Family:
    """A family by name, on an engine, found to be one that can be trained on.

    Args:
      name: as `find_family` takes it.
      engine: an engine or `auto`.
      options: settings the family declares in `options`; None leaves a setting as it is.

    Raises:
      UsageError: no such family, engine or option, or a family that is not well made.
      RunError: the engine cannot run here.
    """
    kind = find_family(name)
    given = {option: value for option, value in options.items() if value is not None}
    for option in given:
        if option not in kind.options:
            raise UsageError(f"{name} has no setting {option!r} (there are: {', '.join(kind.options) or 'none'})")
    family = kind(engine=engine, **given)
    check_family(family)
    return family


def _from_file(path: str, class_name: str) -> type[Family]:
    if not Path(path).is_file():
        raise UsageError(f"no file {path}; a family of your own is named path/to/file.py:ClassName")
    spec = importlib.util.spec_from_file_location(f"ear_jax_user_{Path(path).stem}", path)
    if spec is None or spec.loader is None:
        raise UsageError(f"{path} is no Python file")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses look their own module up
    try:
        spec.loader.exec_module(module)
    except Exception as error:
        del sys.modules[spec.name]
        raise UsageError(f"{path} cannot be run: {type(error).__name__}: {error}".splitlines()[0]) from error
    found = {name: kind for name, kind in vars(module).items() if _is_family(kind)}
    if class_name not in found:
        raise unknown("family", class_name, found)
    return found[class_name]


def _is_family(kind: Any) -> bool:
    return isinstance(kind, type) and issubclass(kind, Family) and not getattr(kind, "__abstractmethods__", None)
