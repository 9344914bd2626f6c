"""`ear families`."""

from __future__ import annotations

import inspect
import json
from dataclasses import dataclass
from typing import Annotated, Any

import tyro

from ear_jax.cli.arguments import option, parse
from ear_jax.cli.results import print_table
from ear_jax.errors import RunError, UsageError, plain
from ear_jax.names import FAMILIES, family_name, offered_families
from ear_jax.process.environment import start_jax
from ear_jax.process.terminal import sign_of_life


@dataclass(frozen=True)
class FamiliesCommand:
    """List the families of tasks, or check the ones that are named.

    Example: ear families ant-dir
    """

    names: tyro.conf.Positional[Annotated[tuple[str, ...], option("[FAMILY ...]", "all that are installed")]] = ()
    """Families, as for `ear train`."""
    json: bool = False
    """Print one JSON document and nothing else."""


def main(words: list[str]) -> None:
    command = parse(FamiliesCommand, words, "families")
    families, lacking = [], {}
    named = [family_name(word) for word in command.names]
    with sign_of_life("loading the families"):
        start_jax()
        for name in named or (*FAMILIES, *offered_families()):
            try:
                families.append(describe(name))
            except (UsageError, RunError) as error:
                if named:
                    raise
                lacking[name] = str(error)
    if command.json:
        print(json.dumps({"families": families, "lacking": lacking}))
        return
    rows = []
    for family in families:
        names = family["tasks"]
        tasks = f"{len(names)}: {names[0]} … {names[-1]}"
        sizes = (str(family[key]) for key in ("observation_size", "action_size", "dt", "episode_length"))
        rows.append((family["name"], tasks, *sizes))
    print_table(("family", "tasks", "observation>", "action>", "step (s)>", "episode (steps)>"), rows)
    for name, reason in lacking.items():
        print(plain(f"{name} is not available here: {reason}"))
    print("A family of your own: ear train path/to/file.py:ClassName (docs/your-own-family.md)")


def describe(name: str) -> dict[str, Any]:
    """Returns a family's tasks, units and sizes; `dt` in seconds, `episode_length` in environment steps."""
    from ear_jax.envs import make_family

    family = make_family(name)
    return {
        "name": name,
        "summary": (inspect.getdoc(type(family)) or "").partition("\n")[0],
        "tasks": family.training_tasks().names,
        "commanded": family.commanded,
        "unit": family.unit,
        "observation_size": family.observation_size,
        "action_size": family.action_size,
        "dt": round(family.dt, 6),
        "episode_length": family.episode_length,
    }
