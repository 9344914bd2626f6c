"""The successor measure of outcomes: how often, under a code, each kind of outcome will occur from a state on.

Kinds are cells of a partition of the outcomes in a replay. The measure m(s, a, z) is a distribution over cells: of the
outcome at a time that is geometric in γ, from state s and action a on, acting under code z. It obeys

    m(s, a, z) = (1 − γ) 1[cell of the outcome] + γ m(s′, π(s′, z), z)

and is learnt by the cross-entropy of a target network's right-hand side, as a categorical critic is. The value of a
reward is its mean over the measure. (Blier et al. 2021, arXiv 2101.07123; Touati and Ollivier 2021, arXiv 2103.07945.)
A measure looks only 1 / (1 − γ) steps ahead, the fewer the sooner it is learnt. An episode is a chain of such jumps.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax
from flax import struct

from ear_jax.agents import Agent, categorical
from ear_jax.agents.networks import Network, Params, Standardiser, mlp
from ear_jax.agents.tanh_gaussian import squash
from ear_jax.config import NetworkConfig
from ear_jax.learning.replay import Experience


@dataclass(frozen=True)
class MeasureConfig:
    """Settings of learning a measure."""

    cells: int = 256  # kinds of outcome that are told apart
    updates: int = 6000
    batch_size: int = 256  # transitions an update
    width: int = 192  # of the network's two hidden layers
    discount: float = 0.95  # a jump goes 1 / (1 − discount) steps ahead on average
    lr: float = 1e-3  # falls to a tenth, linearly
    target_rate: float = 0.05  # share by which the target network follows in an update


@struct.dataclass
class MeasureState:
    """The part of learning that an update changes."""

    params: Params
    target: Params
    optimiser: Any


@dataclass(frozen=True)
class Measure:
    """The network of a measure, and the agent whose policy it is of."""

    agent: Agent
    network: Network  # [obs + act + code] → logits [cells + 1]; the last is of steps after a failure
    config: MeasureConfig

    def of_start(self, params: Params, policy: Params, code: jax.Array, obs: jax.Array) -> jax.Array:
        """Returns the distribution [cells + 1] from a state on, acting under a code without exploration."""
        distribution = self.agent.distribution(policy, code, obs)
        action = squash(distribution, jnp.zeros_like(distribution.mean))
        return jax.nn.softmax(self.logits(params, code, obs, action))

    def logits(self, params: Params, code: jax.Array, obs: jax.Array, action: jax.Array) -> jax.Array:
        """Returns the logits [cells + 1] of one state, action and code."""
        obs = params["standardiser"](obs)
        return self.network.apply(params["network"], jnp.concatenate([obs, action, 2 * code]))


def make_measure(agent: Agent, obs_size: int, action_size: int, config: MeasureConfig) -> Measure:
    """Builds the measure of an agent's policies."""
    network = NetworkConfig(initialiser="fan_in", matmul="float32")
    size, widths = obs_size + action_size + agent.code_size, (config.width, config.width)
    return Measure(agent, mlp(size, widths, config.cells + 1, network, layer_norm=True), config)


def learn_measure(
    measure: Measure, policy: Params, replay: Experience, cell: jax.Array, key: jax.Array
) -> tuple[Params, jax.Array]:
    """Learns the measure of one policy from transitions, which may be of any other policy.

    Codes are drawn afresh for every item of a batch, as `draw_codes` does.

    Args:
      measure: the network and its settings.
      policy: the policy's parameters.
      replay: transitions, each leaf [n, …].
      cell: the cell of each transition's outcome, int [n].
      key: seeds everything.

    Returns:
      The parameters, and the loss of each update.
    """
    config, table = measure.config, measure.agent.codes(policy)
    optimiser = optax.adam(optax.linear_schedule(config.lr, 0.1 * config.lr, config.updates))
    over = jax.nn.one_hot(config.cells, config.cells + 1)

    def loss(params: Params, target: Params, index: jax.Array, code: jax.Array, noise: jax.Array) -> jax.Array:
        item = jax.tree.map(lambda leaf: leaf[index], replay)
        action = squash(measure.agent.distribution(policy, code, item.next_obs), noise)
        later = jax.nn.softmax(measure.logits(target, code, item.next_obs, action))
        now = jax.nn.one_hot(cell[index], config.cells + 1)
        wanted = (1 - config.discount) * now + config.discount * jnp.where(item.terminated, over, later)
        return categorical.loss(measure.logits(params, code, item.obs, item.action), jax.lax.stop_gradient(wanted))

    def mean_loss(params: Params, *batch: Any) -> jax.Array:
        return jnp.mean(jax.vmap(loss, in_axes=(None, None, 0, 0, 0))(params, *batch))

    def update(state: MeasureState, key: jax.Array) -> tuple[MeasureState, jax.Array]:
        key_index, key_code, key_noise = jax.random.split(key, 3)
        index = jax.random.randint(key_index, (config.batch_size,), 0, len(cell))
        codes = draw_codes(measure.agent, table, key_code, config.batch_size)
        noise = jax.random.normal(key_noise, (config.batch_size, replay.action.shape[-1]))
        value, gradient = jax.value_and_grad(mean_loss)(state.params, state.target, index, codes, noise)
        change, optimised = optimiser.update(gradient, state.optimiser)
        params = optax.apply_updates(state.params, change)
        target = optax.incremental_update(params, state.target, config.target_rate)
        return MeasureState(params, target, optimised), value

    key_init, key_updates = jax.random.split(key)
    deviation = jnp.maximum(replay.obs.std(axis=0), 1e-2)
    params = {"standardiser": Standardiser(replay.obs.mean(axis=0), 1 / deviation)}
    params["network"] = measure.network.init(key_init)
    begun = MeasureState(params, params, optimiser.init(params))
    state, losses = jax.lax.scan(update, begun, jax.random.split(key_updates, config.updates))
    return state.params, losses


