"""`ear map RUN`."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any

from ear_jax.cli.arguments import check_least, parse
from ear_jax.cli.on_run import OnRun
from ear_jax.cli.results import keep, label_of, show_and_keep
from ear_jax.process.terminal import phase

SHARES = ("smooth", "lasting", "covered", "ordered")  # whose geometric mean is the space's number


@dataclass(frozen=True, kw_only=True)
class MapCommand(OnRun):
    """Play task embeddings (LTEs) all over their sphere, and draw what the robot achieves under each.

    Example: ear map pretrained:ant-dir --places 500
    """

    places: int = 2000
    """LTEs to play, spread evenly over the sphere."""
    episodes: int = 1
    """Episodes per LTE."""


def main(words: list[str]) -> None:
    command = parse(MapCommand, words, "map")
    check_least(command, places=10, episodes=1)
    trained = command.load()
    from ear_jax.embeddings.map import check_sphere, describe, play_maps
    from ear_jax.figures.map import draw_map

    check_sphere(trained, 3)
    with phase(f"rolling out {command.places} LTEs"):
        document = describe(trained, play_maps(trained, command.places, command.episodes, command.seed))
    kept = partial(keep, trained.directory, "map", label_of(command), document, draw_map)
    show_and_keep(document, command.json, _print, kept)


def _print(document: dict[str, Any]) -> None:
    quantity, unit = document["commanded"]["outcome"], document["commanded"]["unit"]
    for entry in document["seeds"]:
        low, high = min(entry["achieved"]), max(entry["achieved"])
        print(f"seed {entry['seed']}: {quantity} {low:.2f} to {high:.2f} {unit}")
        if space := entry["space"]:
            print(f"  space {space['space']:.2f}: " + ", ".join(f"{name} {space[name]:.2f}" for name in SHARES))
