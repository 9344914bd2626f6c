"""Code that is not ours: whatever it raises becomes one line that says where."""

from __future__ import annotations

import sys
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import jax

from ear_jax.errors import RunError, UsageError

PYTHON_VALUE_WANTED = (
    jax.errors.ConcretizationTypeError,
    jax.errors.TracerArrayConversionError,
    jax.errors.TracerIntegerConversionError,
    jax.errors.NonConcreteBooleanIndexError,
)


@contextmanager
def user_code(fails: str, file: str | None) -> Iterator[None]:
    """Runs a user's code.

    Args:
      fails: what to say if it does, e.g. `reward() fails`.
      file: the file it stands in; its line is told too.

    Raises:
      UsageError: in one line, what the code raised. Its own UsageError and RunError pass as they are.
    """
    try:
        yield
    except (UsageError, RunError):
        raise
    except PYTHON_VALUE_WANTED as error:
        message = (
            "JAX traces it, and Python does not know its values; use jnp.where for `if`, and jnp for float() and np"
        )
        raise UsageError(f"{fails}: {message}{_place(error, file)}") from error
    except (Exception, SystemExit) as error:
        message = f"{type(error).__name__}: {error}".splitlines()[0].removesuffix(": ")
        raise UsageError(f"{fails}: {message}{_place(error, file)}") from error


def source_file(kind: type) -> str | None:
    """The file a class stands in."""
    return getattr(sys.modules.get(kind.__module__), "__file__", None)


def _place(error: BaseException, file: str | None) -> str:
    frames = [frame for frame in traceback.extract_tb(error.__traceback__) if frame.filename == file]
    return f" ({Path(frames[-1].filename).name}, line {frames[-1].lineno}, in {frames[-1].name})" if frames else ""
