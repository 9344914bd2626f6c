"""Emergent action representations: one policy for many tasks, trained end to end in JAX on MuJoCo.

    import ear_jax

    ear_jax.train_run(ear_jax.preset_config("halfcheetah-vel", "fast"), Path("runs/mine"))
    trained = ear_jax.load(Path("runs/mine"))

Names below are imported when they are first used. `docs/architecture.md` says which room holds what; the `ear` command
is the same functions from a shell.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from ear_jax.gymnasium_ids import REGISTRATION, register_families
from ear_jax.process.after_import import after_import

if TYPE_CHECKING:
    from ear_jax.agents.tanh_gaussian import squash
    from ear_jax.embeddings.codes import blend, slerp
    from ear_jax.embeddings.evaluate import evaluate, evaluate_code
    from ear_jax.envs import Family, make_family
    from ear_jax.presets import preset_config
    from ear_jax.runs.loop import train_run
    from ear_jax.runs.trained import Trained, load

__version__ = "0.2.0"
__all__ = [
    "Family",
    "Trained",
    "blend",
    "evaluate",
    "evaluate_code",
    "load",
    "make_family",
    "preset_config",
    "slerp",
    "squash",
    "train_run",
]

_MODULES = {
    "ear_jax.agents.tanh_gaussian": ("squash",),
    "ear_jax.embeddings.codes": ("blend", "slerp"),
    "ear_jax.embeddings.evaluate": ("evaluate", "evaluate_code"),
    "ear_jax.envs": ("Family", "make_family"),
    "ear_jax.presets": ("preset_config",),
    "ear_jax.runs.loop": ("train_run",),
    "ear_jax.runs.trained": ("Trained", "load"),
}
_HOMES = {name: module for module, names in _MODULES.items() for name in names}

after_import(REGISTRATION, register_families)


def __getattr__(name: str) -> Any:
    """Imports a public name when it is first asked for."""
    if name not in _HOMES:
        raise AttributeError(f"module 'ear_jax' has no attribute {name!r}")
    return getattr(importlib.import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return sorted([*globals(), *_HOMES])
