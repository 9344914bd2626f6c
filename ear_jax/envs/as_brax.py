"""Registration of environments with Brax, made only once somebody imports Brax.

Brax and what it imports take two seconds, and no command of ours needs them.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ear_jax.envs.environment import Env
from ear_jax.process.after_import import after_import

BRAX = "brax.envs"


def register_with_brax(environments: Mapping[str, type[Env]]) -> None:
    """Makes environments available as `brax.envs.get_environment(name)`, at once if Brax is imported or else then."""

    def register(brax_envs: Any) -> None:
        brax_envs.Env.register(Env)
        for name, environment in environments.items():
            brax_envs.register_environment(name, environment)

    after_import(BRAX, register)
