"""The families' names in Gymnasium: `gymnasium.make_vec("ear_jax/HalfCheetahVel-v0", num_envs=10)`.

`import ear_jax` registers them once Gymnasium is imported, before or after it; neither imports the other.
"""

from __future__ import annotations

from typing import Any

CAPITALS = {"halfcheetah": "HalfCheetah"}
REGISTRATION = "gymnasium.envs.registration"
MODULE = "ear_jax.envs.as_gymnasium"


def gymnasium_id(family: str) -> str:
    """Returns a family's name in Gymnasium: ear_jax/AntDir-v0 for ant-dir."""
    words = (CAPITALS.get(word, word.capitalize()) for word in family.split("-"))
    return f"ear_jax/{''.join(words)}-v0"


def register_families(registration: Any) -> None:
    """Registers all families with Gymnasium; ear_jax/Family-v0 takes any family by name, as `ear train` does.

    Args:
      registration: Gymnasium's module `REGISTRATION`.
    """
    from ear_jax.names import FAMILIES

    ids = {"ear_jax/Family-v0": {}, **{gymnasium_id(family): {"family": family} for family in FAMILIES}}
    for name, arguments in ids.items():
        registration.register(
            name,
            entry_point=f"{MODULE}:FamilyEnv",
            vector_entry_point=f"{MODULE}:FamilyVectorEnv",
            kwargs=dict(arguments),
        )
