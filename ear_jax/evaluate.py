"""What a policy does under given codes: whole episodes from random starts, without exploration."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from ear_jax.agents import Agent
from ear_jax.envs.family import Family, Outcome
from ear_jax.grid import Grid, Transition
from ear_jax.networks import Params
from ear_jax.rollout import act_with, rollout
from ear_jax.runtime import compiler_options
from ear_jax.tasks import TaskParams
from ear_jax.train import Program, evaluation_keys
from ear_jax.trained import Trained, for_each_seed


@struct.dataclass
class Episodes:
    """Episodes [rows, episodes]."""

    returns: jax.Array
    lengths: jax.Array  # int32, steps until termination or the time limit
    late: Outcome  # outcomes averaged over the second half of the episode: of a whole one, steps 101–200
    whole: Outcome  # and over all of it


def play(
    family: Family,
    agent: Agent,
    policy: Params,
    codes: jax.Array,
    tasks: TaskParams,
    key: jax.Array,
    episodes: int,
    explore: bool = False,
) -> Episodes:
    """Plays whole episodes, each row under its own code and scored for its own task.

    Args:
      family: the environment.
      agent, policy: who acts.
      codes: [rows, code].
      tasks: each leaf [rows].
      key: seeds the starts, and the actions if they are drawn.
      episodes: how many a row.
      explore: draw actions from the policy instead of taking tanh of its mean.
    """
    rows, steps = codes.shape[0], family.episode_length
    key_start, key_noise = jax.random.split(key)
    cells = Grid(family).start(key_start, tasks, episodes)
    shape = (steps, rows, episodes, family.action_size)
    noise = jax.random.normal(key_noise, shape) if explore else jnp.zeros(shape)

    def record(transition: Transition) -> tuple[Outcome, jax.Array, jax.Array]:
        return transition.outcome, transition.terminated, transition.valid

    _, (outcome, failed, valid) = rollout(Grid(family), act_with(agent, policy, codes), cells, noise, record)
    over = failed | ~valid
    over_before = jnp.cumsum(over, axis=0) - over
    playing = (over_before == 0) & valid  # [steps, rows, episodes]: the first episode only
    lengths = jnp.sum(playing, axis=0)
    reward = jax.vmap(jax.vmap(jax.vmap(family.reward, in_axes=(0, None))), in_axes=(0, None))(outcome, tasks)
    late = playing & (jnp.arange(1, steps + 1)[:, None, None] > lengths // 2)

    def mean_over(when: jax.Array) -> Outcome:
        count = jnp.maximum(jnp.sum(when, axis=0), 1)
        return jax.tree.map(lambda leaf: jnp.sum(jnp.where(when, leaf, 0.0), axis=0) / count, outcome)

    returns = jnp.sum(jnp.where(playing, reward, 0.0), axis=0)
    return Episodes(returns, lengths, mean_over(late), mean_over(playing))


def achieved(family: Family, played: Episodes) -> jax.Array:
    """The commanded quantity [rows], from the mean outcomes of each row's episodes, so that 359° and 1° are 0°."""
    late, whole = (jax.tree.map(lambda leaf: leaf.mean(axis=-1), means) for means in (played.late, played.whole))
    return family.achieved(late, whole)


def play_codes(program: Program, policy: Params, codes: jax.Array, key: jax.Array, episodes: int) -> Episodes:
    """Plays one policy under any codes [rows, code], for their outcomes; their returns are of no task in particular."""
    tasks = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf[0], len(codes)), program.tasks.params)
    return play(program.family, program.agent, policy, codes, tasks, key, episodes)


def play_training_tasks(program: Program, policy: Params, key: jax.Array, episodes: int) -> Episodes:
    """Plays one policy on the tasks it was trained on."""
    codes = program.agent.codes(policy)
    return play(program.family, program.agent, policy, codes, program.tasks.params, key, episodes)


