"""Model-agnostic meta-learning: parameters are changed so that one gradient step on a task's episodes goes far."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import optax
from flax import struct
from jax.flatten_util import ravel_pytree

from ear_jax.agents import Agent
from ear_jax.agents.networks import Params
from ear_jax.agents.tanh_gaussian import Gaussian
from ear_jax.config import Config
from ear_jax.envs.batched_env import BatchedEnv, EnvState, Transition
from ear_jax.envs.family import Family
from ear_jax.errors import UsageError
from ear_jax.learning import trust_region
from ear_jax.learning.advantage import advantages
from ear_jax.learning.rollout import act_with, first_episode, rollout
from ear_jax.tasks import TaskParams


@struct.dataclass
class Trial:
    """Episodes of one task, each of them its first steps from a random start, and how they were acted."""

    obs: jax.Array  # [steps, episodes, obs]
    raw: jax.Array  # [steps, episodes, act], actions before they were squashed
    behaviour: Gaussian  # which they were drawn from, each leaf [steps, episodes, act]
    advantage: jax.Array  # [steps, episodes]
    valid: jax.Array  # bool [steps, episodes]: the others lie after the episode's end


@struct.dataclass
class Trials:
    """What one update learns from, each leaf [tasks, …]."""

    before: Trial  # under the parameters that all tasks begin with
    after: Trial  # under each task's own, one step from there


@struct.dataclass
class MamlState:
    """All that gradients change."""

    policy: Params

    @property
    def norms(self) -> dict[str, jax.Array]:
        return {"policy_norm": optax.global_norm(self.policy)}


def surrogate(agent: Agent, policy: Params, code: jax.Array, trial: Trial) -> jax.Array:
    """−the mean of π/π_behaviour · advantage over a trial; its gradient where π is the behaviour is REINFORCE's."""

    def ratio(obs: jax.Array, raw: jax.Array, behaviour: Gaussian) -> jax.Array:
        return jnp.exp(_log_density(agent.distribution(policy, code, obs), raw) - _log_density(behaviour, raw))

    better = jax.vmap(jax.vmap(ratio))(trial.obs, trial.raw, trial.behaviour) * trial.advantage
    return -_mean(better, trial.valid)


def divergence(agent: Agent, policy: Params, code: jax.Array, trial: Trial) -> jax.Array:
    """KL divergence of the policy from what a trial was acted by, the mean over its steps."""

    def of_step(obs: jax.Array, behaviour: Gaussian) -> jax.Array:
        now = agent.distribution(policy, code, obs)
        spread = jnp.exp(2 * (behaviour.log_std - now.log_std))
        apart = (behaviour.mean - now.mean) ** 2 * jnp.exp(-2 * now.log_std)
        return jnp.sum(now.log_std - behaviour.log_std + 0.5 * (spread + apart - 1))

    return _mean(jax.vmap(jax.vmap(of_step))(trial.obs, trial.behaviour), trial.valid)


