"""The `ear` command, which imports and runs a subcommand."""

from __future__ import annotations

import importlib
import os
import sys

from ear_jax.cli.exits import exit_code
from ear_jax.errors import unknown

# Module and summary of each; the module, imported only when it is called, has a function main(arguments).
COMMANDS = {
    "train": ("ear_jax.cli.train", "train a policy on a family of tasks, or continue a run"),
    "evaluate": ("ear_jax.cli.evaluate", "play a run's policy on its tasks, or under any task embedding (LTE)"),
    "interpolate": ("ear_jax.cli.interpolate", "blend the LTEs of two tasks, to do what lies between or beyond them"),
    "compose": ("ear_jax.cli.compose", "blend two tasks of different kinds, to do both at once"),
    "adapt": ("ear_jax.cli.adapt", "find LTEs for tasks never trained on"),
    "map": ("ear_jax.cli.map", "draw what the robot does under LTEs all over their sphere"),
    "explore": ("ear_jax.cli.explore", "make a web page on which you steer the robot by pointing at that sphere"),
    "lse": ("ear_jax.cli.lse", "compare the state embedding (LSE) along a gait with the raw state"),
    "render": ("ear_jax.cli.render", "film the robot, and draw it as a stop-motion strip"),
    "export": ("ear_jax.cli.export", "write a run's policy to one file that loads on any machine"),
    "families": ("ear_jax.cli.families", "list the families of tasks"),
    "pretrained": ("ear_jax.cli.pretrained", "list the trained agents that ship with the package"),
    "demo": ("ear_jax.cli.demo", "train a small agent and see it run, or see a pretrained one (--pretrained)"),
    "doctor": ("ear_jax.cli.doctor", "check this installation"),
}


def usage() -> str:
    """Returns the help of `ear` itself."""
    lines = [f"  {name:<11} {summary}" for name, (_, summary) in COMMANDS.items()]
    return (
        "usage: ear COMMAND [OPTIONS]\n\ncommands:\n" + "\n".join(lines) + "\n\n`ear COMMAND --help` lists its options."
    )


def main(arguments: list[str] | None = None) -> int:
    """Runs one command line and returns its exit code, as `exit_code` does."""
    words = sys.argv[1:] if arguments is None else arguments
    code = exit_code("ear", lambda: _run(*words) if words else print(usage()))
    return code if words else 2


def _run(name: str, *arguments: str) -> None:
    if name in ("-h", "--help"):
        print(usage())
        return
    if name not in COMMANDS:
        raise unknown("command", name, COMMANDS)
    # Hides log lines of JAX and XLA, unless the user sets the variable.
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "2")
    importlib.import_module(COMMANDS[name][0]).main(list(arguments))


if __name__ == "__main__":
    sys.exit(main())
