"""`ear explore RUN`."""

from __future__ import annotations

import json
from dataclasses import dataclass

from ear_jax.cli.arguments import check_least, parse
from ear_jax.cli.on_run import OnPolicy
from ear_jax.process.terminal import phase


@dataclass(frozen=True, kw_only=True)
class ExploreCommand(OnPolicy):
    """Make a web page on which you point at the sphere of task embeddings (LTEs) and watch what the robot does.

    The page is one file and needs no network.

    Example: ear explore pretrained:halfcheetah-vel
    """

    places: int = 800
    """LTEs on the page, spread evenly over the sphere."""
    steps: int = 200
    """Environment steps per LTE, of which the page shows the second half."""


def main(words: list[str]) -> None:
    command = parse(ExploreCommand, words, "explore")
    check_least(command, places=10, steps=8)
    trained = command.load()
    from ear_jax.figures.explore import write_page
    from ear_jax.rendering.explore import play_sphere

    seed = trained.program.config.seed + command.policy
    with phase(f"rolling out {command.places} LTEs"):
        document, loops = play_sphere(trained, command.policy, command.places, command.steps, command.seed)
    title = f"{trained.program.family.name}: one policy, every task embedding"
    path = write_page(trained.directory / f"explore_seed{seed}.html", {"title": title, **document}, loops)
    if command.json:
        print(json.dumps({"seed": seed, **document, "page": str(path)}))
    else:
        print(f"{path}: open it in a browser")
