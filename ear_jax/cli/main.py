"""The `ear` command, which imports and runs a subcommand."""

from __future__ import annotations

import importlib
import os
import sys

import ear_jax
from ear_jax.cli.exits import exit_code
from ear_jax.errors import UsageError, hint, known_name
from ear_jax.process.stopping import leave_on_interrupt, stop_with_parent
from ear_jax.process.streams import starting

# Module and summary of each; the module, imported only when it is called, has a function main(arguments).
COMMANDS = {
    "train": ("ear_jax.cli.train", "train a policy on a family of tasks, or continue a run"),
    "sweep": ("ear_jax.cli.sweep", "train with several values of some settings side by side, and compare"),
    "config": ("ear_jax.cli.config", "print the settings of a training command, as a file for `ear train --config`"),
    "evaluate": ("ear_jax.cli.evaluate", "play a run's policy on its tasks, or under any task embedding (LTE)"),
    "interpolate": ("ear_jax.cli.interpolate", "blend the LTEs of two tasks, to do what lies between or beyond them"),
    "compose": ("ear_jax.cli.compose", "blend two tasks of different kinds, to do both at once"),
    "adapt": ("ear_jax.cli.adapt", "find LTEs for tasks never trained on, or for any reward"),
    "refine": ("ear_jax.cli.refine", "improve a policy by PPO, with its LTEs as they are"),
    "imagine": ("ear_jax.cli.imagine", "learn from the replay what the robot would do under any LTE"),
    "follow": ("ear_jax.cli.follow", "follow a profile of speed or a path by LTEs that change with time"),
    "map": ("ear_jax.cli.map", "draw what the robot does under LTEs all over their sphere"),
    "front": ("ear_jax.cli.front", "draw what two rewards trade against each other, under LTEs all over the sphere"),
    "explore": ("ear_jax.cli.explore", "make a web page on which you steer the robot by pointing at that sphere"),
    "lse": ("ear_jax.cli.lse", "compare the sensory embedding (LSE) along a gait with the raw state"),
    "plot": ("ear_jax.cli.plot", "draw the training curves of runs, with seeds as bands"),
    "compare": ("ear_jax.cli.compare", "compare two runs: settings, returns, and how often one beats the other"),
    "log": ("ear_jax.cli.log", "copy a run's metrics to TensorBoard or Weights & Biases"),
    "render": ("ear_jax.cli.render", "film the robot, and draw it as a stop-motion strip"),
    "export": ("ear_jax.cli.export", "write a run's policy to one file that loads on any machine"),
    "families": ("ear_jax.cli.families", "list the families of tasks"),
    "pretrained": ("ear_jax.cli.pretrained", "list the trained agents that ship with the package"),
    "demo": ("ear_jax.cli.demo", "train a small agent and see it run, or see a pretrained one (--pretrained)"),
    "completion": ("ear_jax.cli.completion", "print a script that completes commands and flags in a shell"),
    "doctor": ("ear_jax.cli.doctor", "check this installation"),
}

# Words that users try, and the commands that do what they mean.
SYNONYMS = {
    **dict.fromkeys(("resume", "continue", "run", "fit", "learn"), ("train",)),
    **dict.fromkeys(("play", "watch", "show", "enjoy"), ("render", "evaluate", "explore")),
    **dict.fromkeys(("test", "eval", "score"), ("evaluate",)),
    **dict.fromkeys(("video", "film", "movie", "gif", "picture", "visualize", "visualise"), ("render",)),
    **dict.fromkeys(("blend", "mix"), ("interpolate", "compose")),
    **dict.fromkeys(("search", "transfer"), ("adapt",)),
    **dict.fromkeys(("finetune", "fine-tune"), ("refine", "adapt")),
    **dict.fromkeys(("improve", "polish", "ppo"), ("refine",)),
    **dict.fromkeys(("list", "ls"), ("families", "pretrained")),
    **dict.fromkeys(("agents", "models", "zoo", "download", "hub"), ("pretrained",)),
    **dict.fromkeys(("envs", "tasks", "environments"), ("families",)),
    **dict.fromkeys(("save", "deploy"), ("export",)),
    **dict.fromkeys(("web", "page", "browse", "steer"), ("explore",)),
    **dict.fromkeys(("check", "info", "env", "diagnose"), ("doctor",)),
    **dict.fromkeys(("example", "tutorial", "quickstart", "start"), ("demo",)),
}


def usage() -> str:
    """Returns the help of `ear` itself."""
    lines = [f"  {name:<11} {summary}" for name, (_, summary) in COMMANDS.items()]
    return (
        "usage: ear COMMAND [OPTIONS]\n\ncommands:\n"
        + "\n".join(lines)
        + "\n\n`ear COMMAND --help` lists its options; `ear --version` tells the version."
    )


def main(arguments: list[str] | None = None) -> int:
    """Runs one command line and returns its exit code, as `exit_code` does."""
    words = sys.argv[1:] if arguments is None else arguments
    stop_with_parent()
    with leave_on_interrupt():
        code = exit_code("ear", lambda: _run(*words) if words else print(usage()))
    return code if words else 2


def find_command(word: str) -> str:
    """Returns the command that a word names; raises UsageError, with those that it may mean, if there is none."""
    if meant := SYNONYMS.get(word.lower()):
        again = " (the same `ear train` command continues a run)" if word.lower() in ("resume", "continue") else ""
        raise UsageError(f"unknown command {word!r}{hint(meant)}{again} (there are: {', '.join(COMMANDS)})")
    return known_name("command", word, COMMANDS)


def _run(name: str, *words: str) -> None:
    arguments = list(words)
    if name in ("-V", "--version", "version"):
        print(f"ear_jax {ear_jax.__version__}")
        return
    if name in ("-h", "--help", "help"):
        if not arguments:
            print(usage())
            return
        name, *arguments = (*arguments, "--help")
    name = find_command(name)
    # Hides log lines of JAX and XLA, unless the user sets the variable.
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "2")
    with starting(f"ear {name}"):
        command = importlib.import_module(COMMANDS[name][0])
    command.main(arguments)


if __name__ == "__main__":
    sys.exit(main())
