"""`ear lse RUN`."""

from __future__ import annotations

import json
from dataclasses import dataclass

from ear_jax.cli.arguments import parse
from ear_jax.cli.on_run import OnRun
from ear_jax.embeddings.lse import describe, sense
from ear_jax.envs import find_task
from ear_jax.figures.lse import draw_signals
from ear_jax.runs import records


@dataclass(frozen=True, kw_only=True)
class LseCommand(OnRun):
    """Compare what the policy's state encoder says along a gait with the raw state: main directions and periodicity."""

    task: str | None = None
    """A task it was trained on, as in 2; by default the middle one."""


def main(words: list[str]) -> None:
    command = parse(LseCommand, words, "lse")
    trained = command.load()
    names = trained.program.tasks.names
    task = names[len(names) // 2] if command.task is None else find_task(trained.program.family, command.task).name
    document = describe(trained, task, sense(trained, task, command.seed))
    records.write_json(trained.directory / "lse.json", {**document, **records.provenance()})
    pictures = draw_signals(trained.directory / "figures", document)
    if command.json:
        print(json.dumps({**document, "figures": [str(path) for path in pictures]}))
        return
    for one in document["seeds"]:
        for name, what in (("state", "raw state"), ("lse", "LSE")):
            signal = one[name]
            share = sum(signal["explained"])
            repeats = (
                f"repeats every {signal['period']:.2f} s with autocorrelation {signal['autocorrelation_peak']:.2f}"
            )
            said = repeats if signal["period"] else "does not repeat"
            print(f"seed {one['seed']}, {what}: {said}; two main directions hold {share:.0%} of its variance")
    print("pictures: " + ", ".join(str(path) for path in pictures))
