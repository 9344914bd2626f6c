"""The agent: a method's networks as pure functions of their parameters, the only view of a method after training."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import jax

from ear_jax.agents.critic import Critic
from ear_jax.agents.networks import Params, identity
from ear_jax.agents.posterior import Context, Posterior
from ear_jax.agents.tanh_gaussian import Gaussian


@dataclass(frozen=True)
class Agent:
    """A method's networks, each function for one item: obs [obs], action [act], code [code].

    A code is a row of the code table and the policy's only input about the task. Interpolation, composition and search
    produce new codes.
    """

    code_size: int
    init_policy: Callable[[jax.Array], Params]
    codes: Callable[[Params], jax.Array]  # policy parameters → code table [tasks, code]
    project: Callable[[jax.Array], jax.Array]  # any vector [code] → the nearest valid code, such as a unit LTE
    distribution: Callable[[Params, jax.Array, jax.Array], Gaussian]  # policy parameters, code, obs
    critic: Critic | None  # None for a method without critics
    code_noise: float = 0.0  # σ of the noise added to a code when an update samples actions; it is then projected
    on_sphere: bool = False  # codes are unit vectors
    one_hot: bool = False  # the code table is of one-hots
    embed: Callable[[Params, jax.Array], jax.Array] | None = None  # policy parameters, obs → LSE
    # Policy parameters, obs, action → the next LSE and the step's outcomes in units of their spread, both predicted.
    forecast: Callable[[Params, jax.Array, jax.Array], tuple[jax.Array, jax.Array]] | None = None
    critic_task: str = "onehot"  # the critics' input about the task: onehot, lte or both
    own_temperatures: bool = False  # one temperature per task instead of a shared one
    infer: Callable[[Params, Context], Posterior] | None = None  # policy parameters, steps of a task
    # Observation, task → those that the networks see instead, if the agent turns symmetric tasks to one.
    canonical: Callable[[jax.Array, jax.Array], tuple[jax.Array, jax.Array]] = lambda obs, task: (obs, task)
    tuned: bool = False  # codes are offsets to the policy's parameters, found by gradient steps on episodes

    @property
    def finds_codes(self) -> bool:
        """True if codes come from experience in a task; the latest table is then stored beside the networks."""
        return self.tuned or self.infer is not None

    @property
    def parameter_counts(self) -> dict[str, int]:
        """The numbers of learnt parameters of the policy and of one critic."""
        return {"policy": _count(self.init_policy), "critic": _count(self.critic.init) if self.critic else 0}


def standardised(agent: Agent, obs_size: int) -> Agent:
    """Wraps an agent so that its policy standardises observations by statistics stored among its parameters.

    Policy parameters become `{"standardiser": …, "networks": …}`, plus `"codes"`, the latest code table, for agents
    that find codes from experience. The learner standardises the critics' observations.
    """

    def init_policy(key: jax.Array) -> Params:
        policy = {"standardiser": identity(obs_size), "networks": agent.init_policy(key)}
        return {**policy, "codes": agent.codes(policy["networks"])} if agent.finds_codes else policy

    def codes(policy: Params) -> jax.Array:
        return policy["codes"] if agent.finds_codes else agent.codes(policy["networks"])

    def distribution(policy: Params, code: jax.Array, obs: jax.Array) -> Gaussian:
        return agent.distribution(policy["networks"], code, policy["standardiser"](obs))

    embed, forecast, infer = agent.embed, agent.forecast, agent.infer
    return replace(
        agent,
        init_policy=init_policy,
        codes=codes,
        distribution=distribution,
        embed=embed and (lambda policy, obs: embed(policy["networks"], policy["standardiser"](obs))),
        forecast=forecast
        and (lambda policy, obs, action: forecast(policy["networks"], policy["standardiser"](obs), action)),
        infer=infer and (lambda policy, steps: infer(policy["networks"], _standardise(policy, steps))),
    )


def _standardise(policy: Params, context: Context) -> Context:
    return replace(context, obs=policy["standardiser"](context.obs))


def _count(init: Callable[[jax.Array], Params]) -> int:
    shapes = jax.eval_shape(init, jax.random.key(0))
    learnt = shapes.get("networks", shapes)
    return sum(math.prod(leaf.shape) for leaf in jax.tree.leaves(learnt))