def evaluate(trained: Trained, episodes: int, seed: int) -> dict[str, Any]:
    """Plays every seed's policy on the training tasks.

    Args:
      trained: the run.
      episodes: how many a task.
      seed: of the starts, all different from those of training.

    Returns:
      What `ear evaluate --json` prints: per seed and task the return (mean, standard deviation), the mean outcome, how
      many episodes failed (ended before the time limit), and each episode. A task fails with any of its episodes.
    """
    program = trained.program
    config, count = program.config, program.config.seeds
    keys = evaluation_keys(jax.vmap(jax.random.fold_in, (None, 0))(jax.random.key(seed), jnp.arange(count)), 0)
    play_all = jax.jit(
        jax.vmap(lambda policy, key: play_training_tasks(program, policy, key, episodes)),
        compiler_options=compiler_options(),
    )
    played = jax.device_get(play_all(trained.policies, keys))
    seeds = [
        _describe_seed(program, config.seed + index, jax.tree.map(lambda leaf, index=index: leaf[index], played))
        for index in range(count)
    ]
    failures = [task["failures"] for seed in seeds for task in seed["tasks"]]
    return {
        "run": trained.name,
        "family": config.family,
        "agent": config.agent,
        "preset": config.preset,
        "engine": program.family.engine.name,
        "env_steps": program.env_steps(trained.collected),
        "updates": trained.epoch * config.sac.updates,
        "episodes": episodes,
        "episode_length": program.family.episode_length,
        "commanded": program.family.quantity,
        "seeds": seeds,
        "mean_return": float(np.mean(played.returns)),
        "failed_tasks": {"failed": sum(count > 0 for count in failures), "total": len(failures)},
    }


def evaluate_code(trained: Trained, codes: jax.Array, episodes: int, seed: int) -> dict[str, Any]:
    """What every seed's policy does under a code of its own, whatever task that may serve.

    Args:
      trained: the run.
      codes: [seeds, code].
      episodes: how many.
      seed: of the starts.

    Returns:
      What `ear evaluate --lte --json` prints.
    """
    program, family = trained.program, trained.program.family

    def of_seed(policy: Params, key: jax.Array, code: jax.Array) -> tuple[Episodes, jax.Array]:
        played = play_codes(program, policy, program.agent.project(code)[None], key, episodes)
        return played, achieved(family, played)

    played, reached = for_each_seed(trained, of_seed, seed, codes)
    return {
        "run": trained.name,
        "episodes": episodes,
        "commanded": family.quantity,
        "seeds": [
            {
                "seed": program.config.seed + index,
                "lte": codes[index].tolist(),
                "length": float(played.lengths[index].mean()),
                "outcome": {
                    **{name: float(value[index].mean()) for name, value in played.late.items()},
                    family.commanded: float(reached[index, 0]),
                },
            }
            for index in range(program.config.seeds)
        ],
    }


def _describe_seed(program: Program, seed: int, played: Episodes) -> dict[str, Any]:
    """One seed's episodes [tasks, episodes] as a document.

    What a task's episodes achieved together comes from their mean outcomes, so that 359° and 1° are 0° and not 180°.
    """
    family = program.family
    tasks = []
    for row, task in enumerate(program.tasks.tasks):
        late, whole = ({name: value[row] for name, value in means.items()} for means in (played.late, played.whole))
        mean_late, mean_whole = ({name: value.mean() for name, value in means.items()} for means in (late, whole))
        mean_late[family.commanded] = family.achieved(mean_late, mean_whole)
        tasks.append(
            {
                "name": task.name,
                "target": task.target,
                "return_mean": float(played.returns[row].mean()),
                "return_std": float(played.returns[row].std()),
                "failures": int((played.lengths[row] < family.episode_length).sum()),
                "outcome": {name: float(value) for name, value in mean_late.items()},
                "episodes": {
                    "return": played.returns[row].tolist(),
                    "length": played.lengths[row].tolist(),
                    **{name: value.tolist() for name, value in late.items()},
                    family.commanded: np.asarray(family.achieved(late, whole)).tolist(),
                },
            }
        )
    return {"seed": seed, "mean_return": float(played.returns.mean()), "tasks": tasks}
