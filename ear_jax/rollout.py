"""The one roll-out: training, evaluation and everything that uses a trained policy step the grid through it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax

from ear_jax.agents import Agent
from ear_jax.grid import Cell, Grid, Transition
from ear_jax.networks import Params
from ear_jax.policy import squash

Act = Callable[[jax.Array, jax.Array], jax.Array]


def act_with(agent: Agent, policy: Params, codes: jax.Array) -> Act:
    """A roll-out's policy in which every row of the grid acts under its own code; codes [rows, code]."""

    def one(code: jax.Array, obs: jax.Array, noise: jax.Array) -> jax.Array:
        return squash(agent.distribution(policy, code, obs), noise)

    return lambda obs, noise: jax.vmap(jax.vmap(one, in_axes=(None, 0, 0)))(codes, obs, noise)


def rollout(
    grid: Grid, act: Act, cells: Cell, noise: jax.Array, record: Callable[[Transition], Any]
) -> tuple[Cell, Any]:
    """Steps the grid as often as there is noise.

    Args:
      grid: the environments.
      act: (obs [rows, envs, obs], noise [rows, envs, act]) → action; with zero noise it takes its most likely action.
      cells: where the environments stand, [rows, envs].
      noise: standard normal, [steps, rows, envs, act].
      record: what of each transition to keep. Keep little: every step's is stacked.

    Returns:
      Where the environments stand afterwards, and the record with leading axes [steps, rows, envs].
    """

    def step(cells: Cell, noise: jax.Array) -> tuple[Cell, Any]:
        cells, transition = grid.step(cells, act(cells.state.obs, noise))
        return cells, record(transition)

    return jax.lax.scan(step, cells, noise)
