"""The methods, one file each, which defines METHOD. A new one needs a line in `ear_jax/names.py`."""

from __future__ import annotations

from importlib import import_module

from ear_jax.agents import Agent, standardised
from ear_jax.config import Config
from ear_jax.errors import known_name
from ear_jax.methods.method import Method, Sizes
from ear_jax.names import METHOD_FILES, name_of

__all__ = ["METHODS", "Method", "Sizes", "find_method", "make_agent"]

METHODS: dict[str, Method] = {name_of(file): import_module(f"{__name__}.{file}").METHOD for file in METHOD_FILES}


def find_method(name: str) -> Method:
    """Returns a method by name; raises UsageError for an unknown name."""
    return METHODS[known_name("agent", name, METHODS)]


def make_agent(sizes: Sizes, config: Config) -> Agent:
    """Builds the agent of `config.agent`, which standardises observations; raises UsageError for an unknown name."""
    return standardised(find_method(config.agent).build(sizes, config), sizes.obs)
