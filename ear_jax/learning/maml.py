"""MAML: updates of shared parameters, so that one gradient step on a task's episodes gives a good policy."""

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
from ear_jax.learning.advantage import advantages, mean_valid
from ear_jax.learning.batch import draw_tasks, drawn_tasks
from ear_jax.learning.rollout import act_with, first_episode, rollout
from ear_jax.tasks import TaskParams, task_count


@struct.dataclass
class Trial:
    """Episodes of one task from random starts, and the distributions their actions were drawn from."""

    obs: jax.Array  # [steps, episodes, obs], 0 where not valid
    raw: jax.Array  # [steps, episodes, act], actions before tanh; the name stays, checkpoints store leaves by it
    behaviour: Gaussian  # the distributions of `raw`, each leaf [steps, episodes, act]
    advantage: jax.Array  # [steps, episodes]
    valid: jax.Array  # bool [steps, episodes], False after an episode's end


@struct.dataclass
class Trials:
    """The episodes of one update, each leaf [drawn, …]."""

    tasks: jax.Array  # int32: the tasks that they are of
    before: Trial  # under the shared parameters
    after: Trial  # under each task's adapted parameters


@struct.dataclass
class MamlState:
    """The parameters that updates change."""

    policy: Params

    @property
    def norms(self) -> dict[str, jax.Array]:
        """The global norm of the policy, by name."""
        return {"policy_norm": optax.global_norm(self.policy)}


def surrogate(agent: Agent, policy: Params, code: jax.Array, trial: Trial) -> jax.Array:
    """Returns −mean(π/π_behaviour · advantage) over a trial; at π = π_behaviour its gradient is REINFORCE's."""

    def ratio(obs: jax.Array, raw: jax.Array, behaviour: Gaussian) -> jax.Array:
        return jnp.exp(_log_density(agent.distribution(policy, code, obs), raw) - _log_density(behaviour, raw))

    weighted = jax.vmap(jax.vmap(ratio))(trial.obs, trial.raw, trial.behaviour) * trial.advantage
    return -mean_valid(weighted, trial.valid)


def divergence(agent: Agent, policy: Params, code: jax.Array, trial: Trial) -> jax.Array:
    """Returns KL(behaviour ‖ policy), the mean over a trial's valid steps."""

    def step_divergence(obs: jax.Array, behaviour: Gaussian) -> jax.Array:
        new = agent.distribution(policy, code, obs)
        variance_ratio = jnp.exp(2 * (behaviour.log_std - new.log_std))
        shift = (behaviour.mean - new.mean) ** 2 * jnp.exp(-2 * new.log_std)
        return jnp.sum(new.log_std - behaviour.log_std + 0.5 * (variance_ratio + shift - 1))

    return mean_valid(jax.vmap(jax.vmap(step_divergence))(trial.obs, trial.behaviour), trial.valid)


def features(agent: Agent, policy: Params, code: jax.Array, trial: Trial) -> jax.Array:
    """Returns a policy's distributions in units in which they differ from the behaviour's as `divergence` says.

    To second order, the divergence is half the squared distance.

    Returns:
      Means in units of the behaviour's σ, and √2 log σ, [steps, episodes, 2 act], each step weighted equally.
    """

    def of_step(obs: jax.Array, behaviour: Gaussian) -> jax.Array:
        new = agent.distribution(policy, code, obs)
        return jnp.concatenate([new.mean * jnp.exp(-behaviour.log_std), jnp.sqrt(2.0) * new.log_std])

    weight = jnp.sqrt(trial.valid / jnp.maximum(jnp.sum(trial.valid), 1))
    return weight[..., None] * jax.vmap(jax.vmap(of_step))(trial.obs, trial.behaviour)


