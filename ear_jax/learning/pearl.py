"""PEARL: SAC with codes inferred from experience, by an encoder that the critics' loss trains.

Rakelly et al. 2019, arXiv 1903.08254; constants as in the authors' code, katerakelly/oyster.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from flax import struct

from ear_jax.agents.networks import Params
from ear_jax.agents.posterior import Context, Posterior, prior, where
from ear_jax.learning import losses, replay
from ear_jax.learning.batch import Batch, Draws, draw_tasks, rows_of_items
from ear_jax.learning.learner import Metrics
from ear_jax.learning.losses import Acts
from ear_jax.learning.replay import Replay
from ear_jax.learning.rollout import score
from ear_jax.learning.sac import SacLearner
from ear_jax.learning.sac_state import CriticStep, SacState

CONTEXT = 100  # steps that a code is inferred from, drawn from as many of the newest, or from an epoch's if it has more
PRIOR_SHARE = 0.4  # probability that collection acts under a code from the prior
# Weight of the KL divergence from the prior. The authors' is 0.1 for rewards scaled by 5; scaling it with the rewards
# keeps its share of the critics' loss.
KL_WEIGHT = 0.1 / 5**2


@struct.dataclass
class PearlDraws(Draws):
    """The randomness of a SAC update and of inferring its codes."""

    tasks: jax.Array  # int32 [drawn]: the tasks that it learns from
    context: jax.Array  # [drawn, steps] in [0, 1): positions among a task's newest steps
    posterior: jax.Array  # [drawn, code], standard normal


@dataclass(frozen=True)
class PearlLearner(SacLearner):
    """Trains an agent that infers its codes; critics see a task's code in place of its one-hot.

    An update draws a few of the tasks, and is that of a learner which has no others.
    """

    def observe(self, policy: Params, buffer: Replay) -> Params:
        """Also stores the posteriors' means as the code table, so that evaluation needs no inference."""
        policy = super().observe(policy, buffer)
        place = jnp.broadcast_to((jnp.arange(CONTEXT) + 0.5) / CONTEXT, (self.task_count, CONTEXT))
        return {**policy, "codes": self.posteriors(policy, buffer, jnp.arange(self.task_count), place).mean}

    def codes_to_act(self, policy: Params, buffer: Replay, key: jax.Array) -> jax.Array:
        """Draws each task's code from its posterior, or with probability `PRIOR_SHARE` from the prior."""
        key_place, key_prior, key_code = jax.random.split(jax.random.fold_in(key, 1), 3)
        shape = (self.task_count, self.agent.code_size)
        place = jax.random.uniform(key_place, (self.task_count, CONTEXT))
        inferred = self.posteriors(policy, buffer, jnp.arange(self.task_count), place)
        priors = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, shape), prior(self.agent.code_size))
        mixed = where(jax.random.uniform(key_prior, (self.task_count,)) < PRIOR_SHARE, priors, inferred)
        return mixed.sample(jax.random.normal(key_code, shape))

    def draw(self, key: jax.Array, updates: int) -> PearlDraws:
        keys_tasks = jax.random.split(jax.random.fold_in(key, 7), updates)  # `Batches.draw` splits into 7
        tasks = jax.vmap(partial(draw_tasks, self.config, self.task_count))(keys_tasks)
        draws = self.batches.draw(key, updates, tasks)
        key_context, key_posterior = jax.random.split(jax.random.split(key, 7)[5])
        context = jax.random.uniform(key_context, (*tasks.shape, CONTEXT))
        posterior = jax.random.normal(key_posterior, (*tasks.shape, self.agent.code_size))
        return PearlDraws(**vars(draws), tasks=tasks, context=context, posterior=posterior)

    def update(self, state: SacState, buffer: Replay, draws: Any) -> tuple[SacState, Metrics]:
        drawn = replace(self, tasks=jax.tree.map(lambda leaf: leaf[draws.tasks], self.tasks))
        state, metrics = SacLearner.update(drawn, state, buffer, draws)
        finite = jnp.ones(self.task_count, bool).at[draws.tasks].set(metrics["finite"])
        return state, {**metrics, "finite": finite}

    def codes_to_learn(self, policy: Params, buffer: Replay, draws: Any) -> jax.Array:
        return self.posteriors(policy, buffer, draws.tasks, draws.context).sample(draws.posterior)

    def codes_of_actor(self, policy: Params, table: jax.Array) -> jax.Array:
        """Returns the drawn codes; the actor's loss does not train the encoder."""
        return table

    def task_input(self, table: jax.Array, task: jax.Array) -> jax.Array:
        """Returns the tasks' codes [n, code]."""
        return rows_of_items(table, task)

    def train_critics(
        self, state: SacState, buffer: Replay, draws: Any, batch: Batch, now: Acts, later: Acts, target: Any
    ) -> CriticStep:
        """Differentiates the critics' loss plus the KL divergence from the prior by critics and encoder."""

        def objective(critics, policy):
            inferred = self.posteriors(policy, buffer, draws.tasks, draws.context)
            task = self.task_input(inferred.sample(draws.posterior), batch.task)
            kl = jnp.sum(jax.vmap(Posterior.kl_to_prior)(inferred))
            predicted, statistics = losses.training_predictions(critics, self.critic, now, later, task)
            each = losses.critic_losses(self.critic, predicted, target)
            loss = losses.critic_loss(each) + KL_WEIGHT * self.config.sac.reward_scale**2 * kl
            return loss, (each, losses.q_values(self.critic, predicted), statistics)

        differentiate = jax.value_and_grad(objective, argnums=(0, 1), has_aux=True)
        (loss, aux), (grad, policy_grad) = differentiate(state.critics, state.policy)
        return CriticStep(grad, policy_grad, loss, *aux)

    def posteriors(self, policy: Params, buffer: Replay, rings: jax.Array, place: jax.Array) -> Posterior:
        """Infers the learner's tasks' posteriors, each leaf [tasks, code].

        Args:
          policy: the policy's parameters.
          buffer: the rings of all tasks.
          rings: int32 [tasks], those of the learner's.
          place: [tasks, steps] in [0, 1): positions among the newest steps of each.
        """
        assert self.agent.infer
        collect = self.config.collect
        items, held = replay.recent(buffer, rings, place, max(collect.envs * collect.steps, CONTEXT))
        reward = self.config.sac.reward_scale * score(self.family, items.outcome, self.tasks)
        contexts = Context(items.obs, items.action, reward, held)
        return jax.vmap(self.agent.infer, in_axes=(None, 0))(policy, contexts)
