"""The end of a command line: one line about the error, and an exit code."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable

from ear_jax.errors import RunError, UsageError
from ear_jax.process.stopping import Stopped


def exit_code(program: str, command: Callable[[], None]) -> int:
    """Runs a command, prints its error if it fails, and returns the exit code.

    Returns:
      0, 1 (failed), 2 (usage), or 130 or 143 (stopped by a signal, with its state saved).
    """
    try:
        command()
        sys.stdout.flush()
        return 0
    except (UsageError, RunError) as error:
        print(f"{program}: {error}", file=sys.stderr)
        return 2 if isinstance(error, UsageError) else 1
    except KeyboardInterrupt:
        print(f"{program}: interrupted", file=sys.stderr)
        return 130
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # the reader of stdout has left
        return 1
    except OSError as error:
        reason = f"{error.filename}: {error.strerror}" if error.filename else error
        print(f"{program}: {reason}", file=sys.stderr)
        return 1
    except Stopped as stop:
        return stop.exit_code
