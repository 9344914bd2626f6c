"""Trajectories of the robot under given codes, pose by pose, for films, strips and contacts."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np

from ear_jax.agents.networks import Params
from ear_jax.envs.batched_env import BatchedEnv, EnvState, Transition
from ear_jax.learning.rollout import act_with, rollout
from ear_jax.process.runtime import compiler_options
from ear_jax.runs.rollouts import check_rollouts
from ear_jax.runs.training import Program
from ear_jax.tasks import any_task

KEPT = 4  # compiled functions, of programs and numbers of steps


@dataclass(frozen=True)
class Trajectory:
    """One roll-out, up to its last step or to the robot's failure."""

    qpos: np.ndarray  # [steps + 1, nq], one environment step apart
    fell: bool
    outcomes: dict[str, np.ndarray]  # [steps]
    achieved: float  # the commanded quantity, measured as in an evaluation


class PoseEnv(BatchedEnv):
    """A batch of environments without a time limit, whose outcomes include the pose before the step as `qpos`."""

    def step(self, env_states: EnvState, action: jax.Array) -> tuple[EnvState, Transition]:
        """Steps the batch; `action` is [rows, envs, act]."""
        env_states = replace(env_states, steps=jnp.zeros_like(env_states.steps))
        after, transition = super().step(env_states, action)
        qpos = env_states.state.pipeline_state.qpos
        return after, replace(transition, outcome={**transition.outcome, "qpos": qpos})


def follow(program: Program, policy: Params, codes: jax.Array, steps: int, key: jax.Array) -> list[Trajectory]:
    """Plays one episode under each code, without exploration and all from the same start.

    Args:
      program, policy: one seed's trained policy.
      codes: [rows, code].
      steps: environment steps; the family's time limit does not apply.
      key: seeds the start.

    Raises:
      RunError: the steps do not fit in memory.
    """
    check_rollouts(program, len(codes), steps + 1, program.family.model.nq)
    outcomes, over = jax.device_get(_compiled(program, steps)(policy, codes, key))
    return [
        until_over(program, {name: value[:, row, 0] for name, value in outcomes.items()}, over[:, row, 0])
        for row in range(len(codes))
    ]


@functools.lru_cache(maxsize=KEPT)
def _compiled(program: Program, steps: int) -> Callable[..., tuple[dict[str, jax.Array], jax.Array]]:
    """Returns a function that plays codes [rows, code] with one seed's policy; the next seed has it compiled."""
    family, env = program.family, PoseEnv(program.family, resets=False)

    def play(policy: Params, codes: jax.Array, key: jax.Array) -> tuple[dict[str, jax.Array], jax.Array]:
        begun = env.start(key, any_task(program.tasks.params), 1)
        env_states = jax.tree.map(lambda leaf: jnp.repeat(leaf, len(codes), 0), begun)
        still = jnp.zeros((steps + 1, len(codes), 1, family.action_size))  # one more, for the pose before it
        act = act_with(program.agent, policy, codes)
        played: tuple[dict[str, jax.Array], jax.Array] = rollout(env, act, env_states, still, outcome_and_over)[1]
        return played

    return jax.jit(play, compiler_options=compiler_options())


def outcome_and_over(step: Transition) -> tuple[dict[str, jax.Array], jax.Array]:
    """Selects from steps what `until_over` needs."""
    return step.outcome, step.failed


def until_over(program: Program, outcomes: dict[str, np.ndarray], over: np.ndarray) -> Trajectory:
    """Cuts a roll-out's poses and outcomes at its first failure.

    Args:
      program: its family tells what was achieved.
      outcomes: by name, each [steps + 1, …], with the poses before the steps as `qpos`.
      over: bool [steps + 1], which steps end an episode.
    """
    fell = bool(over[:-1].any())
    last = int(over.argmax()) if fell else len(over) - 1
    qpos = outcomes["qpos"][: last + 1]
    outcomes = {name: values[: max(last, 1)] for name, values in outcomes.items() if name != "qpos"}
    # The means of an evaluation, but for the step that failed: over the second half of the episode, and over all of it.
    late = {name: values[len(values) // 2 :].mean() for name, values in outcomes.items()}
    whole = {name: values.mean() for name, values in outcomes.items()}
    return Trajectory(qpos, fell, outcomes, float(program.family.achieved(late, whole)))
