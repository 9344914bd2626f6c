"""The optimiser of all networks that SAC trains. Only this file has to change to replace it."""

from __future__ import annotations

import optax

from ear_jax.config import SacConfig

FINAL_LR = 0.1  # factor on the step size at the end of its decay


def make_optimiser(config: SacConfig) -> optax.GradientTransformation:
    """Returns Adam on gradients clipped by global norm; its step size falls linearly over `lr_decay` updates."""
    lr = optax.linear_schedule(config.lr, FINAL_LR * config.lr, config.lr_decay) if config.lr_decay else config.lr
    return optax.chain(optax.clip_by_global_norm(config.max_grad_norm), optax.adam(lr))
