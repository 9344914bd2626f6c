"""Families by name: from this package, from installed packages, or from a user's own file."""

from __future__ import annotations

import functools
import importlib
import importlib.util
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ear_jax.envs.as_brax import register_with_brax
from ear_jax.envs.family import Family
from ear_jax.envs.user_code import neighbours, source_file, user_code
from ear_jax.envs.validation import check_class, check_family, check_task
from ear_jax.errors import USER_FILES, UsageError, unknown
from ear_jax.names import FAMILY_FILES, family_name, name_of, offered_families
from ear_jax.physics import choose_engine
from ear_jax.tasks import Task, TaskSet

FAMILIES: dict[str, type[Family]] = {
    name_of(file): importlib.import_module(f"{__package__}.{file}").FAMILY for file in FAMILY_FILES
}

register_with_brax({"ear_" + name.replace("-", "_"): family for name, family in FAMILIES.items()})


def find_family(name: str) -> type[Family]:
    """Returns a family's class by name, or by `path/to/file.py:ClassName`, which runs that file.

    Raises:
      UsageError: the family is unknown, or the file does not define it.
    """
    name = name if name in FAMILIES else family_name(name)
    if name in FAMILIES:
        return FAMILIES[name]
    if ":" in name:
        return _from_file(*name.rsplit(":", 1))
    offered = offered_families()
    with user_code(f"family {name!r} cannot be loaded from {offered[name].value}", None):
        kind: type[Family] = offered[name].load()
    check_class(kind, name)
    USER_FILES.add(source_file(kind) or "")
    return kind


def family_presets(name: str) -> Mapping[str, Mapping[str, Any]]:
    """Returns a family's changes to presets, by preset; empty if the family cannot be loaded."""
    try:
        return find_family(name).presets
    except UsageError:
        return {}


def make_family(name: str, engine: str = "auto", **options: Any) -> Family:
    """Builds a family by name on an engine and checks that it can be trained on.

    Args:
      name: as `find_family` takes it.
      engine: an engine or `auto`.
      options: attributes declared in the family's `options`; None keeps the default.

    Raises:
      UsageError: the family, engine or option is unknown, or the family is faulty.
      RunError: the engine cannot run here.
    """
    kind = find_family(name)
    chosen = {option: value for option, value in options.items() if value is not None}
    for option in chosen:
        if option not in kind.options:
            raise UsageError(f"{name} has no setting {option!r} (there are: {', '.join(kind.options) or 'none'})")
    engine = choose_engine(engine)
    try:
        with user_code("its constructor fails", source_file(kind)):
            family = kind(engine=engine, **chosen)
            if not kind.__module__.startswith(f"{__package__}."):  # tests check ours; it would cost a second here
                check_family(family)
    except UsageError as error:
        raise UsageError(f"{name}: {error}") from error
    return family


def find_task(family: Family, text: str) -> Task:
    """Returns the task of a family that a user's text names.

    Raises:
      UsageError: there is none, or its params differ in names from those of the training tasks.
    """
    source = f"{family.name}: parse_task({text!r})"
    with user_code(f"{source} fails", source_file(type(family))):
        task = family.parse_task(text)
    check_task(task, family.training_tasks().tasks[0], source)
    return task


def spread_tasks(family: Family, count: int) -> TaskSet:
    """Returns `count` tasks of a family spread evenly over its range.

    Raises:
      UsageError: it has no range, or one of them is no task of the family.
    """
    source = f"{family.name}: spread_tasks({count})"
    with user_code(f"{source} fails", source_file(type(family))):
        tasks = family.spread_tasks(count)
    if not isinstance(tasks, TaskSet) or len(tasks) != count:
        raise UsageError(f"{source} must return a task_set(…) of {count} tasks")
    for task in tasks.tasks:
        check_task(task, family.training_tasks().tasks[0], source)
    return tasks


def _from_file(path: str, class_name: str) -> type[Family]:
    file = Path(path)
    return _loaded(path, class_name, file.resolve(), file.stat().st_mtime_ns)


@functools.cache
def _loaded(path: str, class_name: str, resolved: Path, modified: int) -> type[Family]:
    """Runs a user's file and returns its class; `resolved` and `modified` (ns) make a changed file run again."""
    spec = importlib.util.spec_from_file_location(f"ear_jax_user_{Path(path).stem}", path)
    if spec is None or spec.loader is None:
        raise UsageError(f"{path} is not a Python file")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses look up their own module
    USER_FILES.add(str(spec.origin))
    with user_code(f"{path} cannot be run", spec.origin), neighbours(str(resolved.parent)):
        spec.loader.exec_module(module)
    if class_name not in vars(module):
        raise unknown("family", class_name, [name for name, kind in vars(module).items() if _is_family(kind)])
    kind: type[Family] = getattr(module, class_name)
    check_class(kind, f"{path}:{class_name}")
    return kind


def _is_family(kind: Any) -> bool:
    return isinstance(kind, type) and issubclass(kind, Family) and not kind.__abstractmethods__
