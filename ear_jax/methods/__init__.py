"""The methods, one file each, which defines METHOD. Adding a method takes that file and a line in `FILES`."""

from __future__ import annotations

from importlib import import_module

from ear_jax.agents import Agent, standardised
from ear_jax.config import Config
from ear_jax.errors import unknown
from ear_jax.methods.method import Method, Sizes

__all__ = ["METHODS", "Method", "Sizes", "find_method", "make_agent"]

FILES = (
    "ear",
    "ear_rnn",
    "onehot",
    "onehot_blind",
    "multihead",
    "pearl",
    "maml",
)
METHODS: dict[str, Method] = {
    method.name: method for method in (import_module(f"{__name__}.{file}").METHOD for file in FILES)
}


def find_method(name: str) -> Method:
    """Returns a method by name; raises UsageError for an unknown name."""
    if name not in METHODS:
        raise unknown("agent", name, METHODS)
    return METHODS[name]


def make_agent(sizes: Sizes, config: Config) -> Agent:
    """Builds the agent of `config.agent`, which standardises observations; raises UsageError for an unknown name."""
    return standardised(find_method(config.agent).build(sizes, config), sizes.obs)
