"""PPO: updates of a trained policy from fresh whole episodes of all tasks (Schulman et al. 2017, arXiv 1707.06347).

What counts is what episodes return; no critic stands in between. Actions are drawn with less noise than SAC's, so that
what improves is close to what the policy does without any.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import optax
from flax import struct

from ear_jax.agents import Agent
from ear_jax.agents.networks import Params
from ear_jax.agents.tanh_gaussian import Gaussian
from ear_jax.envs.batched_env import BatchedEnv, Transition
from ear_jax.envs.family import Family, Outcome
from ear_jax.learning.advantage import generalised_advantages, mean_valid, standardised
from ear_jax.learning.rollout import act_with, first_episode, rollout, score
from ear_jax.learning.value import Value, make_value
from ear_jax.tasks import TaskParams, task_count

CLIP = 0.2  # ε of the objective
VALUE_LR = 1e-3
LOG_STD_WEIGHT = 0.01  # of keeping log σ, which no return judges
LR_RANGE = (1e-6, 1e-3)


@dataclass(frozen=True)
class Ppo:
    """Settings of an iteration."""

    episodes: int = 80  # shared evenly by the tasks
    passes: int = 3  # over the iteration's steps
    batch: int = 2000  # steps a gradient step
    discount: float = 0.995
    gae_lambda: float = 0.95
    noise: float = 0.5  # factor on the policy's σ
    least_noise: float = 0.1  # σ is at least this
    divergence: float = 0.03  # KL by which an iteration should change the policy; the step size follows it
    lr: float = 2e-4  # the first step size


@struct.dataclass
class PpoState:
    """A policy that is being improved, and what the updates need beside it."""

    policy: Params
    optimiser: Any
    value: Params
    value_optimiser: Any
    lr: jax.Array  # the policy's step size
    scale: jax.Array  # [tasks], mean size of a reward in the first iteration; 0 before


@struct.dataclass
class Steps:
    """Steps of whole episodes, each leaf [steps, tasks, episodes, …]."""

    obs: jax.Array  # 0 where not valid
    task: jax.Array  # int32
    time: jax.Array  # int32, steps since the episode began
    behaviour: Gaussian  # the policy's distribution, before the noise is changed
    raw: jax.Array  # actions before tanh
    valid: jax.Array  # bool, False past an episode's end


@struct.dataclass
class Lesson:
    """Steps and what they showed."""

    steps: Steps
    advantage: jax.Array  # of each task mean 0 and spread 1
    target: jax.Array  # of the value


@dataclass(frozen=True)
class PpoLearner:
    """Improves one agent's policy on all tasks of a family; codes stay as they are."""

    agent: Agent
    family: Family
    tasks: TaskParams  # each leaf [tasks]
    settings: Ppo

    @property
    def episodes(self) -> int:
        """The episodes of each task in an iteration."""
        return -(-self.settings.episodes // self._value.tasks)

    def init(self, policy: Params, key: jax.Array) -> PpoState:
        """Returns the state of a policy whose value is not known yet."""
        value = self._value.init(key)
        optimisers = _adam().init(policy["networks"]), _value_adam().init(value)
        return PpoState(
            policy, optimisers[0], value, optimisers[1], jnp.float32(self.settings.lr), jnp.zeros(self._value.tasks)
        )

    def improve(self, state: PpoState, divergence: jax.Array, key: jax.Array) -> tuple[PpoState, dict[str, jax.Array]]:
        """Makes one iteration: plays episodes and learns from them.

        Args:
          state: the policy and what belongs to it.
          divergence: the KL by which to change the policy; with 0 only the value learns.
          key: of starts, noise and batches.

        Returns:
          The new state, and metrics: `returns` [tasks] of the episodes, with noise, and the `divergence` and step size
          `lr` of the iteration.
        """
        key_play, key_learn = jax.random.split(key)
        codes = self.agent.codes(state.policy)
        state, lesson, returns = self.play(state, codes, key_play)
        items = jax.tree.map(lambda leaf: leaf.reshape(-1, *leaf.shape[3:]), lesson)
        rate = jnp.where(divergence > 0, state.lr, 0.0)
        count, size = batches(len(items.target), self.settings.batch)

        def learn(state: PpoState, rows: jax.Array) -> tuple[PpoState, jax.Array]:
            return self.learn(state, codes, jax.tree.map(lambda leaf: leaf[rows], items), rate)

        def one_pass(state: PpoState, key: jax.Array) -> tuple[PpoState, jax.Array]:
            rows = jax.random.permutation(key, len(items.target))[: count * size]
            return jax.lax.scan(learn, state, rows.reshape(count, size))

        state, changed = jax.lax.scan(one_pass, state, jax.random.split(key_learn, self.settings.passes))
        moved = changed[-1].mean()
        lr = jnp.where(divergence > 0, followed(state.lr, moved, divergence), state.lr)
        return replace(state, lr=lr), {"returns": returns, "divergence": moved, "lr": rate}

    def play(self, state: PpoState, codes: jax.Array, key: jax.Array) -> tuple[PpoState, Lesson, jax.Array]:
        """Plays whole episodes under each task's code [tasks, code]; also gives their mean returns [tasks].

        The first episodes also set the scale of each task's rewards.
        """
        family, agent = self.family, self.agent
        key_start, key_noise = jax.random.split(key)
        shape = (family.episode_length, len(codes), self.episodes)
        noise = jax.random.normal(key_noise, (*shape, family.action_size))
        act = act_with(replace(agent, distribution=self._drawn_from), state.policy, codes)
        env = BatchedEnv(family, resets=False)
        begun = env.start(key_start, self.tasks, self.episodes)
        _, (obs, outcome, over, finite) = rollout(env, act, begun, noise, _record)
        valid = first_episode(over) & finite
        obs = jnp.where(valid[..., None], obs, 0.0)  # what is not finite would spoil gradients even where masked
        reward = jnp.where(valid, score(family, outcome, self.tasks, axis=1), 0.0)
        time, task, _ = jnp.indices(shape)
        of_task = jax.vmap(partial(agent.distribution, state.policy), (None, 0))
        behaviour = jax.vmap(jax.vmap(of_task), (None, 0))(codes, obs)
        raw = behaviour.mean + jnp.exp(self.narrowed(behaviour).log_std) * noise
        steps = Steps(obs, task, time, behaviour, raw, valid)
        size = jnp.sum(jnp.abs(reward), axis=(0, 2)) / jnp.maximum(jnp.sum(valid, axis=(0, 2)), 1) + 1e-6
        state = replace(state, scale=jnp.where(state.scale > 0, state.scale, size))
        return state, self._lesson(state, steps, reward), jnp.sum(reward, axis=0).mean(axis=-1)

    def _lesson(self, state: PpoState, steps: Steps, reward: jax.Array) -> Lesson:
        value = jnp.where(steps.valid, self.values(state, state.value, steps), 0.0)
        advantage = generalised_advantages(reward, value, steps.valid, self.settings.discount, self.settings.gae_lambda)
        return Lesson(steps, jax.vmap(standardised, 1, 1)(advantage, steps.valid), advantage + value)

    def values(self, state: PpoState, value: Params, steps: Steps) -> jax.Array:
        """Returns the values of steps, shaped as `steps.time`, given the value's parameters."""
        shape = steps.time.shape
        obs = steps.obs.reshape(-1, steps.obs.shape[-1])

        def of_step(obs: jax.Array, task: jax.Array, time: jax.Array) -> jax.Array:
            seen, seen_task = self.agent.canonical(obs, task)
            return state.scale[task] * self._value(value, state.policy["standardiser"](seen), seen_task, time)

        return jax.vmap(of_step)(obs, steps.task.reshape(-1), steps.time.reshape(-1)).reshape(shape)

    def learn(self, state: PpoState, codes: jax.Array, lesson: Lesson, rate: jax.Array) -> tuple[PpoState, jax.Array]:
        """Takes a gradient step of policy and value on a batch, each leaf [batch, …]; also gives the divergence."""
        steps, policy = lesson.steps, state.policy

        def policy_loss(networks: Params) -> tuple[jax.Array, jax.Array]:
            new = jax.vmap(self.agent.distribution, (None, 0, 0))(
                {**policy, "networks": networks}, codes[steps.task], steps.obs
            )
            loss, divergence = jax.vmap(self.surrogate)(new, steps.behaviour, steps.raw, lesson.advantage)
            return mean_valid(loss, steps.valid), mean_valid(divergence, steps.valid)

        def value_loss(value: Params) -> jax.Array:
            wrong = (self.values(state, value, steps) - lesson.target) / state.scale[steps.task]
            return mean_valid((wrong / self._value.horizon(jnp.int32(0))) ** 2, steps.valid)

        grad, divergence = jax.grad(policy_loss, has_aux=True)(policy["networks"])
        change, optimiser = _adam().update(grad, state.optimiser)
        networks = jax.tree.map(lambda old, step: old - rate * step, policy["networks"], change)
        change, value_optimiser = _value_adam().update(jax.grad(value_loss)(state.value), state.value_optimiser)
        value = optax.apply_updates(state.value, change)
        policy = {**policy, "networks": networks}
        state = replace(state, policy=policy, optimiser=optimiser, value=value, value_optimiser=value_optimiser)
        return state, divergence

    def surrogate(
        self, new: Gaussian, old: Gaussian, raw: jax.Array, advantage: jax.Array
    ) -> tuple[jax.Array, jax.Array]:
        """Returns a step's clipped loss, given its action [act] before tanh, and the divergence of the means."""
        std = jnp.exp(self.narrowed(old).log_std)
        ratio = jnp.exp(0.5 * jnp.sum(((raw - old.mean) / std) ** 2 - ((raw - new.mean) / std) ** 2))
        gain = jnp.minimum(ratio * advantage, jnp.clip(ratio, 1 - CLIP, 1 + CLIP) * advantage)
        kept = LOG_STD_WEIGHT * jnp.mean((new.log_std - old.log_std) ** 2)
        return kept - gain, 0.5 * jnp.sum(((new.mean - old.mean) / std) ** 2)

    def narrowed(self, distribution: Gaussian) -> Gaussian:
        """Returns the distribution that actions are drawn from; its σ is a constant to the updates."""
        std = jnp.maximum(self.settings.noise * jnp.exp(distribution.log_std), self.settings.least_noise)
        return Gaussian(distribution.mean, jnp.log(std))

    def _drawn_from(self, policy: Params, code: jax.Array, obs: jax.Array) -> Gaussian:
        return self.narrowed(self.agent.distribution(policy, code, obs))

    @property
    def _value(self) -> Value:
        family = self.family
        return make_value(
            family.observation_size, task_count(self.tasks), family.episode_length, self.settings.discount
        )


def followed(lr: jax.Array, moved: jax.Array, wanted: jax.Array) -> jax.Array:
    """Returns the next step size: smaller above 1.5 times the wanted divergence, larger below wanted / 1.5."""
    lr = jnp.where(moved > 1.5 * wanted, lr / 1.5, jnp.where(moved < wanted / 1.5, lr * 1.5, lr))
    return jnp.clip(lr, *LR_RANGE)


def _record(step: Transition) -> tuple[jax.Array, Outcome, jax.Array, jax.Array]:
    return step.obs, step.outcome, step.failed, step.valid


def batches(items: int, size: int) -> tuple[int, int]:
    """Returns the number of batches of a pass, and their size."""
    size = min(items, size)
    return items // size, size


def _adam() -> optax.GradientTransformation:
    """Returns Adam's direction; the step size follows the divergence."""
    return optax.chain(optax.clip_by_global_norm(1.0), optax.scale_by_adam(eps=1e-5))


def _value_adam() -> optax.GradientTransformation:
    return optax.adam(VALUE_LR)
