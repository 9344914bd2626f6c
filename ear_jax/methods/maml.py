"""MAML: shared parameters that one policy-gradient step adapts to a task."""

from __future__ import annotations

from dataclasses import replace
from itertools import accumulate
from typing import Any

import jax
import jax.numpy as jnp

from ear_jax.agents import Agent
from ear_jax.agents.networks import Params, mlp
from ear_jax.agents.tanh_gaussian import LOG_STD_RANGE, Gaussian
from ear_jax.config import Config
from ear_jax.learning.maml import MamlLearner
from ear_jax.methods.method import OF_A_TASK_ENCODER, OF_EMBEDDINGS, Method, Sizes


def maml(sizes: Sizes, config: Config) -> Agent:
    """Builds the policy of MAML (Finn et al. 2017, arXiv 1703.03400): tanh layers, and a learnt σ for all states.

    A task's code is the offset of its parameters from the shared ones. Adapting to a task thus yields a code like any
    other method, and users of a policy need not know how. There are no critics. `width` and `decoder_layers` are the
    policy's. Matmuls stay float32: the update's curvature needs a forward-mode derivative, which the bfloat16 matmul
    does not have.
    """
    network = replace(config.network, matmul="float32")
    mean = mlp(sizes.obs, (network.width,) * network.decoder_layers, sizes.action, network, activation=jnp.tanh)

    def init_policy(key: jax.Array) -> Params:
        return {"network": mean.init(key), "log_std": jnp.zeros(sizes.action)}

    leaves, structure = jax.tree.flatten(jax.eval_shape(init_policy, jax.random.key(0)))
    *starts, code_size = accumulate((leaf.size for leaf in leaves), initial=0)

    def rebuild(code: jax.Array) -> Params:
        """Returns a code as offsets in the policy's structure."""
        parts = jnp.split(code, starts[1:])
        shaped = [part.reshape(leaf.shape) for part, leaf in zip(parts, leaves, strict=True)]
        return jax.tree.unflatten(structure, shaped)

    def distribution(policy: Params, code: jax.Array, obs: jax.Array) -> Gaussian:
        own = jax.tree.map(jnp.add, policy, rebuild(code))
        return Gaussian(mean.apply(own["network"], obs), jnp.clip(own["log_std"], *LOG_STD_RANGE))

    return Agent(
        code_size=code_size,
        init_policy=init_policy,
        codes=lambda policy: jnp.zeros((sizes.tasks, code_size)),
        project=lambda code: code,
        distribution=distribution,
        critic=None,
        tuned=True,
    )


_OF_SAC = (
    *(f"sac.{name}" for name in ("lr", "lr_decay", "discount", "pessimism", "tau", "batch_size")),
    *(f"sac.{name}" for name in ("reward_scale", "initial_temperature", "max_grad_norm")),
    *(f"sac.{name}" for name in ("policy_share", "return_scale", "weight_decay")),
    *("collect.hold_noise", "collect.stagger"),
    *("network.critic_*", "network.standardise_obs", "replay.*"),
)
# An update needs fresh episodes of all tasks: 20 before and 20 after adaptation.
_EPISODES: dict[str, Any] = {
    "network": {"width": 64, "decoder_layers": 2, "initialiser": "fan_in", "standardise_obs": False},
    "sac": {"updates": 1, "lr_decay": 0},
    "collect": {"envs": 20, "steps": 400, "pretrain_epochs": 1, "stagger": False},
}
# In jonasrothfuss/ProMP and tristandeleu/pytorch-maml-rl λ is 1, the step 0.1 and the limit 0.01. On 20 episodes of 200
# steps the gradient is then nearly all noise, and a step that fits it does worse on fresh episodes.
_LESS_NOISE: dict[str, Any] = {"maml": {"gae_lambda": 0.9, "inner_lr": 0.03, "max_divergence": 0.05}}
_TASKS = {"halfcheetah-vel": 100, "hopper-vel": 40, "walker-vel": 40, "ant-dir": 40}  # the paper's numbers
_FAMILIES: dict[str, dict[str, Any]] = {family: {"task_count": count} for family, count in _TASKS.items()}
# On the hopper the return is level after 40 updates, on the walker it is highest after 30 (seed 0 of each).
_SOON_LEVEL = {family: {**_FAMILIES[family], "epochs": 100} for family in ("hopper-vel", "walker-vel")}
METHOD = Method(
    "maml",
    maml,
    MamlLearner,
    unread=("network.matmul", "network.equivariant", *OF_EMBEDDINGS, *OF_A_TASK_ENCODER, *_OF_SAC),
    presets={
        "paper": {**_EPISODES, "epochs": 1000, "meta_batch": 40},
        "fast": {**_EPISODES, **_LESS_NOISE, "epochs": 300, "meta_batch": 10},
        "smoke": {**_EPISODES, **_LESS_NOISE, "epochs": 20},
    },
    families={"paper": _FAMILIES, "fast": {**_FAMILIES, **_SOON_LEVEL}},
)
