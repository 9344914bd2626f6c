"""Guards around users' code: an exception becomes one line that says where it was raised."""

from __future__ import annotations

import importlib
import os
import sys
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import jax

from ear_jax.errors import RunError, UsageError, first_line, user_place
from ear_jax.process.streams import results_only

NEEDS_CONCRETE_VALUES = (
    jax.errors.ConcretizationTypeError,
    jax.errors.TracerArrayConversionError,
    jax.errors.TracerIntegerConversionError,
    jax.errors.NonConcreteBooleanIndexError,
)


@contextmanager
def user_code(fails: str, file: str | None) -> Iterator[None]:
    """Wraps a user's code, as a context or a decorator. What it prints goes to stderr, as stdout is for results.

    Args:
      fails: the start of the message if it raises, e.g. `reward() fails`.
      file: the file of that code, whose line is then named.

    Raises:
      UsageError: the code raised something; the message is one line. Its own UsageError and RunError pass through, and
        so does Ctrl-C.
    """
    try:
        with results_only():
            yield
    except (UsageError, RunError, KeyboardInterrupt):
        raise
    except NEEDS_CONCRETE_VALUES as error:
        message = "JAX traces it without concrete values; use jnp.where for `if`, and jnp for float() and np"
        raise UsageError(f"{fails}: {message}{_location(error, file)}") from error
    except BaseException as error:
        raise UsageError(f"{fails}: {first_line(error)}{_location(error, file)}") from error


@contextmanager
def neighbours(folder: str) -> Iterator[None]:
    """Lets a user's file import the files beside it, as Python does for a script.

    The folder comes first among the places of modules meanwhile and last afterwards, for imports in functions, so that
    it hides no module from anyone else. Neighbours of files that were run before are forgotten: they may have changed,
    or have the same names.
    """
    for name in _neighbours:
        sys.modules.pop(name, None)
    _neighbours.clear()
    before = set(sys.modules)
    sys.path.insert(0, folder)
    importlib.invalidate_caches()
    try:
        yield
    finally:
        sys.path.remove(folder)
        sys.path[:] = [place for place in sys.path if place not in _folders]
        if folder not in sys.path:
            sys.path.append(folder)
            _folders.add(folder)
        new = {name: sys.modules[name] for name in set(sys.modules) - before}
        _neighbours.update(
            name for name, module in new.items() if str(getattr(module, "__file__", "")).startswith(folder + os.sep)
        )


_neighbours: set[str] = set()  # names of the modules that users' files imported from beside them
_folders: set[str] = set()  # that were added to sys.path


def source_file(kind: type) -> str | None:
    """Returns the file that defines a class."""
    return getattr(sys.modules.get(kind.__module__), "__file__", None)


def _location(error: BaseException, file: str | None) -> str:
    if (place := user_place(error)) is not None:
        return place
    frames = [frame for frame in traceback.extract_tb(error.__traceback__) if frame.filename == file]
    return f" ({Path(frames[-1].filename).name}, line {frames[-1].lineno}, in {frames[-1].name})" if frames else ""
