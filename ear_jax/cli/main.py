"""The `ear` command: picks the subcommand, and turns what goes wrong into one line and an exit code."""

from __future__ import annotations

import importlib
import os
import sys

from ear_jax.errors import RunError, UsageError, unknown
from ear_jax.stopping import Stopped

# Each is a function main(arguments) in the module; imported only when it is called.
COMMANDS = {
    "train": ("ear_jax.cli.train", "train a policy on a family of tasks, or continue a run"),
    "evaluate": ("ear_jax.cli.evaluate", "play a run's policy on its tasks"),
    "interpolate": ("ear_jax.cli.interpolate", "do what lies between two trained tasks, or beyond them"),
    "compose": ("ear_jax.cli.compose", "do two tasks of different kinds at once"),
    "adapt": ("ear_jax.cli.adapt", "find the codes of tasks never trained on"),
    "map": ("ear_jax.cli.map", "draw what every place on the sphere of codes does"),
    "explore": ("ear_jax.cli.explore", "make a page on which you steer the robot by pointing at that sphere"),
    "lse": ("ear_jax.cli.lse", "compare the state embedding along a gait with the raw state"),
    "render": ("ear_jax.cli.render", "film a policy, and draw the robot's way as a stop-motion strip"),
    "export": ("ear_jax.cli.export", "write a run's policy to one file that loads anywhere"),
    "families": ("ear_jax.cli.families", "list the families of tasks"),
    "pretrained": ("ear_jax.cli.pretrained", "list the trained agents that ship with the package"),
    "demo": (
        "ear_jax.cli.demo",
        "train a small agent here and now and see it run; or see one that ships (--pretrained)",
    ),
    "doctor": ("ear_jax.cli.doctor", "say what this installation is and whether it can work"),
}


def usage() -> str:
    lines = [f"  {name:<11} {what}" for name, (_, what) in COMMANDS.items()]
    return (
        "usage: ear COMMAND [OPTIONS]\n\ncommands:\n" + "\n".join(lines) + "\n\n`ear COMMAND --help` tells its options."
    )


def main(arguments: list[str] | None = None) -> int:
    """Runs one command line; returns the exit code: 0, 1, 2 (usage), 130 or 143 (stopped, and saved)."""
    words = sys.argv[1:] if arguments is None else arguments
    if not words or words[0] in ("-h", "--help"):
        print(usage())
        return 0 if words else 2
    try:
        if words[0] not in COMMANDS:
            raise unknown("command", words[0], COMMANDS)
        # JAX's and XLA's log lines are not for a person; a user who wants them sets this.
        os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "2")
        module = importlib.import_module(COMMANDS[words[0]][0])
        module.main(words[1:])
        sys.stdout.flush()
        return 0
    except (UsageError, RunError) as error:
        print(f"ear: {error}", file=sys.stderr)
        return 2 if isinstance(error, UsageError) else 1
    except KeyboardInterrupt:
        print("ear: interrupted", file=sys.stderr)
        return 130
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # whoever read us has left
        return 1
    except OSError as error:
        print(f"ear: {error.filename}: {error.strerror}" if error.filename else f"ear: {error}", file=sys.stderr)
        return 1
    except Stopped as stop:
        return stop.exit_code


if __name__ == "__main__":
    sys.exit(main())
