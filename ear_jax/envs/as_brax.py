"""Registration of environments with Brax, made only once somebody imports Brax.

Brax and what it imports take two seconds, and no command of ours needs them.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder
from types import ModuleType
from typing import Any

from ear_jax.envs.environment import Env

BRAX = "brax.envs"


def register_with_brax(environments: Mapping[str, type[Env]]) -> None:
    """Makes environments available as `brax.envs.get_environment(name)`, at once if Brax is imported or else then."""

    def register(brax_envs: Any) -> None:
        brax_envs.Env.register(Env)
        for name, environment in environments.items():
            brax_envs.register_environment(name, environment)

    if BRAX in sys.modules:
        register(sys.modules[BRAX])
    else:
        sys.meta_path.insert(0, _AfterImport(register))


class _AfterImport(MetaPathFinder):
    """Finds `brax.envs` where Python would, and calls a function with the module once it has run."""

    def __init__(self, call: Callable[[ModuleType], None]):
        self._call = call

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        if fullname != BRAX:
            return None
        spec = PathFinder.find_spec(fullname, path, target)
        loader: Any = spec and spec.loader
        if loader:
            run = loader.exec_module

            def run_and_call(module: ModuleType) -> None:
                run(module)
                self._call(module)

            loader.exec_module = run_and_call
        return spec
