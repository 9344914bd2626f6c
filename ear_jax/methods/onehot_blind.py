"""OHE-SAC with its one-hot zeroed: a baseline that does not know the task."""

from __future__ import annotations

from dataclasses import replace

import jax.numpy as jnp

from ear_jax.agents import Agent
from ear_jax.agents.critic import seen_as
from ear_jax.config import Config
from ear_jax.methods.method import Method, Sizes
from ear_jax.methods.onehot import UNREAD, onehot


def onehot_blind(sizes: Sizes, config: Config) -> Agent:
    """Builds OHE-SAC whose policy and critics see zeros in place of the one-hot.

    The authors' older code trains this by mistake, as its replay stores zeros for the one-hot. That would explain the
    paper's returns of OHE-SAC.
    """
    seeing = onehot(sizes, config)
    assert seeing.critic
    return replace(
        seeing,
        codes=lambda policy: jnp.zeros((sizes.tasks, sizes.tasks)),
        project=jnp.zeros_like,
        critic=seen_as(seeing.critic, lambda obs, action, task: (obs, action, jnp.zeros_like(task))),
        on_sphere=False,
        one_hot=False,
    )


METHOD = Method("onehot-blind", onehot_blind, unread=(*UNREAD, "network.equivariant"))
