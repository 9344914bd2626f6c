"""`ear explore RUN`."""

from __future__ import annotations

import json
import webbrowser
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import tyro

from ear_jax import pretrained
from ear_jax.cli.arguments import check_least, option, parse
from ear_jax.cli.on_run import OnPolicy
from ear_jax.cli.results import check_writable
from ear_jax.errors import RunError, UsageError
from ear_jax.process.terminal import phase, say

FOLDER = Path("runs")  # of the page of all agents


@dataclass(frozen=True, kw_only=True)
class ExploreCommand(OnPolicy):
    """Make a web page on which you drag on the sphere of task embeddings (LTEs) and the robot does it at once.

    The page is one file and needs no network. Physics and policy run in it, on MuJoCo's WebAssembly, which npm fetches
    the first time. Without it, or if the page cannot compute the family, the page replays roll-outs instead.

    Example: ear explore pretrained:halfcheetah-vel --open
    """

    run: tyro.conf.Positional[Annotated[Path | None, option("RUN", "none, with --all")]] = None  # type: ignore[assignment]
    """The run directory, an exported file, or pretrained:NAME."""
    all: bool = False
    """Make one page of all agents that ship, in place of RUN."""
    places: int = 800
    """LTEs that the sphere is coloured by, spread evenly over it."""
    replay: bool = False
    """Replay roll-outs, one for each LTE, in place of live physics."""
    steps: int = 200
    """Environment steps of a roll-out that is replayed, of which the page shows the second half."""
    open: bool = False
    """Open the page in the browser."""


def main(words: list[str]) -> None:
    command = parse(ExploreCommand, words, "explore")
    check_least(command, places=10, steps=8)
    if command.all == (command.run is not None):
        raise UsageError("name a run, as in `ear explore pretrained:halfcheetah-vel`, or give --all")
    if command.all and (command.replay or command.policy or command.family):
        raise UsageError("--replay, --policy and --family go with a RUN and not with --all")
    path, document = gallery(command) if command.all else explore(command)
    if command.open:
        webbrowser.open(path.resolve().as_uri())
    if command.json:
        print(json.dumps({**document, "page": str(path)}))
    else:
        print(f"{path}: {'opened in the browser' if command.open else path.resolve().as_uri()}")


def explore(command: ExploreCommand) -> tuple[Path, dict[str, Any]]:
    """Makes the page of a run, and returns its path and its document."""
    trained = command.load()
    from ear_jax.embeddings.map import check_sphere
    from ear_jax.figures.explore import write_page
    from ear_jax.rendering.explore import play_sphere
    from ear_jax.rendering.live import page, wasm

    check_sphere(trained, 3)
    check_writable(trained.directory)
    seed = trained.program.config.seed + command.policy
    path = trained.directory / name(command, f"seed{seed}")
    try:
        described = None if command.replay else live(command, trained)
    except (RunError, UsageError) as error:
        say(f"The page replays roll-outs, as {error}")
        described = None
    if described is not None:
        page.write_live_page(path, [described], wasm.find())
        return path, {"seed": seed, "live": True, "trained": described[0]["tasks"]}
    with phase(f"rolling out {command.places} LTEs"):
        document, loops = play_sphere(trained, command.policy, command.places, command.steps, command.seed)
    title = f"{trained.program.family.name}: one policy, every task embedding"
    return write_page(path, {"title": title, **document}, loops), {"seed": seed, "live": False, **document}


def live(command: ExploreCommand, trained: Any) -> tuple[dict[str, Any], str]:
    """Describes a run's robot for the live page.

    Raises:
      UsageError, RunError: the page cannot be made, or MuJoCo's WebAssembly is missing.
    """
    from ear_jax.rendering.live import robot, wasm

    wasm.find()
    with phase(f"rolling out {command.places} LTEs"):
        return robot.describe(trained, command.policy, command.places, command.seed)


def gallery(command: ExploreCommand) -> tuple[Path, dict[str, Any]]:
    """Makes one live page of the agents that ship, and returns its path and its document."""
    from ear_jax.rendering.live import page, wasm

    found = wasm.find()
    robots = []
    for agent in pretrained.names():
        one = replace(command, run=Path(f"{pretrained.PREFIX}{agent}"))
        try:
            robots.append(live(one, one.load()))
        except (RunError, UsageError) as error:  # an extra that is not installed, or a robot that the page cannot show
            say(f"{agent} is left out: {error}")
    path = page.write_live_page(FOLDER / name(command), robots, found)
    return path, {"live": True, "robots": [description["name"] for description, _ in robots]}


def name(command: ExploreCommand, *words: str) -> str:
    """Returns the name of the page's file, which differs where its inputs do."""
    options = [
        f"{option}-{getattr(command, option)}"
        for option in ("places", "steps", "seed", "engine")
        if getattr(command, option) != getattr(ExploreCommand, option)
    ]
    return "_".join(["explore", *words, *(["replay"] if command.replay else []), *options]) + ".html"
