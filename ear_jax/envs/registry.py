"""Families by name: those of this package, those that installed packages offer, and a user's own file."""

from __future__ import annotations

import importlib
import importlib.util
import sys
from collections.abc import Mapping
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any

from ear_jax.envs.family import Family
from ear_jax.envs.user_code import source_file, user_code
from ear_jax.envs.validation import check_class, check_family, check_task
from ear_jax.errors import UsageError, unknown
from ear_jax.physics import choose_engine
from ear_jax.process.silent_imports import register_environment
from ear_jax.tasks import Task

FILES = (  # of this package, each with a FAMILY; a new family is its file and its line here
    "halfcheetah_vel",
    "ant_dir",
    "hopper_vel",
    "walker_vel",
    "halfcheetah_run_jump",
    "reach",
)
FAMILIES: dict[str, type[Family]] = {
    family.name: family for family in (importlib.import_module(f"{__package__}.{file}").FAMILY for file in FILES)
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
    offered = offered_families()
    if name not in offered:
        raise unknown("family", name, (*FAMILIES, *offered))
    with user_code(f"family {name!r} cannot be loaded from {offered[name].value}", None):
        kind = offered[name].load()
    check_class(kind, name)
    return kind


def offered_families() -> dict[str, EntryPoint]:
    """What installed packages offer, by name."""
    return {point.name: point for point in entry_points(group=ENTRY_POINTS)}


def family_presets(name: str) -> Mapping[str, Mapping[str, Any]]:
    """Returns what presets change for a family, by preset; nothing for a family that is not to be had here."""
    try:
        return find_family(name).presets
    except UsageError:
        return {}


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
    engine = choose_engine(engine)
    try:
        with user_code("it cannot be made", source_file(kind)):
            family = kind(engine=engine, **given)
            if not kind.__module__.startswith(f"{__package__}."):  # ours pass, as tests show; it would cost a second
                check_family(family)
    except UsageError as error:
        raise UsageError(f"{name}: {error}") from error
    return family


def find_task(family: Family, text: str) -> Task:
    """The task of a family that a person means by a word.

    Raises:
      UsageError: there is none, or one that the family's own tasks cannot stand beside.
    """
    source = f"{family.name}: parse_task({text!r})"
    with user_code(f"{source} fails", source_file(type(family))):
        task = family.parse_task(text)
    check_task(task, family.training_tasks().tasks[0], source)
    return task


def _from_file(path: str, class_name: str) -> type[Family]:
    if not Path(path).is_file():
        raise UsageError(f"no file {path}; a family of your own is named path/to/file.py:ClassName")
    spec = importlib.util.spec_from_file_location(f"ear_jax_user_{Path(path).stem}", path)
    if spec is None or spec.loader is None:
        raise UsageError(f"{path} is no Python file")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses look their own module up
    with user_code(f"{path} cannot be run", spec.origin):
        spec.loader.exec_module(module)
    if class_name not in vars(module):
        raise unknown("family", class_name, [name for name, kind in vars(module).items() if _is_family(kind)])
    kind = getattr(module, class_name)
    check_class(kind, f"{path}:{class_name}")
    return kind


def _is_family(kind: Any) -> bool:
    return isinstance(kind, type) and issubclass(kind, Family) and not kind.__abstractmethods__
