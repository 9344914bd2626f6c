"""Agents: networks, critics and action distributions, as pure functions of parameters."""

from ear_jax.agents.agent import Agent, standardised

__all__ = ["Agent", "standardised"]
