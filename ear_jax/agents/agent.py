"""What a method is, told by pure functions of parameters. The trainer and everything after it see only this."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import jax

from ear_jax.belief import Belief, Context
from ear_jax.config import NetworkConfig
from ear_jax.networks import Network, Params, identity, mlp
from ear_jax.policy import Gaussian


@dataclass(frozen=True)
class Agent:
    """A method as functions; obs is [obs], action [act], code [code], task a one-hot [tasks], all of one item.

    A code is a row of the code table, and the policy knows a task by nothing else: interpolation, composition and
    search only make new rows.
    """

    code_size: int
    init_policy: Callable[[jax.Array], Params]
    init_critic: Callable[[jax.Array], Params]
    codes: Callable[[Params], jax.Array]  # policy parameters → table [tasks, code]
    project: Callable[[jax.Array], jax.Array]  # any vector [code] → the code nearest to it, as the unit sphere's
    code_noise: float  # σ of the noise on a code in the actor's objectives, before it is projected again
    distribution: Callable[[Params, jax.Array, jax.Array], Gaussian]  # policy parameters, code, obs
    value: Callable[[Params, jax.Array, jax.Array, jax.Array], jax.Array]  # one critic's parameters, obs, action, task,
    # which is told by its one-hot, or by its code where that is inferred
    on_sphere: bool = False  # codes are unit vectors
    embed: Callable[[Params, jax.Array], jax.Array] | None = None  # policy parameters, obs → LSE, where there is one
    own_temperatures: bool = False  # a temperature for each task, instead of one that all share
    infer: Callable[[Params, Context], Belief] | None = None  # policy parameters, what happened in a task → its code
    tuned: bool = False  # a code is added to the policy's parameters, and found by gradient steps on a task's episodes

    @property
    def finds_codes(self) -> bool:
        """Whether codes come of what happened in a task, so that the newest are kept beside the networks."""
        return self.tuned or self.infer is not None

    @property
    def parameter_counts(self) -> dict[str, int]:
        """How many learnt numbers the policy is made of, and each critic."""
        return {"policy": _count(self.init_policy), "critic": _count(self.init_critic)}


def standardised(agent: Agent, obs_size: int) -> Agent:
    """An agent whose policy standardises what it sees, with statistics that are among its parameters.

    Those become `{"standardiser": …, "networks": …}`. Critics are shown standardised observations by the learner. Where
    codes come of what happened, `"codes"` holds the table that was found last.
    """

    def init_policy(key: jax.Array) -> Params:
        policy = {"standardiser": identity(obs_size), "networks": agent.init_policy(key)}
        return {**policy, "codes": agent.codes(policy["networks"])} if agent.finds_codes else policy

    def codes(policy: Params) -> jax.Array:
        return policy["codes"] if agent.finds_codes else agent.codes(policy["networks"])

    def distribution(policy: Params, code: jax.Array, obs: jax.Array) -> Gaussian:
        return agent.distribution(policy["networks"], code, policy["standardiser"](obs))

    embed, infer = agent.embed, agent.infer
    return replace(
        agent,
        init_policy=init_policy,
        codes=codes,
        distribution=distribution,
        embed=embed and (lambda policy, obs: embed(policy["networks"], policy["standardiser"](obs))),
        infer=infer and (lambda policy, seen: infer(policy["networks"], _standard(policy, seen))),
    )


def _standard(policy: Params, context: Context) -> Context:
    return replace(context, obs=policy["standardiser"](context.obs))


def critic_network(inputs: int, outputs: int, config: NetworkConfig) -> Network:
    """What the critics of all agents are made of: ReLU layers, normalised where the settings say so."""
    widths = (config.width,) * config.critic_layers
    return mlp(inputs, widths, outputs, config, config.critic_layer_norm)


def _count(init: Callable[[jax.Array], Params]) -> int:
    shapes = jax.eval_shape(init, jax.random.key(0))
    learnt = shapes.get("networks", shapes)
    return sum(math.prod(leaf.shape) for leaf in jax.tree.leaves(learnt))