def late_in_episode(measure: Measure, first: jax.Array, later: jax.Array, cell: jax.Array, steps: int) -> jax.Array:
    """Returns how often each cell occurs in the second half of an episode under a code, as a share of steps, [cells].

    Each jump begins where the last one came to. Where that is, its cell tells: the states of the replay in which a
    transition with an outcome of that cell ended. After a failure there are no further outcomes. The first half is left
    out; with it, the codes that it chose for rewards returned less.

    Args:
      measure: whose discount tells how long a jump is.
      first: distributions from starts of episodes [starts, cells + 1].
      later: distributions from states of the replay [states, cells + 1].
      cell: the cell of the outcome on the way to each of these, int [states].
      steps: of the episode.
    """
    cells = measure.config.cells
    member = jax.nn.one_hot(cell, cells)
    count = member.sum(axis=0)[:, None]
    jumps = jnp.where(count > 0, member.T @ later / jnp.maximum(count, 1), later.mean(axis=0))[:, :-1]

    def jump(mass: jax.Array, _: None) -> tuple[jax.Array, jax.Array]:
        return mass @ jumps, mass

    length = max(1, round(steps * (1 - measure.config.discount)))
    masses: jax.Array = jax.lax.scan(jump, first.mean(axis=0)[:-1], None, length=length)[1]
    return masses[length // 2 :].mean(axis=0)


def draw_codes(agent: Agent, table: jax.Array, key: jax.Array, count: int) -> jax.Array:
    """Draws codes [count, code]: by turns from the whole sphere and from between two rows of a table [tasks, code]."""
    key_sphere, key_rows, key_share = jax.random.split(key, 3)
    anywhere = jax.random.normal(key_sphere, (count, agent.code_size))
    first, second = table[jax.random.randint(key_rows, (2, count), 0, len(table))]
    share = jax.random.uniform(key_share, (count, 1))
    between = share * first + (1 - share) * second
    return jax.vmap(agent.project)(jnp.where(jnp.arange(count)[:, None] % 2 == 0, anywhere, between))


def partition(outcomes: np.ndarray, cells: int, rounds: int = 10) -> np.ndarray:
    """Divides outcomes [n, k] into cells of alike ones by Lloyd's algorithm; returns the cell of each, int32 [n].

    The first centres are spread evenly over the outcomes, sorted by their columns.
    """
    points = outcomes / np.maximum(outcomes.std(axis=0), 1e-6)
    order = np.lexsort(points.T[::-1])
    centres = points[order[np.linspace(0, len(points) - 1, cells).astype(int)]]
    cell = _nearest(points, centres)
    for _ in range(rounds):
        sums = np.stack([np.bincount(cell, column, cells) for column in points.T], axis=1)
        counts = np.bincount(cell, minlength=cells)[:, None]
        centres = np.where(counts > 0, sums / np.maximum(counts, 1), centres)
        cell = _nearest(points, centres)
    return cell.astype(np.int32)


def _nearest(points: np.ndarray, centres: np.ndarray) -> np.ndarray:
    """Returns the index of the centre [cells, k] nearest to each point [n, k]."""
    half = (centres**2).sum(axis=1) / 2
    parts = np.array_split(points, max(1, len(points) // 4096))
    return np.concatenate([np.argmin(half - part @ centres.T, axis=1) for part in parts])
