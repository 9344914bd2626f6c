"""The end of a command line: one line about the error, and an exit code."""

from __future__ import annotations

import errno
from collections.abc import Callable

from ear_jax.errors import RunError, UsageError, plain, user_fault
from ear_jax.process.stopping import Stopped
from ear_jax.process.streams import Stderr, flush_results, open_streams

UNWRITTEN = (errno.EBADF, errno.ENOSPC, errno.EIO)  # of a print; those that write files name them


def exit_code(program: str, command: Callable[[], None]) -> int:
    """Runs a command, prints its error if it fails, and returns the exit code.

    Returns:
      0, 1 (failed), 2 (usage), or 130, 143 or 129 (stopped by a signal, with its state saved).
    """
    open_streams()
    code = _code_of(program, command)
    unwritten = flush_results()
    if unwritten is None or code:
        return code
    return _report(program, f"cannot write to standard output: {unwritten}", 1) if unwritten else 1


def _code_of(program: str, command: Callable[[], None]) -> int:
    try:
        command()
        return 0
    except (UsageError, RunError) as error:
        return _report(program, str(error), 2 if isinstance(error, UsageError) else 1)
    except KeyboardInterrupt:
        return _report(program, "interrupted", 130)
    except BrokenPipeError:
        return 1  # the reader of stdout has left
    except OSError as error:
        where = error.filename or ("cannot write to standard output" if error.errno in UNWRITTEN else None)
        return _report(program, f"{where}: {error.strerror}" if where else str(error), 1)
    except Stopped as stop:
        return stop.exit_code
    except BaseException as error:
        if fault := user_fault(error):
            return _report(program, fault, 2)
        if isinstance(error, SystemExit):  # of --help
            return int(error.code or 0)
        raise


def _report(program: str, message: str, code: int) -> int:
    print(f"{program}: {plain(' '.join(message.splitlines()))}", file=Stderr())
    return code
