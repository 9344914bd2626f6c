"""PEARL: a task's code is inferred from experience in the task."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp

from ear_jax.agents import Agent
from ear_jax.agents.critic import task_critic
from ear_jax.agents.networks import Params, mlp
from ear_jax.agents.posterior import Context, Posterior, product
from ear_jax.agents.tanh_gaussian import Gaussian, gaussian
from ear_jax.config import Config
from ear_jax.errors import UsageError
from ear_jax.learning.pearl import PearlLearner
from ear_jax.methods.method import OF_EMBEDDINGS, OF_MAML, Method, Sizes

MIN_VARIANCE = 1e-7  # of the factor of a single step


def pearl(sizes: Sizes, config: Config) -> Agent:
    """Builds PEARL (Rakelly et al. 2019, arXiv 1903.08254; katerakelly/oyster) for this trainer.

    An encoder maps each step (s, a, r) to a factor; the product of factors is the posterior over the task's code.
    Critics see a sampled code in place of the one-hot, and their loss trains the encoder. The policy sees the code
    without passing gradients to it. The original has a state value and a fixed temperature; here critics and
    temperature are SAC's. `task_width` and `task_layers` are the encoder's, `lte_size` is the code's size.
    """
    network, size = config.network, config.network.lte_size
    task_widths = (network.task_width,) * network.task_layers
    encoder = mlp(sizes.obs + sizes.action + 1, task_widths, 2 * size, network)
    actor = mlp(sizes.obs + size, (network.width,) * network.decoder_layers, 2 * sizes.action, network)

    def init_policy(key: jax.Array) -> Params:
        key_encoder, key_actor = jax.random.split(key)
        return {"encoder": encoder.init(key_encoder), "actor": actor.init(key_actor)}

    def infer(policy: Params, context: Context) -> Posterior:
        steps = jnp.concatenate([context.obs, context.action, context.reward[:, None]], axis=1)
        mean, spread = jnp.split(jax.vmap(lambda step: encoder.apply(policy["encoder"], step))(steps), 2, axis=1)
        return product(mean, jnp.maximum(jax.nn.softplus(spread), MIN_VARIANCE), context.valid)

    def distribution(policy: Params, code: jax.Array, obs: jax.Array) -> Gaussian:
        return gaussian(actor.apply(policy["actor"], jnp.concatenate([obs, code])))

    return Agent(
        code_size=size,
        init_policy=init_policy,
        codes=lambda policy: jnp.zeros((sizes.tasks, size)),
        project=lambda code: code,
        distribution=distribution,
        critic=task_critic(sizes.obs, sizes.action, size, config),
        infer=infer,
    )


def check(config: Config) -> None:
    """Raises UsageError for a scale of reward that changes: the encoder reads rewards, in new tasks too."""
    if config.sac.return_scale:
        raise UsageError(
            "--sac.return-scale does not go with pearl, whose encoder reads rewards; use --sac.reward-scale"
        )


_ENCODER: dict[str, Any] = {"lte_size": 5, "task_width": 200, "task_layers": 3}
# The paper's numbers of tasks. An epoch has about as many steps as the other methods', and replay 100 epochs.
_FAMILIES: dict[str, dict[str, Any]] = {
    "halfcheetah-vel": {"task_count": 100, "collect": {"envs": 1}, "replay": {"capacity": 250_000}},
    "hopper-vel": {"task_count": 20, "collect": {"envs": 4}},
    "walker-vel": {"task_count": 20, "collect": {"envs": 4}},
    "ant-dir": {"task_count": 100, "collect": {"envs": 2}, "replay": {"capacity": 500_000}},
}
METHOD = Method(
    "pearl",
    pearl,
    PearlLearner,
    unread=("network.equivariant", *OF_MAML, *OF_EMBEDDINGS),
    presets={
        "paper": {
            "network": {**_ENCODER, "width": 300, "decoder_layers": 3, "critic_layers": 3},
            "sac": {"reward_scale": 5.0},
            "meta_batch": 16,
        },
        "fast": {"network": _ENCODER, "meta_batch": 10},
        "smoke": {"network": _ENCODER},
    },
    families={
        "paper": {family: {"task_count": changes["task_count"]} for family, changes in _FAMILIES.items()},
        "fast": _FAMILIES,
    },
    check=check,
)
