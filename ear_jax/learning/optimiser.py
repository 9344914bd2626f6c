"""The optimiser of all networks that SAC trains. Only this file has to change to replace it."""

from __future__ import annotations

import jax
import optax

from ear_jax.agents.networks import Params, is_kernel
from ear_jax.config import SacConfig, is_on

FINAL_LR = 0.1  # factor on the step size at the end of its decay


def make_optimiser(config: SacConfig) -> optax.GradientTransformation:
    """Returns Adam, or AdamW, on gradients clipped by global norm.

    The step size falls linearly over `lr_decay` updates.
    """
    lr = optax.linear_schedule(config.lr, FINAL_LR * config.lr, config.lr_decay) if config.lr_decay else config.lr
    decays = is_on(config.weight_decay)
    adam = optax.adamw(lr, weight_decay=config.weight_decay, mask=_kernels) if decays else optax.adam(lr)
    return optax.chain(optax.clip_by_global_norm(config.max_grad_norm), adam)


def _kernels(params: Params) -> Params:
    """Marks the weights that decay."""
    return jax.tree_util.tree_map_with_path(lambda path, _: is_kernel(path), params)
