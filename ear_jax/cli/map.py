"""`ear map RUN`."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import tyro

from ear_jax import records
from ear_jax.atlas import describe, survey
from ear_jax.cli.arguments import parse
from ear_jax.errors import UsageError
from ear_jax.report.maps import draw_map
from ear_jax.runtime import enable_cache
from ear_jax.terminal import phase
from ear_jax.trained import load


@dataclass(frozen=True)
class MapCommand:
    """Roll out codes spread over the sphere and draw what each makes the robot do."""

    run: tyro.conf.Positional[Path]
    """The run directory, an exported file, or pretrained:NAME."""
    places: int = 2000
    """Codes."""
    episodes: int = 1
    """Episodes a code."""
    seed: int = 0
    """Seeds the starts."""
    family: str | None = None
    """A family of your own has to be named again, as for `ear train`."""
    json: bool = False
    """Print one JSON document and nothing else."""


def main(words: list[str]) -> None:
    command = parse(MapCommand, words, "map")
    for name, least in (("places", 10), ("episodes", 1)):
        if getattr(command, name) < least:
            raise UsageError(f"--{name} {getattr(command, name)} is too small; it must be at least {least}")
    enable_cache()
    trained = load(command.run, command.family)
    if (size := trained.program.agent.code_size) != 3:
        raise UsageError(f"this run's codes have {size} numbers; only a sphere of 3 can be drawn")
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
