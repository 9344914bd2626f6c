"""Guards around users' code: an exception becomes one line that says where it was raised."""

from __future__ import annotations

import sys
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import jax

from ear_jax.errors import RunError, UsageError

NEEDS_CONCRETE_VALUES = (
    jax.errors.ConcretizationTypeError,
    jax.errors.TracerArrayConversionError,
    jax.errors.TracerIntegerConversionError,
    jax.errors.NonConcreteBooleanIndexError,
)


@contextmanager
def user_code(fails: str, file: str | None) -> Iterator[None]:
    """Wraps a user's code, as a context or a decorator.

    Args:
      fails: the start of the message if it raises, e.g. `reward() fails`.
      file: the file of that code, whose line is then named.

    Raises:
      UsageError: the code raised something; the message is one line. Its own UsageError and RunError pass through.
    """
    try:
        yield
    except (UsageError, RunError):
        raise
    except NEEDS_CONCRETE_VALUES as error:
        message = "JAX traces it without concrete values; use jnp.where for `if`, and jnp for float() and np"
        raise UsageError(f"{fails}: {message}{_location(error, file)}") from error
    except (Exception, SystemExit) as error:
        message = f"{type(error).__name__}: {error}".splitlines()[0].removesuffix(": ")
        raise UsageError(f"{fails}: {message}{_location(error, file)}") from error


def source_file(kind: type) -> str | None:
    """Returns the file that defines a class."""
    return getattr(sys.modules.get(kind.__module__), "__file__", None)


def _location(error: BaseException, file: str | None) -> str:
    frames = [frame for frame in traceback.extract_tb(error.__traceback__) if frame.filename == file]
    return f" ({Path(frames[-1].filename).name}, line {frames[-1].lineno}, in {frames[-1].name})" if frames else ""
