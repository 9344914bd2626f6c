"""Training whose arithmetic is a toy's and compiles at once: for tests of everything around it.

`python -m tests.helpers.toy WORDS` is `ear WORDS` with such training.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from ear_jax.learning.episodes import Episodes
from ear_jax.runs import on_host
from ear_jax.runs.compiled import Compiled
from ear_jax.runs.seeds import over_seeds
from ear_jax.runs.training import Metrics, Program, TrainState


@struct.dataclass
class ToyLearner:
    policy: jax.Array


def compile_toy(program: Program, keys: jax.Array, numbers: Mapping[str, np.ndarray] | None = None) -> Compiled:
    """Stands for `compile_program`: a policy of three numbers that drift, and a replay of the last ones.

    Its arithmetic is exact enough for equal bits however many seeds one program has.
    """
    tasks, seeds = len(program.tasks), len(keys)

    def init(key: jax.Array) -> TrainState:
        zero, key = jnp.int32(0), jax.random.fold_in(key, 1)
        return TrainState(ToyLearner(jax.random.uniform(key, (3,))), jnp.zeros((4, 3)), jnp.zeros(2), key, zero, zero)

    def collect(state: TrainState) -> tuple[TrainState, Metrics]:
        replay = jnp.roll(state.replay, 1, axis=0).at[0].set(state.learner.policy)
        return state.replace(replay=replay, cells=state.cells + 1, collected=state.collected + 1), {}

    def learn(state: TrainState) -> tuple[TrainState, Metrics]:
        key, later = jax.random.split(state.key)
        policy = 0.5 * state.replay.mean(axis=0) + jax.random.uniform(key, (3,))
        metrics = {"loss": policy[0], "finite_updates": jnp.full(tasks, 4, jnp.int32)}
        return state.replace(learner=ToyLearner(policy), key=later, epoch=state.epoch + 1), metrics

    def evaluate(policy: jax.Array, key: jax.Array) -> Episodes:
        returns = policy.sum() + jax.random.uniform(key, (tasks, program.config.log.episodes))
        return Episodes(returns, jnp.ones_like(returns, jnp.int32), {}, {})

    start = over_seeds(init, seeds)
    parts = [over_seeds(part, seeds, donate_argnums=0) for part in (collect, learn)]
    return Compiled(start, *parts, over_seeds(evaluate, seeds), jax.eval_shape(start, keys))


if __name__ == "__main__":
    from ear_jax.cli.main import main
    from tests.helpers.quick import compile_quickly

    compile_quickly()
    on_host.compile_program = compile_toy  # type: ignore[assignment]
    sys.exit(main())
