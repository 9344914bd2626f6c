"""The imagined sphere: what the robot would do under LTEs all over it, learnt from a replay without a roll-out.

`ear imagine` learns the successor measure of outcomes (`learning/measure.py`) and keeps, as `imagined.safetensors`, the
distribution of outcomes under each of many LTEs. From it any reward is answered.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ear_jax.agents.networks import Params
from ear_jax.embeddings.codes import spread_codes
from ear_jax.embeddings.kept import Shape, read_kept, write_kept
from ear_jax.embeddings.map import check_sphere
from ear_jax.envs.asked import Reward, score_outcomes
from ear_jax.envs.batched_env import BatchedEnv
from ear_jax.errors import RunError
from ear_jax.learning import replay as rings
from ear_jax.learning.measure import MeasureConfig, late_in_episode, learn_measure, make_measure, partition
from ear_jax.learning.replay import Experience, Replay
from ear_jax.learning.rollout import act_with, rollout
from ear_jax.process.terminal import say
from ear_jax.runs.replayed import read_replay
from ear_jax.runs.rollouts import check_rollouts
from ear_jax.runs.trained import Trained, for_each_seed
from ear_jax.tasks import any_task

FILE = "imagined.safetensors"
FORMAT = "ear_jax imagined sphere 2"
PLACES = 4000  # LTEs imagined, 0.06 radians apart on a sphere in three dimensions
STARTS = 64  # of episodes, over which the distribution under an LTE is averaged
STATES = 512  # of the replay, from which an episode goes on
EPISODES = 120  # played under the training tasks' LTEs, of all tasks together, where there is no replay
MOST = 100_000  # transitions learnt from, drawn at random from larger replays
CURVE = 60  # points of the loss that the document keeps


@dataclass(frozen=True)
class Imagined:
    """Distributions of outcomes under LTEs [places, code] spread over the sphere, for every seed's policy."""

    codes: np.ndarray  # [places, code]
    masses: np.ndarray  # [seeds, places, cells], as shares of the steps in an episode's second half
    outcomes: dict[str, np.ndarray]  # of the transitions learnt from, by name [seeds, transitions]
    cell: np.ndarray  # int32 [seeds, transitions], the cell of each

    def means(self, values: np.ndarray) -> np.ndarray:
        """Returns the mean [seeds, places] of a quantity, given its values at the transitions [seeds, transitions]."""
        cells = self.masses.shape[-1]
        counts = [np.maximum(np.bincount(cell, minlength=cells), 1) for cell in self.cell]
        of_cells = [
            np.bincount(cell, value, cells) / count
            for cell, value, count in zip(self.cell, values, counts, strict=True)
        ]
        return np.einsum("spc,sc->sp", self.masses, np.stack(of_cells))


def imagine(trained: Trained, config: MeasureConfig, seed: int) -> dict[str, Any]:
    """Learns every seed's imagined sphere and keeps it beside the run.

    Args:
      trained: the run, whose replay is learnt from; without one, episodes under its training tasks' LTEs are played.
      config: settings of learning.
      seed: seeds everything.

    Returns:
      The document that `ear imagine --json` prints.

    Raises:
      UsageError: the agent has no LTEs, or they do not lie on a sphere.
      RunError: a checkpoint cannot be read, the episodes do not fit in memory, or the result cannot be written.
    """
    check_sphere(trained)
    began = time.perf_counter()
    program = trained.program
    replay, env_steps = find_replay(trained, seed)
    items = _drawn(replay, seed)
    columns = np.stack(list(items.outcome.values()), axis=-1)  # [seeds, n, k]
    cell = np.stack([partition(outcomes, config.cells) for outcomes in columns])
    measure = make_measure(program.agent, program.family.observation_size, program.family.action_size, config)
    codes = spread_codes(PLACES, program.agent.code_size)

    def of_seed(policy: Params, key: jax.Array, items: Experience, cell: jax.Array) -> tuple[jax.Array, ...]:
        key_learn, key_start, key_states = jax.random.split(key, 3)
        params, losses = learn_measure(measure, policy, items, cell, key_learn)
        task = any_task(program.tasks.params)
        starts = BatchedEnv(program.family).start(key_start, task, STARTS).state.obs[0]
        lasting = jnp.cumsum(~items.terminated)  # draws evenly among the states that are no end
        states = jnp.searchsorted(lasting, jax.random.randint(key_states, (STATES,), 0, lasting[-1]), side="right")

        def of_code(code: jax.Array) -> jax.Array:
            first, later = (
                jax.vmap(lambda obs: measure.of_start(params, policy, code, obs))(obs)
                for obs in (starts, items.next_obs[states])
            )
            return late_in_episode(measure, first, later, cell[states], program.family.episode_length)

        all_codes = jnp.concatenate([jnp.asarray(codes), program.agent.codes(policy)])
        return jax.lax.map(of_code, all_codes, batch_size=20), losses

    masses, losses = for_each_seed(trained, of_seed, seed, items, cell)
    imagined = Imagined(codes, masses[:, : len(codes)], items.outcome, cell)
    _write(trained, imagined)
    at_trained = Imagined(codes, masses[:, len(codes) :], items.outcome, cell)
    about = {"source": "played" if env_steps else "replay", "transitions": cell.shape[1], "env_steps": env_steps}
    seconds = round(time.perf_counter() - began, 2)
    return {**about, "updates": config.updates, "seconds": seconds, "seeds": _describe(trained, at_trained, losses)}


