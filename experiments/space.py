"""Measures the space of LTEs of every recorded run of EAR, by playing its policy; adds `space.json` to the record.

python -m experiments.space
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import jax
import numpy as np

from ear_jax.cli.exits import exit_code
from ear_jax.embeddings.map import play_maps, space_of
from ear_jax.errors import known_name
from ear_jax.process.environment import start_jax
from ear_jax.process.terminal import say
from ear_jax.runs import records
from ear_jax.runs.trained import load
from experiments import inventory

PLACES = 300  # LTEs played, one episode each
NAME = "space.json"


def measure(record: Path) -> dict[str, Any]:
    """Returns the measures of each seed of a record's policy.

    LTEs that are not normalised lie on no sphere. They are played on the sphere whose radius is the mean length of the
    training tasks' LTEs.
    """
    trained = load(record / inventory.POLICY)
    program = trained.program
    codes = np.asarray(jax.vmap(program.agent.codes)(trained.policies))  # [seeds, tasks, code]
    radius = 1.0 if program.agent.on_sphere else float(np.linalg.norm(codes, axis=-1).mean())
    maps = play_maps(trained, PLACES, 1, 0, None if program.agent.on_sphere else radius)
    spaces = [
        {"seed": program.config.seed + index, "space": space_of(one, program.family, program.tasks, codes[index])}
        for index, one in enumerate(maps)
    ]
    return {"places": PLACES, "on_sphere": program.agent.on_sphere, "radius": round(radius, 4), "seeds": spaces}


def wanted() -> list[Path]:
    """Returns the records of EAR with a policy and no measures yet."""
    unmeasured = [
        path.parent
        for path in sorted(inventory.RECORDS.glob(f"*/{inventory.POLICY}"))
        if not (path.parent / NAME).is_file()
    ]
    return [record for record in unmeasured if records.read_run(record)["config"]["agent"] == "ear"]


def main(names: list[str]) -> None:
    """Measures the records of these names, by default all that are wanted; raises UsageError for an unknown name."""
    recorded = [path.parent.name for path in inventory.RECORDS.glob(f"*/{inventory.POLICY}")]
    chosen = [inventory.RECORDS / known_name("record", name, recorded) for name in names]
    start_jax()
    for record in chosen or wanted():
        document = measure(record)
        records.write_json(record / NAME, {**document, **records.provenance()})
        say(f"{record.name}: {document['seeds']}")


if __name__ == "__main__":
    sys.exit(exit_code("experiments.space", lambda: main(sys.argv[1:])))
