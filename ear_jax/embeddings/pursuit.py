"""Way-points met with feedback: from where the robot is, at each step the LTE that leads on along the path.

This is pure pursuit: the robot heads for a point of the path some way ahead of its own place on it (Coulter,
"Implementation of the Pure Pursuit Path Tracking Algorithm", CMU-RI-TR-92-01, 1992). Two things are added, because a
robot on legs takes a while to turn. The next leg of the path begins before a way-point, by what the robot covers in
that while; and the heading is turned against velocity that does not lead to the point.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
from flax import struct

from ear_jax.agents import Agent
from ear_jax.embeddings.course import Course
from ear_jax.envs.batched_env import BatchedEnv, EnvState
from ear_jax.learning.rollout import Act, Record

HEADINGS = 64  # directions whose LTEs are looked up
AHEAD = 0.5  # seconds on the path from the robot to the point it heads for
LEAD = 0.3  # seconds before a way-point at which the next leg begins
AGAINST = 2.0  # weight of velocity that does not lead to the point, against which the heading is turned
RECENT = 0.5  # weight of the last step in the velocity, which a gait shakes


@struct.dataclass
class Runner:
    """State of a robot on its way."""

    place: jax.Array  # [2] metres from the start
    velocity: jax.Array  # [2] m/s, over the last steps
    leg: jax.Array  # int, of the path


@dataclass(frozen=True)
class Pursuit:
    """A path to follow, for robots of one policy."""

    agent: Agent
    course: Course
    ring: jax.Array  # [headings, code], codes that run at the course's speed in directions spaced evenly from x on
    dt: float  # seconds in a step

    def begin(self) -> Runner:
        return Runner(jnp.zeros(2), jnp.zeros(2), jnp.int32(0))

    def advance(self, runner: Runner, velocity: jax.Array) -> Runner:
        """Returns where a robot is after a step at a velocity [2]; the last leg does not end."""
        place = runner.place + self.dt * velocity
        velocity = RECENT * velocity + (1 - RECENT) * runner.velocity
        begin, along, length = self._leg(runner.leg)
        over = (place + LEAD * velocity - begin) @ along >= length
        return Runner(place, velocity, jnp.minimum(runner.leg + over, len(self.course.points) - 1))

    def direction(self, runner: Runner) -> jax.Array:
        """Returns the direction [2] to run in, of any length."""
        begin, along, length = self._leg(runner.leg)
        ahead = (runner.place - begin) @ along + AHEAD * self.course.speed
        towards = begin + jnp.minimum(ahead, length) * along - runner.place
        towards = towards / jnp.maximum(jnp.linalg.norm(towards), 1e-6)
        return towards + AGAINST * (towards - runner.velocity / self.course.speed)

    def code(self, direction: jax.Array) -> jax.Array:
        """Returns the code [code] that runs in a direction [2], a blend of the two of the ring beside it."""
        heading = len(self.ring) * (jnp.arctan2(direction[1], direction[0]) / (2 * jnp.pi) % 1)
        row = heading.astype(int) % len(self.ring)
        share = heading - jnp.floor(heading)
        return self.agent.project((1 - share) * self.ring[row] + share * self.ring[(row + 1) % len(self.ring)])

    def rollout(
        self, env: BatchedEnv, act: Act, env_states: EnvState, codes: jax.Array, record: Record
    ) -> tuple[EnvState, Any]:
        """Does what `learning.rollout.rollout` does with codes for noise, but chooses those of the later half.

        Args:
          env: the environments.
          act: acts under the codes of a step, [rows, envs, code].
          env_states: the environments' states, [rows, envs]. The later half of the envs follow the path.
          codes: of each step, [steps, rows, envs, code]; those of the later half are not read.
          record: as there; the outcomes include the code of the step, as `code`.
        """
        rows, envs = codes.shape[1:3]
        runners = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (rows, envs, *leaf.shape)), self.begin())
        steered = (jnp.arange(envs) >= envs // 2)[:, None]

        def choose(runner: Runner) -> jax.Array:
            return self.code(self.direction(runner))

        def step(state: tuple[EnvState, Runner], codes: jax.Array) -> tuple[tuple[EnvState, Runner], Any]:
            env_states, runners = state
            codes = jnp.where(steered, jax.vmap(jax.vmap(choose))(runners), codes)
            env_states, after = env.step(env_states, act(env_states.state.obs, codes))
            velocity = jnp.stack([after.outcome[name] for name in self.course.outcomes], axis=-1)
            runners = jax.vmap(jax.vmap(self.advance))(runners, velocity)
            return (env_states, runners), record(replace(after, outcome={**after.outcome, "code": codes}))

        (env_states, _), recorded = jax.lax.scan(step, (env_states, runners), codes)
        return env_states, recorded

    def _leg(self, leg: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
        """Returns where a leg of the path begins [2], its direction [2] and its length."""
        ends = jnp.asarray(self.course.ends, jnp.float32)
        way = ends[leg + 1] - ends[leg]
        length = jnp.linalg.norm(way)
        return ends[leg], way / length, length