@dataclass(frozen=True)
class MamlLearner:
    """Trains an agent whose codes are tuned (`Learner`), on-policy: an update learns from one epoch's episodes."""

    agent: Agent
    family: Family
    tasks: TaskParams  # each leaf [tasks]
    config: Config

    on_policy: ClassVar[bool] = True

    @staticmethod
    def check(config: Config, tasks: int) -> None:
        """Raises UsageError unless an epoch is one update and its steps can be halved."""
        if config.sac.updates != 1:
            raise UsageError(f"--sac.updates {config.sac.updates} is too many; maml makes one update per epoch")
        if config.collect.steps % 2:
            raise UsageError(
                f"--collect.steps {config.collect.steps} is odd; maml takes half of them before its gradient step"
            )

    def init(self, key: jax.Array) -> MamlState:
        return MamlState(self.agent.init_policy(key))

    def memory(self, env_states: EnvState) -> Trials:
        """Returns empty trials for environments [tasks, envs]."""
        rows, episodes = env_states.steps.shape
        drawn = drawn_tasks(self.config, rows)
        shape = (drawn, self.config.collect.steps // 2, episodes)
        obs, act = jnp.zeros((*shape, self.family.observation_size)), jnp.zeros((*shape, self.family.action_size))
        empty = Trial(obs, act, Gaussian(act, act), jnp.zeros(shape), jnp.zeros(shape, bool))
        return Trials(jnp.arange(drawn), empty, empty)

    def collect(
        self, state: MamlState, memory: Trials, env_states: EnvState, key: jax.Array
    ) -> tuple[EnvState, Trials, dict[str, jax.Array]]:
        """Plays half an epoch's steps with the shared parameters and half after adapting to each task drawn."""
        key_before, key_after = jax.random.split(key)
        rows = draw_tasks(self.config, task_count(self.tasks), jax.random.fold_in(key, 2))
        tasks = jax.tree.map(lambda leaf: leaf[rows], self.tasks)
        origin = jnp.zeros((len(rows), self.agent.code_size))
        before, returns_before, invalid_before = self.play(state.policy, origin, tasks, key_before)
        codes = self.tune(state.policy, origin, before)
        after, returns_after, invalid_after = self.play(state.policy, codes, tasks, key_after)
        metrics = {
            "invalid_steps": invalid_before + invalid_after,
            "return_before": jnp.mean(returns_before),
            "return_after": jnp.mean(returns_after),
        }
        return env_states, Trials(rows, before, after), metrics

    def learn(self, state: MamlState, trials: Trials, key: jax.Array) -> tuple[MamlState, dict[str, jax.Array]]:
        """Takes one trust-region step of the adapted policies' loss, differentiated through their adaptation.

        Returns:
          The new state, where the codes of the tasks drawn are adapted on the same episodes, and metrics: scalars, and
          `finite_updates` [tasks], 0 if a task's loss was not finite.
        """
        policy, rows = state.policy, trials.tasks
        start, rebuild = ravel_pytree(policy["networks"])
        origin = jnp.zeros((len(rows), self.agent.code_size))

        def adapt(parameters: jax.Array) -> tuple[Params, jax.Array]:
            new = {**policy, "networks": rebuild(parameters)}
            return new, self.tune(new, origin, trials.before)

        def by_task(parameters: jax.Array) -> tuple[jax.Array, jax.Array]:
            new, codes = adapt(parameters)
            losses, divergences = (jax.vmap(partial(measure, self.agent, new)) for measure in (surrogate, divergence))
            return losses(codes, trials.after), divergences(codes, trials.after)

        def over_tasks(parameters: jax.Array) -> tuple[jax.Array, jax.Array]:
            return jax.tree.map(jnp.mean, by_task(parameters))

        def features_over_tasks(parameters: jax.Array) -> jax.Array:
            new, codes = adapt(parameters)
            each = jax.vmap(partial(features, self.agent, new))(codes, trials.after)
            return each / jnp.sqrt(len(each))  # as the divergence is the mean over tasks

        limit = self.config.maml.max_divergence
        end, metrics = trust_region.improve(over_tasks, features_over_tasks, start, limit)
        new, codes = adapt(end)
        finite = jnp.isfinite(by_task(start)[0]).astype(jnp.int32)
        table = self.agent.codes(policy)
        state = MamlState({**new, "codes": table.at[rows].set(codes)})
        return state, {**metrics, "finite_updates": jnp.ones(len(table), jnp.int32).at[rows].set(finite)}

    def tune(self, policy: Params, codes: jax.Array, trials: Trial) -> jax.Array:
        """Takes a gradient step of each task's code [tasks, code] on its own trial, each leaf [tasks, …]."""
        grads = jax.vmap(jax.grad(partial(surrogate, self.agent, policy)))(codes, trials)
        return codes - self.config.maml.inner_lr * grads

    def play(
        self, policy: Params, codes: jax.Array, tasks: TaskParams, key: jax.Array
    ) -> tuple[Trial, jax.Array, jax.Array]:
        """Plays episodes under codes [tasks, code] in the given tasks, with sampled actions.

        Returns:
          Trials, each leaf [tasks, …]; their returns [tasks, episodes]; the number of invalid steps, a scalar.
        """
        family, collect = self.family, self.config.collect
        key_start, key_noise = jax.random.split(key)
        env = BatchedEnv(family, resets=False)
        env_states = env.start(key_start, tasks, collect.envs)
        noise = jax.random.normal(key_noise, (collect.steps // 2, len(codes), collect.envs, family.action_size))
        _, played = rollout(env, act_with(self.agent, policy, codes), env_states, noise, _record)

        def to_trial(
            task: TaskParams, code: jax.Array, noise: jax.Array, played: Any
        ) -> tuple[Trial, jax.Array, jax.Array]:
            obs, outcome, ended, finite = played  # each [steps, episodes, …]
            playing = first_episode(ended)
            valid = finite & playing
            obs = jnp.where(valid[..., None], obs, 0.0)  # what is not finite would spoil gradients even where masked
            reward = jax.vmap(jax.vmap(family.reward, in_axes=(0, None)), in_axes=(0, None))(outcome, task)
            behaviour = jax.vmap(jax.vmap(lambda obs: self.agent.distribution(policy, code, obs)))(obs)
            raw = behaviour.mean + jnp.exp(behaviour.log_std) * noise
            advantage = advantages(obs, reward, valid, self.config.maml.discount, self.config.maml.gae_lambda)
            returns = jnp.sum(jnp.where(valid, reward, 0.0), axis=0)
            return Trial(obs, raw, behaviour, advantage, valid), returns, jnp.sum(playing & ~finite)

        trials, returns, invalid = jax.vmap(to_trial, in_axes=(0, 0, 1, 1))(tasks, codes, noise, played)
        return trials, returns, jnp.sum(invalid).astype(jnp.float32)


def _record(transition: Transition) -> tuple[jax.Array, Any, jax.Array, jax.Array]:
    return transition.obs, transition.outcome, transition.failed | transition.truncated, transition.valid


def _log_density(distribution: Gaussian, raw: jax.Array) -> jax.Array:
    """Returns the log-density of `raw` [act] up to a constant; tanh cancels in ratios."""
    return -jnp.sum(0.5 * ((raw - distribution.mean) * jnp.exp(-distribution.log_std)) ** 2 + distribution.log_std)
