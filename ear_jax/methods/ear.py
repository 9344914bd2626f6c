"""EAR-SAC: one policy conditioned on a learnt embedding of the task."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from ear_jax.agents import Agent
from ear_jax.agents.critic import task_critic
from ear_jax.agents.networks import Params, mlp, unit_vector
from ear_jax.agents.tanh_gaussian import Gaussian, gaussian
from ear_jax.config import Config, is_on
from ear_jax.methods.method import Method, Sizes
from ear_jax.process.target import exact_matmul


def ear(sizes: Sizes, config: Config) -> Agent:
    """Builds EAR-SAC (paper, section 3.1): ψ(φ(s), LTE), both embeddings on unit spheres; critics see the one-hot.

    `sac.lte_noise` is the σ of the noise added to an LTE before it is normalised again (algorithm 1).
    """
    network = config.network
    widths = (network.width,)
    encoder = mlp(sizes.obs, widths * network.encoder_layers, network.lse_size, network)
    task_widths, gathered = (network.task_width,) * network.task_layers, network.lte_start == "gathered"
    task_encoder = mlp(sizes.tasks, task_widths, network.lte_size, network, gathered=gathered)
    decoder = mlp(network.lse_size + network.lte_size, widths * network.decoder_layers, 2 * sizes.action, network)
    task_sizes = {"onehot": sizes.tasks, "lte": network.lte_size, "both": sizes.tasks + network.lte_size}
    task_size, one_hot = task_sizes[network.critic_task], 0 if network.critic_task == "lte" else sizes.tasks
    on_lse_sphere = unit_vector if network.normalise_lse else lambda lse: lse
    on_lte_sphere = unit_vector if network.normalise_lte else lambda lte: lte

    forecasts = is_on(config.sac.outcome_weight)
    predictor = mlp(network.lse_size + sizes.action, widths, network.lse_size + sizes.outcomes, network)

    def init_policy(key: jax.Array) -> Params:
        key_encoder, key_task, key_decoder = jax.random.split(key, 3)
        own = {"predictor": predictor.init(jax.random.fold_in(key, 3))} if forecasts else {}
        return {
            "encoder": encoder.init(key_encoder),
            "task_encoder": task_encoder.init(key_task),
            "decoder": decoder.init(key_decoder),
            **own,
        }

    def codes(policy: Params) -> jax.Array:
        one_hots = jnp.eye(sizes.tasks)
        with exact_matmul():  # a row of the weights for each task, and not the row rounded
            return jax.vmap(lambda task: on_lte_sphere(task_encoder.apply(policy["task_encoder"], task)))(one_hots)

    def embed(policy: Params, obs: jax.Array) -> jax.Array:
        return on_lse_sphere(encoder.apply(policy["encoder"], obs))

    def distribution(policy: Params, code: jax.Array, obs: jax.Array) -> Gaussian:
        return gaussian(decoder.apply(policy["decoder"], jnp.concatenate([embed(policy, obs), code])))

    def forecast(policy: Params, obs: jax.Array, action: jax.Array) -> tuple[jax.Array, jax.Array]:
        predicted = predictor.apply(policy["predictor"], jnp.concatenate([embed(policy, obs), action]))
        return predicted[: network.lse_size], predicted[network.lse_size :]

    return Agent(
        code_size=network.lte_size,
        init_policy=init_policy,
        codes=codes,
        project=on_lte_sphere,
        distribution=distribution,
        critic=task_critic(sizes.obs, sizes.action, task_size, config, one_hot),
        code_noise=config.sac.lte_noise,
        on_sphere=network.normalise_lte,
        critic_task=network.critic_task,
        embed=embed,
        forecast=forecast if forecasts else None,
    )


# LTEs of neighbouring tasks then end as neighbours.
GATHERED = {"network": {"lte_start": "gathered"}}
METHOD = Method("ear", ear, presets={"equivariant": GATHERED})
