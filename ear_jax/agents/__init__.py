"""Agents: the methods, one file each, found by name."""

from __future__ import annotations

from ear_jax.agents.agent import Agent, standardised
from ear_jax.agents.ear import ear
from ear_jax.agents.ear_rnn import ear_rnn
from ear_jax.agents.maml import maml
from ear_jax.agents.multihead import multihead
from ear_jax.agents.onehot import onehot, onehot_blind
from ear_jax.agents.pearl import pearl
from ear_jax.config import NetworkConfig
from ear_jax.errors import unknown

__all__ = ["AGENTS", "Agent", "make_agent"]

AGENTS = {
    "ear": ear,
    "ear-rnn": ear_rnn,
    "onehot": onehot,
    "onehot-blind": onehot_blind,
    "multihead": multihead,
    "pearl": pearl,
    "maml": maml,
}


def make_agent(
    name: str, obs_size: int, action_size: int, tasks: int, config: NetworkConfig, lte_noise: float
) -> Agent:
    """An agent by name; raises UsageError where there is none."""
    if name not in AGENTS:
        raise unknown("agent", name, AGENTS)
    return standardised(AGENTS[name](obs_size, action_size, tasks, config, lte_noise), obs_size)
