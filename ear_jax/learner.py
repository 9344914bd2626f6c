"""Multi-task SAC for any agent: an epoch's collection, its updates, and one of these."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import optax
from flax import struct

from ear_jax import losses, replay
from ear_jax.agents import Agent
from ear_jax.belief import Belief, Context, prior, where
from ear_jax.config import Config
from ear_jax.envs.family import Family
from ear_jax.envs.symmetry import Symmetry, own_by_symmetry
from ear_jax.grid import Cell, Grid, Transition
from ear_jax.losses import Batch, Noise
from ear_jax.networks import Params
from ear_jax.replay import Experience, Replay
from ear_jax.rollout import act_with, rollout
from ear_jax.tasks import TaskParams

CRITICS = 2
LAST_LR = 0.1  # of the step size, where it decays
# Where codes are inferred (katerakelly/oyster): steps that a belief is made of, how often collection acts under a code
# drawn from the prior, and the weight of a belief's divergence from it, which is theirs of 0.1 where rewards are theirs
# times 5, and keeps its part in the critics' loss at any other scale.
CONTEXT, PRIOR_SHARE, DIVERGENCE = 100, 0.4, 0.1 / 5**2


@struct.dataclass
class LearnerState:
    """All that gradients change."""

    policy: Params
    critics: Params  # each leaf [critics, …]
    target_critics: Params
    log_temperature: jax.Array  # a scalar, or [tasks] where the agent has one for each task
    policy_optimiser: Any
    critic_optimiser: Any  # one a critic, each leaf [critics, …]
    temperature_optimiser: Any

    @property
    def norms(self) -> dict[str, jax.Array]:
        """Global norms; one is not finite as soon as one of its numbers is not."""
        return {
            "policy_norm": optax.global_norm(self.policy),
            "critics_norm": optax.global_norm((self.critics, self.target_critics)),
            "temperature_norm": optax.global_norm(self.log_temperature),
        }


@struct.dataclass
class Draws:
    """Everything random about one update, drawn for many at once: one large draw is cheaper than many small ones."""

    source: jax.Array  # int32 [n], whose ring an item comes from
    variant: jax.Array  # int32 [n], how it is turned or mirrored, where the family has symmetries
    place: jax.Array  # [n] in [0, 1), where in that ring
    now: Noise
    next: Noise
    context: jax.Array  # [tasks, steps] in [0, 1), which of a task's newest steps its code is inferred from
    belief: jax.Array  # [tasks, code], by which that code is drawn


@dataclass(frozen=True)
class Learner:
    """The parts an update needs that never change."""

    agent: Agent
    family: Family
    tasks: TaskParams  # each leaf [tasks]
    config: Config

    @property
    def task_count(self) -> int:
        return len(jax.tree.leaves(self.tasks)[0])

    @property
    def optimiser(self) -> optax.GradientTransformation:
        sac = self.config.sac
        lr = optax.linear_schedule(sac.lr, LAST_LR * sac.lr, sac.lr_decay) if sac.lr_decay else sac.lr
        return optax.chain(optax.clip_by_global_norm(sac.max_grad_norm), optax.adam(lr))

    def init(self, key: jax.Array) -> LearnerState:
        key_policy, key_critics = jax.random.split(key)
        policy = self.agent.init_policy(key_policy)
        critics = jax.vmap(self.agent.init_critic)(jax.random.split(key_critics, CRITICS))
        temperatures = (self.task_count,) if self.agent.own_temperatures else ()
        log_temperature = jnp.log(jnp.full(temperatures, self.config.sac.initial_temperature))
        return LearnerState(
            policy=policy,
            critics=critics,
            target_critics=jax.tree.map(jnp.copy, critics),
            log_temperature=log_temperature,
            policy_optimiser=self.optimiser.init(policy),
            critic_optimiser=jax.vmap(self.optimiser.init)(critics),
            temperature_optimiser=self.optimiser.init(log_temperature),
        )

    def memory(self, cells: Cell) -> Replay:
        """Empty rings for what such environments [tasks, envs] go through."""
        obs = jnp.zeros(self.family.observation_size)
        outcome = jax.tree.map(lambda leaf: leaf[0, 0], cells.state.metrics)
        item = Experience(obs, jnp.zeros(self.family.action_size), obs, outcome, jnp.zeros((), bool))
        return replay.init(item, self.task_count, self.config.replay.capacity // self.task_count)

    def collect(
        self, state: LearnerState, buffer: Replay, cells: Cell, key: jax.Array
    ) -> tuple[Cell, Replay, dict[str, jax.Array]]:
        """Every task's environments act under its own code, into its own ring."""
        settings = self.config.collect
        shape = (settings.steps, self.task_count, settings.envs, self.family.action_size)
        act = act_with(self.agent, state.policy, self.codes_to_act(state.policy, buffer, key))
        cells, transitions = rollout(Grid(self.family), act, cells, jax.random.normal(key, shape), _whole)
        invalid = jnp.sum(~transitions.valid, dtype=jnp.float32)
        return cells, replay.add(buffer, transitions), {"invalid_steps": invalid}

    def learn(self, state: LearnerState, buffer: Replay, key: jax.Array) -> tuple[LearnerState, dict[str, jax.Array]]:
        """An epoch's updates.

        Returns:
          Where the learner stands then, and its metrics: scalars averaged over the updates, and `sound_updates`
          [tasks], the updates before the first in which a task's loss was not finite.
        """
        state, watched = jax.lax.scan(
            lambda state, draws: self.update(state, buffer, draws),
            self.observe(state, buffer),
            self.draw(key, self.config.sac.updates),
        )
        sound = jnp.sum(jnp.cumprod(watched.pop("sound"), axis=0), axis=0)  # from [updates, tasks]
        return state, {**jax.tree.map(jnp.mean, watched), "sound_updates": sound}

    def observe(self, state: LearnerState, buffer: Replay) -> LearnerState:
        """Standardises by what replay holds, where the configuration asks for it."""
        policy = state.policy
        if self.config.network.standardise_obs:
            policy = {**policy, "standardiser": replay.standardiser(buffer)}
        if self.agent.infer:
            place = jnp.broadcast_to((jnp.arange(CONTEXT) + 0.5) / CONTEXT, (self.task_count, CONTEXT))
            policy = {**policy, "codes": self._beliefs(policy, buffer, place).mean}
        return replace(state, policy=policy)

    def codes_to_act(self, policy: Params, buffer: Replay, key: jax.Array) -> jax.Array:
        """The table [tasks, code] that collection acts under; inferred codes are drawn, now and then from the prior."""
        if not self.agent.infer:
            return self.agent.codes(policy)
        key_place, key_prior, key_code = jax.random.split(jax.random.fold_in(key, 1), 3)
        shape = (self.task_count, self.agent.code_size)
        beliefs = self._beliefs(policy, buffer, jax.random.uniform(key_place, (self.task_count, CONTEXT)))
        unknown = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, shape), prior(self.agent.code_size))
        beliefs = where(jax.random.uniform(key_prior, (self.task_count,)) < PRIOR_SHARE, unknown, beliefs)
        return beliefs.draw(jax.random.normal(key_code, shape))

    def draw(self, key: jax.Array, updates: int) -> Draws:
        """The randomness of `updates` updates, each leaf [updates, n, …]."""
        n, tasks, settings = self.config.sac.batch_size, self.task_count, self.config.replay
        keys = jax.random.split(key, 7)
        source, variant = jnp.broadcast_to(self._batch_tasks(), (updates, n)), jnp.zeros((updates, n), jnp.int32)
        if self._symmetry:
            source, variant = own_by_symmetry(self._symmetry, self.tasks, keys[6], source)
        if settings.share_experience:
            anyone = jax.random.randint(keys[0], (updates, n), 0, tasks)
            source = jnp.where(jax.random.uniform(keys[1], (updates, n)) < settings.own_share, source, anyone)

        def noise(key: jax.Array) -> Noise:
            key_action, key_code = jax.random.split(key)
            return Noise(
                jax.random.normal(key_action, (updates, n, self.family.action_size)),
                jax.random.normal(key_code, (updates, n, self.agent.code_size)),
            )

        place = jax.random.uniform(keys[2], (updates, n))
        key_context, key_belief = jax.random.split(keys[5])
        context = jax.random.uniform(key_context, (updates, tasks, CONTEXT if self.agent.infer else 0))
        belief = jax.random.normal(key_belief, (updates, tasks, self.agent.code_size if self.agent.infer else 0))
        return Draws(source, variant, place, noise(keys[3]), noise(keys[4]), context, belief)

    def update(self, state: LearnerState, buffer: Replay, draws: Draws) -> tuple[LearnerState, dict[str, jax.Array]]:
        """One step of critics, policy and temperature, all differentiated where the state stood before it.

        Args:
          state: where the learner stands.
          buffer: every ring holds at least one transition.
          draws: the randomness of this update, each leaf [n, …].

        Returns:
          The next state, and what to watch: scalars, and `sound` [tasks], whether each task's loss was finite.
        """
        (policy_grad, critic_grad, temperature_grad), watched = self._gradients(state, buffer, draws)
        policy, policy_optimiser = self._apply(policy_grad, state.policy_optimiser, state.policy)
        critics, critic_optimiser = jax.vmap(self._apply)(critic_grad, state.critic_optimiser, state.critics)
        log_temperature, temperature_optimiser = self._apply(
            temperature_grad, state.temperature_optimiser, state.log_temperature
        )
        state = LearnerState(
            policy=policy,
            critics=critics,
            target_critics=optax.incremental_update(critics, state.target_critics, self.config.sac.tau),
            log_temperature=log_temperature,
            policy_optimiser=policy_optimiser,
            critic_optimiser=critic_optimiser,
            temperature_optimiser=temperature_optimiser,
        )
        return state, watched

    def _gradients(
        self, state: LearnerState, buffer: Replay, draws: Draws
    ) -> tuple[tuple[Params, Params, jax.Array], dict[str, jax.Array]]:
        """Of the policy, the critics and the temperature's logarithm; and what to watch."""
        batch = self._batch(buffer, draws)
        temperature = _of_items(jnp.exp(state.log_temperature), batch.task)
        inferred, _ = self._table(state.policy, buffer, draws)
        target = self._target(state, batch, inferred, draws.next)
        obs = state.policy["standardiser"](batch.obs)  # as critics see it

        def critic_objective(critics, policy):
            table, divergence = self._table(policy, buffer, draws)
            values = losses.q_values(critics, self.agent, obs, batch.action, self._shown(table, batch.task))
            weight = DIVERGENCE * self.config.sac.reward_scale**2
            return losses.critic_loss(values, target) + weight * divergence, values

        def actor_objective(policy):
            table = inferred if self.agent.infer else self.agent.codes(policy)
            action, log_prob = losses.sample_policy(policy, self.agent, table, batch.obs, batch.task, draws.now)
            value = losses.q_values(state.critics, self.agent, obs, action, self._shown(table, batch.task))
            believed = losses.believed(value, self.config.sac.pessimism)
            return losses.actor_loss(believed, log_prob, temperature), log_prob

        def temperature_objective(log_temperature):
            target_entropy = -float(self.family.action_size)
            return losses.temperature_loss(_of_items(log_temperature, batch.task), log_prob, target_entropy)

        of_both = jax.value_and_grad(critic_objective, argnums=(0, 1), has_aux=True)
        (critic_loss, values), (critic_grad, belief_grad) = of_both(state.critics, state.policy)
        (actor_loss, log_prob), actor_grad = jax.value_and_grad(actor_objective, has_aux=True)(state.policy)
        policy_grad = jax.tree.map(jnp.add, actor_grad, belief_grad)  # the latter is 0 where codes are not inferred
        loss = jnp.sum((values - target) ** 2, axis=0) + log_prob  # [n], task by task
        watched = {
            "sound": jnp.all(jnp.isfinite(loss).reshape(self.task_count, -1), axis=1),
            "critic_loss": critic_loss,
            "actor_loss": actor_loss,
            "temperature": jnp.mean(temperature),
            "entropy": -jnp.mean(log_prob),
            "q_value": jnp.mean(values),
        }
        return (policy_grad, critic_grad, jax.grad(temperature_objective)(state.log_temperature)), watched

    def _batch_tasks(self) -> jax.Array:
        """Which task each item of a batch teaches, int32 [n]: all equally often."""
        return jnp.repeat(jnp.arange(self.task_count), self.config.sac.batch_size // self.task_count)

    def _batch(self, buffer: Replay, draws: Draws) -> Batch:
        """Gathers experience and scores it for the tasks it is to teach, whosever it was."""
        task = self._batch_tasks()
        size = buffer.size[draws.source]
        slot = jnp.minimum((draws.place * size).astype(jnp.int32), size - 1)
        items = replay.gather(buffer, draws.source, slot)
        if self._symmetry:
            items = jax.vmap(partial(replay.otherwise, self._symmetry))(draws.variant, items)
        params = jax.tree.map(lambda leaf: leaf[task], self.tasks)
        reward = self.config.sac.reward_scale * jax.vmap(self.family.reward)(items.outcome, params)
        return Batch(items.obs, items.action, items.next_obs, reward, items.terminated, task)

    @property
    def _symmetry(self) -> Symmetry | None:
        return self.family.symmetry if self.config.replay.symmetry else None

    def _table(self, policy: Params, buffer: Replay, draws: Draws) -> tuple[jax.Array, jax.Array]:
        """Codes [tasks, code], drawn where they are inferred, and the divergence of all beliefs from the prior."""
        if not self.agent.infer:
            return self.agent.codes(policy), jnp.zeros(())
        beliefs = self._beliefs(policy, buffer, draws.context)
        return beliefs.draw(draws.belief), jnp.sum(jax.vmap(Belief.divergence)(beliefs))

    def _beliefs(self, policy: Params, buffer: Replay, place: jax.Array) -> Belief:
        """What the newest steps of each task tell of its code, each leaf [tasks, code]."""
        assert self.agent.infer
        collect = self.config.collect
        items, held = replay.recent(buffer, place, collect.envs * collect.steps)
        score = jax.vmap(jax.vmap(self.family.reward, in_axes=(0, None)))
        reward = self.config.sac.reward_scale * score(items.outcome, self.tasks)
        contexts = Context(items.obs, items.action, reward, held)
        return jax.vmap(self.agent.infer, in_axes=(None, 0))(policy, contexts)

    def _shown(self, table: jax.Array, task: jax.Array) -> jax.Array:
        """What critics know the tasks of a batch by, [n, ·]: one-hots, or codes where those are inferred."""
        return table[task] if self.agent.infer else jax.nn.one_hot(task, self.task_count)

    def _target(self, state: LearnerState, batch: Batch, table: jax.Array, noise: Noise) -> jax.Array:
        action, log_prob = losses.sample_policy(state.policy, self.agent, table, batch.next_obs, batch.task, noise)
        next_obs = state.policy["standardiser"](batch.next_obs)
        shown = self._shown(table, batch.task)
        value = losses.q_values(state.target_critics, self.agent, next_obs, action, shown)
        believed = losses.believed(value, self.config.sac.pessimism)
        temperature = _of_items(jnp.exp(state.log_temperature), batch.task)
        return losses.td_target(batch, believed, log_prob, temperature, self.config.sac.discount)

    def _apply(self, grad: Params, optimiser_state: Any, params: Params) -> tuple[Params, Any]:
        update, optimiser_state = self.optimiser.update(grad, optimiser_state, params)
        return optax.apply_updates(params, update), optimiser_state


def _of_items(temperature: jax.Array, task: jax.Array) -> jax.Array:
    """What of all temperatures, or of their logarithms, is each item's: the shared scalar, or its task's [n]."""
    return temperature[task] if temperature.ndim else temperature


def _whole(transition: Transition) -> Transition:
    return transition
