"""Multi-task SAC for any agent: collection, an epoch's updates and a single update."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import optax

from ear_jax.agents import Agent
from ear_jax.agents.critic import Critic, aggregate_q
from ear_jax.agents.equivariant import symmetrised
from ear_jax.agents.networks import Params
from ear_jax.config import Config, is_on
from ear_jax.envs import Family
from ear_jax.envs.batched_env import BatchedEnv, EnvState, Transition
from ear_jax.learning import losses, replay
from ear_jax.learning.batch import Batch, Batches, Draws, Noise, check_batch, rows_of_items
from ear_jax.learning.exploration import held_noise
from ear_jax.learning.learner import Metrics, scan_metrics
from ear_jax.learning.losses import Acts
from ear_jax.learning.optimiser import make_optimiser
from ear_jax.learning.replay import Experience, Replay
from ear_jax.learning.return_scale import largest_reward
from ear_jax.learning.rollout import act_with, rollout
from ear_jax.learning.sac_state import CRITICS, CriticStep, SacState
from ear_jax.tasks import TaskParams, task_count


@dataclass(frozen=True)
class SacLearner:
    """Trains an agent with critics (`Learner`)."""

    agent: Agent
    family: Family
    tasks: TaskParams  # each leaf [tasks]
    config: Config

    on_policy: ClassVar[bool] = False

    @staticmethod
    def check(config: Config, tasks: int) -> None:
        """Raises UsageError for a batch or a replay that does not fit the tasks."""
        check_batch(config, tasks)

    @property
    def task_count(self) -> int:
        """The number of tasks."""
        return task_count(self.tasks)

    @property
    def critic(self) -> Critic:
        """The agent's critic."""
        assert self.agent.critic, "SAC needs an agent with critics"
        return self.agent.critic

    @property
    def batches(self) -> Batches:
        """The source of batches; a learner that draws other batches overrides it."""
        return Batches(self.family, self.tasks, self.config, self.agent.code_size)

    @property
    def optimiser(self) -> optax.GradientTransformation:
        """The optimiser of policy, critics and temperature; each has its own state."""
        return make_optimiser(self.config.sac)

    def init(self, key: jax.Array) -> SacState:
        """Returns the initial state; target critics start as copies of the critics."""
        key_policy, key_critics = jax.random.split(key)
        policy = self.agent.init_policy(key_policy)
        critics = jax.vmap(self.critic.init)(jax.random.split(key_critics, CRITICS))
        temperatures = (self.task_count,) if self.agent.own_temperatures else ()
        log_temperature = jnp.log(jnp.full(temperatures, self.config.sac.initial_temperature, jnp.float32))
        return SacState(
            policy=policy,
            critics=critics,
            target_critics=jax.tree.map(jnp.copy, critics),
            log_temperature=log_temperature,
            policy_optimiser=self.optimiser.init(policy),
            critic_optimiser=jax.vmap(self.optimiser.init)(critics),
            temperature_optimiser=self.optimiser.init(log_temperature),
        )

    def memory(self, env_states: EnvState) -> Replay:
        """Returns empty rings for the transitions of environments [tasks, envs]."""
        obs = jnp.zeros(self.family.observation_size)
        outcome = jax.tree.map(lambda leaf: leaf[0, 0], env_states.state.metrics)
        scaled = is_on(self.config.sac.return_scale)
        item = Experience(obs, jnp.zeros(self.family.action_size), obs, outcome, jnp.zeros((), bool))
        return replay.init(item, self.task_count, self.config.replay.capacity // self.task_count, scaled)

    def collect(
        self, state: SacState, buffer: Replay, env_states: EnvState, key: jax.Array
    ) -> tuple[EnvState, Replay, Metrics]:
        """Steps every task's environments under the task's code and adds the transitions to its ring."""
        codes = self.codes_to_act(state.policy, buffer, key)
        env_states, transitions = self.explore(state.policy, codes, env_states, key)
        return env_states, *self.store(buffer, transitions)

    def explore(
        self, policy: Params, codes: jax.Array, env_states: EnvState, key: jax.Array
    ) -> tuple[EnvState, Transition]:
        """Steps every task's environments under the task's code; transitions are [steps, tasks, envs]."""
        settings = self.config.collect
        shape = (settings.steps, self.task_count, settings.envs, self.family.action_size)
        act = act_with(self.agent, policy, codes)
        noise = held_noise(jax.random.normal(key, shape), jax.random.fold_in(key, 2), settings.hold_noise)
        return rollout(BatchedEnv(self.family), act, env_states, noise, record=lambda step: step)

    def store(self, buffer: Replay, transitions: Transition) -> tuple[Replay, Metrics]:
        """Adds transitions [steps, tasks, envs] to the rings."""
        invalid = jnp.sum(~transitions.valid, dtype=jnp.float32)
        if buffer.largest is not None:
            largest = largest_reward(self.family, self.tasks, transitions, buffer.largest)
            buffer = replace(buffer, largest=largest)
        return replay.add(buffer, transitions), {"invalid_steps": invalid}

    def codes_to_act(self, policy: Params, buffer: Replay, key: jax.Array) -> jax.Array:
        """Returns the code table [tasks, code] under which collection acts."""
        return self.agent.codes(policy)

    def learn(self, state: SacState, buffer: Replay, key: jax.Array) -> tuple[SacState, Metrics]:
        """Makes an epoch's updates.

        Returns:
          The next state and metrics: scalars averaged over the updates, and `finite_updates` [tasks], the number of
          updates before a task's first non-finite loss.
        """
        state, metrics = scan_metrics(
            lambda state, draws: self.update(state, buffer, draws),
            replace(state, policy=self.observe(state.policy, buffer)),
            self.draw(key, self.config.sac.updates),
        )
        finite = jnp.sum(jnp.cumprod(metrics.pop("finite"), axis=0), axis=0)  # from [updates, tasks]
        return state, {**jax.tree.map(jnp.mean, metrics), "finite_updates": finite}

    def observe(self, policy: Params, buffer: Replay) -> Params:
        """Sets the parts of the policy computed from replay: the standardiser, if `standardise_obs` is set."""
        if not self.config.network.standardise_obs:
            return policy
        found = replay.standardiser(buffer)
        symmetry = self.family.symmetry if self.config.network.equivariant else None
        return {**policy, "standardiser": symmetrised(found, symmetry) if symmetry else found}

    def draw(self, key: jax.Array, updates: int) -> Draws:
        """Draws the randomness of `updates` updates, each leaf [updates, …]."""
        return self.batches.draw(key, updates)

    def update(self, state: SacState, buffer: Replay, draws: Draws) -> tuple[SacState, Metrics]:
        """Takes one gradient step of critics, policy and temperature, all differentiated at the same state.

        Args:
          state: the learner's state.
          buffer: the rings, each with at least one transition.
          draws: the randomness of this update.

        Returns:
          The next state and metrics: scalars, and `finite` [tasks], whether each task's loss was finite.
        """
        (policy_grad, critic_grad, temperature_grad), statistics, metrics = self._gradients(state, buffer, draws)
        policy, policy_optimiser = self._apply(policy_grad, state.policy_optimiser, state.policy)
        critics, critic_optimiser = jax.vmap(self._apply)(critic_grad, state.critic_optimiser, state.critics)
        critics = self.critic.constrain({**critics, **statistics} if statistics else critics)
        log_temperature, temperature_optimiser = self._apply(
            temperature_grad, state.temperature_optimiser, state.log_temperature
        )
        state = SacState(
            policy=policy,
            critics=critics,
            target_critics=optax.incremental_update(critics, state.target_critics, self.config.sac.tau),
            log_temperature=log_temperature,
            policy_optimiser=policy_optimiser,
            critic_optimiser=critic_optimiser,
            temperature_optimiser=temperature_optimiser,
        )
        return state, metrics

    def _gradients(
        self, state: SacState, buffer: Replay, draws: Draws
    ) -> tuple[tuple[Params, Params, jax.Array], Params, Metrics]:
        """Returns the gradients of policy, critics and log-temperature, the critics' statistics, and metrics."""
        batch = self.batches.take(buffer, draws)
        share = self.config.sac.policy_share  # a batch is in order of tasks, so every n-th item is as often of each
        of_policy, noise = jax.tree.map(lambda leaf: leaf[::share], (batch, draws.now))
        task = of_policy.task
        temperature = rows_of_items(jnp.exp(state.log_temperature), task)
        table = self.codes_to_learn(state.policy, buffer, draws)
        now, later, target = self._target(state, batch, table, draws.next)
        critics = self.train_critics(state, buffer, draws, batch, now, later, target)

        def actor_objective(policy):
            codes = self.codes_of_actor(policy, table)
            action, log_prob = losses.sample_policy(policy, self.agent, codes, of_policy.obs, task, noise)
            predicted = losses.predictions(
                state.critics, self.critic, now.obs[::share], action, self.task_input(table, task)
            )
            value = aggregate_q(losses.q_values(self.critic, predicted), self.config.sac.pessimism)
            loss = losses.actor_loss(value, log_prob, temperature)
            if is_on(weight := self.config.sac.outcome_weight):
                loss += weight * losses.outcome_loss(policy, self.agent, of_policy)
            return loss, log_prob

        def temperature_objective(log_temperature):
            target_entropy = -float(self.family.action_size)
            return losses.temperature_loss(rows_of_items(log_temperature, task), log_prob, target_entropy)

        (actor_loss, log_prob), policy_grad = jax.value_and_grad(actor_objective, has_aux=True)(state.policy)
        if critics.policy_grad is not None:
            policy_grad = jax.tree.map(jnp.add, policy_grad, critics.policy_grad)
        each = log_prob if share == 1 else jnp.repeat(log_prob, share)
        loss = jnp.sum(critics.losses, axis=0) + each  # [n]; not finite if any part of an item's is not
        metrics = {
            "finite": jnp.all(jnp.isfinite(loss).reshape(self.task_count, -1), axis=1),
            "critic_loss": critics.loss,
            "actor_loss": actor_loss,
            "temperature": jnp.mean(temperature),
            "entropy": -jnp.mean(log_prob),
            "q_value": jnp.mean(critics.values),
        }
        temperature_grad = jax.grad(temperature_objective)(state.log_temperature)
        return (policy_grad, critics.grad, temperature_grad), critics.statistics, metrics

    def train_critics(
        self, state: SacState, buffer: Replay, draws: Draws, batch: Batch, now: Acts, later: Acts, target: Any
    ) -> CriticStep:
        """Differentiates the critics' loss on a batch, by LTEs that critics see too."""

        def objective(critics, policy):
            task = self.task_input(self.agent.codes(policy), batch.task)
            predicted, statistics = losses.training_predictions(critics, self.critic, now, later, task)
            each = losses.critic_losses(self.critic, predicted, target)
            return losses.critic_loss(each), (each, losses.q_values(self.critic, predicted), statistics)

        taught = (0,) if self.agent.critic_task == "onehot" else (0, 1)
        with_grads = jax.value_and_grad(objective, argnums=taught, has_aux=True)
        (loss, aux), (grad, *policy_grad) = with_grads(state.critics, state.policy)
        return CriticStep(grad, policy_grad[0] if policy_grad else None, loss, *aux)

    def codes_to_learn(self, policy: Params, buffer: Replay, draws: Draws) -> jax.Array:
        """Returns an update's code table [tasks, code]; no gradient reaches the policy through it."""
        return self.agent.codes(policy)

    def codes_of_actor(self, policy: Params, table: jax.Array) -> jax.Array:
        """Returns the code table of the actor's objective, whose gradient reaches the task encoder through it."""
        return self.agent.codes(policy)

    def task_input(self, table: jax.Array, task: jax.Array) -> jax.Array:
        """Returns the critics' input about the tasks of a batch, [n, ·]: one-hots, LTEs or both."""
        one_hot, kind = jax.nn.one_hot(task, self.task_count), self.agent.critic_task
        if kind == "onehot":
            return one_hot
        rows = rows_of_items(table, task)
        return rows if kind == "lte" else jnp.concatenate([one_hot, rows], axis=1)

    def _target(self, state: SacState, batch: Batch, table: jax.Array, noise: Noise) -> tuple[Acts, Acts, Any]:
        """Returns a batch's acts, those of the policy at the next step, and each item's target, each leaf [n, …]."""
        standardise = state.policy["standardiser"]  # for the critics; the policy standardises its own observations
        action, log_prob = losses.sample_policy(state.policy, self.agent, table, batch.next_obs, batch.task, noise)
        now, later = Acts(standardise(batch.obs), batch.action), Acts(standardise(batch.next_obs), action)
        task = self.task_input(table, batch.task)
        next_predictions = losses.target_predictions(state.target_critics, self.critic, now, later, task)
        temperature = rows_of_items(jnp.exp(state.log_temperature), batch.task)
        sac = self.config.sac
        target = losses.critic_targets(
            self.critic, next_predictions, batch, log_prob, temperature, sac.discount, sac.pessimism
        )
        return now, later, target

    def _apply(self, grad: Params, optimiser_state: Any, params: Params) -> tuple[Params, Any]:
        update, optimiser_state = self.optimiser.update(grad, optimiser_state, params)
        return optax.apply_updates(params, update), optimiser_state
