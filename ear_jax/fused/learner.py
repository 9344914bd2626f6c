"""SAC whose critics and policy are kernels: the same equations as `SacLearner`, in fewer and larger launches.

Parameters are packed for an epoch's updates and unpacked after it, so states, checkpoints and everything that acts are
the same as without.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
import optax

from ear_jax.agents.networks import Params
from ear_jax.agents.tanh_gaussian import Gaussian, gaussian
from ear_jax.fused.critic import CriticLayout, value_of_item
from ear_jax.fused.policy import PolicyLayout, head_of_item
from ear_jax.learning.learner import Metrics
from ear_jax.learning.replay import Replay
from ear_jax.learning.sac import SacLearner
from ear_jax.learning.sac_state import SacState


@dataclass(frozen=True)
class FusedSacLearner(SacLearner):
    """Trains EAR with fused kernels (`Learner`)."""

    def learn(self, state: SacState, buffer: Replay, key: jax.Array) -> tuple[SacState, Metrics]:
        policy, critic = self._policy_layout(), self._critic_layout()
        inner = SacLearner(self._packed_agent(policy, critic), self.family, self.tasks, self.config)
        packed = _mapped(state, lambda tree: _pack_policy(policy, tree), jax.vmap(critic.pack))
        packed, metrics = inner.learn(packed, buffer, key)
        return _mapped(packed, lambda tree: _unpack_policy(policy, tree), jax.vmap(critic.unpack)), metrics

    def _critic_layout(self) -> CriticLayout:
        network, agent = self.config.network, self.agent
        tasks = {"onehot": self.task_count, "lte": agent.code_size, "both": self.task_count + agent.code_size}
        inputs = self.family.observation_size + self.family.action_size + tasks[agent.critic_task]
        return CriticLayout(inputs, network.width, network.critic_layers, network.matmul == "bfloat16")

    def _policy_layout(self) -> PolicyLayout:
        network = self.config.network
        return PolicyLayout(
            obs=self.family.observation_size,
            lse=network.lse_size,
            code=self.agent.code_size,
            outputs=2 * self.family.action_size,
            width=network.width,
            encoder_layers=network.encoder_layers,
            decoder_layers=network.decoder_layers,
            on_sphere=network.normalise_lse,
            bfloat16=network.matmul == "bfloat16",
        )

    def _packed_agent(self, policy_layout: PolicyLayout, critic_layout: CriticLayout) -> Any:
        """Returns the agent as functions of packed parameters."""
        head, value = head_of_item(policy_layout), value_of_item(critic_layout)

        def distribution(policy: Params, code: jax.Array, obs: jax.Array) -> Gaussian:
            return gaussian(head(policy["networks"]["pack"], policy["standardiser"](obs), code))

        def predict(pack: jax.Array, obs: jax.Array, action: jax.Array, task: jax.Array) -> jax.Array:
            return value(pack, jnp.concatenate([obs, action, task]))

        return replace(self.agent, distribution=distribution, critic=replace(self.critic, predict=predict))


def _pack_policy(layout: PolicyLayout, policy: Params) -> Params:
    networks = policy["networks"]
    return {**policy, "networks": {"pack": layout.pack(networks), "task_encoder": networks["task_encoder"]}}


def _unpack_policy(layout: PolicyLayout, policy: Params) -> Params:
    networks = policy["networks"]
    return {**policy, "networks": {**layout.unpack(networks["pack"]), "task_encoder": networks["task_encoder"]}}


def _mapped(state: SacState, of_policy: Any, of_critics: Any) -> SacState:
    """Maps the parameters of policy and critics, and the moments that their optimisers keep of them."""
    return replace(
        state,
        policy=of_policy(state.policy),
        critics=of_critics(state.critics),
        target_critics=of_critics(state.target_critics),
        policy_optimiser=_moments(state.policy_optimiser, of_policy),
        critic_optimiser=_moments(state.critic_optimiser, of_critics),
    )


def _moments(optimiser: Any, mapped: Any) -> Any:
    def of_part(part: Any) -> Any:
        if not isinstance(part, optax.ScaleByAdamState):
            return part
        return part._replace(mu=mapped(part.mu), nu=mapped(part.nu))

    return jax.tree.map(of_part, optimiser, is_leaf=lambda part: isinstance(part, optax.ScaleByAdamState))
