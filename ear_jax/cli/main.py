"""The `ear` command: picks the subcommand."""

from __future__ import annotations

import importlib
import os
import sys

from ear_jax.cli.exits import exit_code
from ear_jax.errors import unknown

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
    code = exit_code("ear", lambda: _run(*words) if words else print(usage()))
    return code if words else 2


def _run(name: str, *arguments: str) -> None:
    if name in ("-h", "--help"):
        print(usage())
        return
    if name not in COMMANDS:
        raise unknown("command", name, COMMANDS)
    # JAX's and XLA's log lines are not for a person; a user who wants them sets this.
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "2")
    importlib.import_module(COMMANDS[name][0]).main(list(arguments))


if __name__ == "__main__":
    sys.exit(main())