def find_imagined(trained: Trained) -> Imagined | None:
    """Reads the imagined sphere that is kept beside a run; None if there is none of this policy, which is said."""
    path, names = trained.directory / FILE, trained.program.family.outcome_shapes
    if not path.is_file():
        return None
    seeds, size = trained.program.config.seeds, trained.program.agent.code_size
    shapes: dict[str, Shape] = {f"outcome.{name}": (seeds, None) for name in names}
    shapes |= {"codes": (PLACES, size), "masses": (seeds, PLACES, None), "cell": (seeds, None)}
    try:
        arrays = read_kept(path, shapes, trained, FORMAT)
    except RunError as error:
        say(f"{error}; run `ear imagine {trained.name}` again")
        return None
    outcomes = {name: arrays[f"outcome.{name}"] for name in names}
    return Imagined(arrays["codes"], arrays["masses"], outcomes, arrays["cell"])


def best_imagined(imagined: Imagined, reward: Reward, steps: int) -> tuple[np.ndarray, np.ndarray]:
    """Returns for every seed the code expected to return most in an episode, [seeds, code], and that return [seeds].

    Raises:
      UsageError: the reward of some outcome in the replay is not a finite number.
    """
    expected = steps * imagined.means(score_outcomes(reward, imagined.outcomes))
    return imagined.codes[expected.argmax(axis=1)], expected.max(axis=1)


def find_replay(trained: Trained, seed: int) -> tuple[Replay, int]:
    """Returns transitions, each leaf [seeds, tasks, n, …], and the environment steps taken now to play them.

    They are the run's replay. Where there is none, as for an agent that ships, episodes under the training tasks' LTEs
    are played with exploration.

    Raises:
      RunError: a checkpoint cannot be read, or the episodes do not fit in memory.
    """
    if (replay := read_replay(trained)) is not None:
        return replay, 0
    program, family, tasks = trained.program, trained.program.family, trained.program.tasks
    envs, steps = -(-EPISODES // len(tasks)), family.episode_length
    extra = 2 * family.observation_size
    check_rollouts(program, program.config.seeds * len(tasks) * envs, steps, extra)

    def of_seed(policy: Params, key: jax.Array) -> Replay:
        key_start, key_noise = jax.random.split(key)
        env, noise = BatchedEnv(family), jax.random.normal(key_noise, (steps, len(tasks), envs, family.action_size))
        act = act_with(program.agent, policy, program.agent.codes(policy))
        _, played = rollout(env, act, env.start(key_start, tasks.params, envs), noise, lambda step: step)
        item = jax.tree.map(lambda leaf: leaf[0, 0, 0], played)
        like = Experience(item.obs, item.action, item.next_obs, item.outcome, item.terminated)
        return rings.add(rings.init(like, len(tasks), steps * envs), played)

    replay = for_each_seed(trained, of_seed, seed)
    return replay, program.config.seeds * len(tasks) * envs * steps


def _drawn(replay: Replay, seed: int) -> Experience:
    """Draws transitions of a replay at random, as many for every seed, each leaf [seeds, n, …]."""
    rng, capacity = np.random.default_rng(seed), replay.rings.terminated.shape[2]
    held = np.arange(capacity) < np.minimum(replay.added, capacity)[..., None]  # [seeds, tasks, capacity]
    slots = [np.flatnonzero(of_seed) for of_seed in held]
    count = min(MOST, *map(len, slots))
    chosen = [np.sort(rng.choice(of_seed, count, replace=False)) for of_seed in slots]

    def pick(leaf: np.ndarray) -> np.ndarray:
        flat = np.asarray(leaf).reshape(len(leaf), -1, *leaf.shape[3:])
        return np.stack([row[places] for row, places in zip(flat, chosen, strict=True)])

    picked: Experience = jax.tree.map(pick, replay.rings)
    return picked


def _write(trained: Trained, imagined: Imagined) -> None:
    arrays = {f"outcome.{name}": np.asarray(value, np.float32) for name, value in imagined.outcomes.items()}
    arrays |= {"codes": imagined.codes, "masses": np.asarray(imagined.masses), "cell": imagined.cell}
    write_kept(trained.directory / FILE, arrays, trained, FORMAT)


def _describe(trained: Trained, at_trained: Imagined, losses: np.ndarray) -> list[dict[str, Any]]:
    """Describes for each seed the loss, and the outcomes imagined under the training tasks' LTEs."""
    program = trained.program
    means = {name: at_trained.means(values) for name, values in at_trained.outcomes.items()}  # each [seeds, tasks]
    every = max(1, losses.shape[1] // CURVE)
    curves = [np.round([part.mean() for part in np.split(row, range(every, len(row), every))], 4) for row in losses]
    return [
        {
            "seed": program.config.seed + index,
            "loss": curves[index].tolist(),
            "trained": [
                {
                    "name": task.name,
                    "target": task.target,
                    "imagined": {name: round(float(value[index, row]), 4) for name, value in means.items()},
                }
                for row, task in enumerate(program.tasks.tasks)
            ],
        }
        for index in range(program.config.seeds)
    ]