@dataclass(frozen=True)
class MamlLearner:
    """Trains an agent whose codes are tuned; it collects and learns as `Learner` does, from one epoch's steps alone."""

    agent: Agent
    family: Family
    tasks: TaskParams  # each leaf [tasks]
    config: Config

    on_policy: ClassVar[bool] = True

    @staticmethod
    def check(config: Config, tasks: int) -> None:
        """Raises UsageError for an epoch that is not one update from steps before and after tuning."""
        if config.sac.updates != 1:
            raise UsageError(f"--sac.updates {config.sac.updates} is too many; maml makes one update an epoch")
        if config.collect.steps % 2:
            raise UsageError(
                f"--collect.steps {config.collect.steps} cannot be halved; maml needs as many before its step"
            )

    def init(self, key: jax.Array) -> MamlState:
        return MamlState(self.agent.init_policy(key))

    def memory(self, env_states: EnvState) -> Trials:
        """Room for an epoch's trials of such environments [tasks, envs]."""
        rows, episodes = env_states.steps.shape
        shape = (rows, self.config.collect.steps // 2, episodes)
        obs, act = jnp.zeros((*shape, self.family.observation_size)), jnp.zeros((*shape, self.family.action_size))
        empty = Trial(obs, act, Gaussian(act, act), jnp.zeros(shape), jnp.zeros(shape, bool))
        return Trials(empty, empty)

    def collect(
        self, state: MamlState, held: Trials, env_states: EnvState, key: jax.Array
    ) -> tuple[EnvState, Trials, dict[str, jax.Array]]:
        """Half an epoch's steps as all tasks begin, half after a step of each task's own; from fresh starts."""
        key_before, key_after = jax.random.split(key)
        origin = jnp.zeros_like(self.agent.codes(state.policy))
        before, returns_before, invalid_before = self.play(state.policy, origin, self.tasks, key_before)
        codes = self.tune(state.policy, origin, before)
        after, returns_after, invalid_after = self.play(state.policy, codes, self.tasks, key_after)
        metrics = {
            "invalid_steps": invalid_before + invalid_after,
            "return_before": jnp.mean(returns_before),
            "return_after": jnp.mean(returns_after),
        }
        return env_states, Trials(before, after), metrics

    def learn(self, state: MamlState, trials: Trials, key: jax.Array) -> tuple[MamlState, dict[str, jax.Array]]:
        """One step within a trust region around the tuned policies, through their tuning.

        Returns:
          The parameters then, with the codes that the same episodes tune them to, and what to watch: scalars, and
          `finite_updates` [tasks], whether each task's loss was finite.
        """
        policy = state.policy
        start, rebuild = ravel_pytree(policy["networks"])
        origin = jnp.zeros_like(self.agent.codes(policy))

        def moved(parameters: jax.Array) -> tuple[Params, jax.Array]:
            new = {**policy, "networks": rebuild(parameters)}
            return new, self.tune(new, origin, trials.before)

        def by_task(parameters: jax.Array) -> tuple[jax.Array, jax.Array]:
            new, codes = moved(parameters)
            losses, apart = (jax.vmap(partial(what, self.agent, new)) for what in (surrogate, divergence))
            return losses(codes, trials.after), apart(codes, trials.after)

        def measure(parameters: jax.Array) -> tuple[jax.Array, jax.Array]:
            return jax.tree.map(jnp.mean, by_task(parameters))

        end, metrics = trust_region.improve(measure, start, self.config.maml.max_divergence)
        new, codes = moved(end)
        finite = jnp.isfinite(by_task(start)[0]).astype(jnp.int32)
        return MamlState({**new, "codes": codes}), {**metrics, "finite_updates": finite}

    def tune(self, policy: Params, codes: jax.Array, trials: Trial) -> jax.Array:
        """Each task's code [tasks, code] after a gradient step on its own trial, each leaf [tasks, …]."""
        step = jax.vmap(jax.grad(partial(surrogate, self.agent, policy)))(codes, trials)
        return codes - self.config.maml.inner_lr * step

    def play(
        self, policy: Params, codes: jax.Array, tasks: TaskParams, key: jax.Array
    ) -> tuple[Trial, jax.Array, jax.Array]:
        """Tries codes [tasks, code] in the tasks given, drawing actions.

        Returns:
          Trials, each leaf [tasks, …]; their returns [tasks, episodes]; how many steps were not finite, a scalar.
        """
        family, collect = self.family, self.config.collect
        key_start, key_noise = jax.random.split(key)
        env_states = BatchedEnv(family).start(key_start, tasks, collect.envs)
        noise = jax.random.normal(key_noise, (collect.steps // 2, len(codes), collect.envs, family.action_size))
        _, played = rollout(BatchedEnv(family), act_with(self.agent, policy, codes), env_states, noise, _seen)

        def of_task(task: TaskParams, code: jax.Array, noise: jax.Array, played: Any) -> tuple[Trial, jax.Array]:
            obs, outcome, over, finite = played  # each [steps, episodes, …]
            valid = finite & first_episode(over)
            reward = jax.vmap(jax.vmap(family.reward, in_axes=(0, None)), in_axes=(0, None))(outcome, task)
            behaviour = jax.vmap(jax.vmap(lambda obs: self.agent.distribution(policy, code, obs)))(obs)
            raw = behaviour.mean + jnp.exp(behaviour.log_std) * noise
            better = advantages(obs, reward, valid, self.config.maml.discount)
            return Trial(obs, raw, behaviour, better, valid), jnp.sum(jnp.where(valid, reward, 0.0), axis=0)

        trials, returns = jax.vmap(of_task, in_axes=(0, 0, 1, 1))(tasks, codes, noise, played)
        return trials, returns, jnp.sum(~played[-1], dtype=jnp.float32)


def _seen(step: Transition) -> tuple[jax.Array, Any, jax.Array, jax.Array]:
    return step.obs, step.outcome, step.terminated | step.truncated | ~step.valid, step.valid


def _log_density(distribution: Gaussian, raw: jax.Array) -> jax.Array:
    """Of a raw action [act], up to a constant; how it is squashed makes no difference to a ratio."""
    return -jnp.sum(0.5 * ((raw - distribution.mean) * jnp.exp(-distribution.log_std)) ** 2 + distribution.log_std)


def _mean(values: jax.Array, valid: jax.Array) -> jax.Array:
    return jnp.sum(jnp.where(valid, values, 0.0)) / jnp.maximum(jnp.sum(valid), 1)
