"""`ear map RUN`."""

from __future__ import annotations

import json
from dataclasses import dataclass

from ear_jax.cli.arguments import check_least, parse
from ear_jax.cli.on_run import OnRun
from ear_jax.embeddings.map import check_sphere, describe, survey
from ear_jax.figures.map import draw_map
from ear_jax.process.terminal import phase
from ear_jax.runs import records


@dataclass(frozen=True, kw_only=True)
class MapCommand(OnRun):
    """Roll out codes spread over the sphere and draw what each makes the robot do."""

    places: int = 2000
    """Codes."""
    episodes: int = 1
    """Episodes a code."""


def main(words: list[str]) -> None:
    command = parse(MapCommand, words, "map")
    check_least(command, places=10, episodes=1)
    trained = command.load()
    check_sphere(trained, 3)
    with phase(f"rolling out {command.places} LTEs"):
        document = describe(trained, survey(trained, command.places, command.episodes, command.seed))
    records.write_json(trained.directory / "map.json", {**document, **records.provenance()})
    pictures = draw_map(trained.directory / "figures", document)
    if command.json:
        print(json.dumps({**document, "figures": [str(path) for path in pictures]}))
        return
    quantity, unit = document["commanded"]["outcome"], document["commanded"]["unit"]
    for one in document["seeds"]:
        print(f"seed {one['seed']}: {quantity} {min(one['achieved']):.2f} to {max(one['achieved']):.2f} {unit}")
    print("pictures: " + ", ".join(str(path) for path in pictures))
