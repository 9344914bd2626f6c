"""How a command line ends: with a line about what went wrong, and an exit code."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable

from ear_jax.errors import RunError, UsageError
from ear_jax.process.stopping import Stopped


def exit_code(program: str, command: Callable[[], None]) -> int:
    """Runs a command; returns 0, 1 (failed), 2 (usage), 130 or 143 (stopped, and saved), having said why."""
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
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # whoever read us has left
        return 1
    except OSError as error:
        why = f"{error.filename}: {error.strerror}" if error.filename else error
        print(f"{program}: {why}", file=sys.stderr)
        return 1
    except Stopped as stop:
        return stop.exit_code
