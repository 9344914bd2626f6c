"""The replay of a run, for what is learnt from it after training."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import jax

from ear_jax.learning.replay import Replay
from ear_jax.process.terminal import say
from ear_jax.runs import checkpoint, training
from ear_jax.runs.directory import is_run
from ear_jax.runs.history import read_step
from ear_jax.runs.trained import Trained


def read_replay(trained: Trained) -> Replay | None:
    """Reads the replay, each leaf [seeds, …], in the checkpoint that a run's policies are from.

    None if there is none: the policies came in a file, or the run saves no replay or has trained on since.

    Raises:
      RunError: the checkpoint cannot be read.
    """
    if not is_run(trained.directory) or trained.program.learner.on_policy:
        return None
    step = read_step(trained.directory, say)
    if step.epoch != trained.epoch or not step.about.get("replay", True):
        return None
    init = partial(training.init, trained.program)
    like = jax.eval_shape(lambda: jax.vmap(init)(training.seed_keys(trained.program.config)))
    wanted = replace(jax.tree.map(lambda _: None, like), replay=like.replay, collected=like.collected)
    replay: Replay = checkpoint.restore(step, wanted, partly=True).replay
    return replay
