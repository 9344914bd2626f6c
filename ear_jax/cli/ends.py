"""The ends of a blend, by the names that a user gives: training tasks or saved LTEs."""

from __future__ import annotations

import numpy as np

from ear_jax.embeddings import ltes
from ear_jax.embeddings.interpolate import End, Pair, trained_ends
from ear_jax.envs import find_task
from ear_jax.errors import UsageError
from ear_jax.runs.trained import Trained


def find_pair(trained: Trained, first: str, second: str, targets: bool = True) -> Pair:
    """Returns the ends of an interpolation by the names that a user gives; both have `targets` unless told otherwise.

    Raises:
      UsageError: a name of neither a training task nor a saved LTE, a task without a target, or the same task twice.
    """
    ends = find_end(trained, first), find_end(trained, second)
    for end in ends:
        if targets and end.target is None:
            quantity = trained.program.family.commanded
            raise UsageError(f"{end.name!r} has no target {quantity} to meet between; blend such tasks at given --beta")
    if ends[0].name == ends[1].name:
        raise UsageError(f"--between {first} {second} names one task twice")
    return ends


def find_end(trained: Trained, word: str) -> End:
    """Returns a saved LTE or a training task by its name."""
    family, program = trained.program.family, trained.program
    if word in ltes.saved(trained.directory):
        saved = ltes.lookup(trained.directory, word, trained.fingerprint)
        target = None if saved.get("asked_by") == "--reward" else find_task(family, saved["task"]).target
        return End(word, target, np.array(saved["codes"], np.float32))
    return trained_ends(trained)[program.tasks.index(find_task(family, word).name)]
