"""Family names, here and in Brax's registry."""

from __future__ import annotations

from ear_jax.envs.family import Family
from ear_jax.envs.halfcheetah_vel import HalfCheetahVel
from ear_jax.errors import unknown
from ear_jax.quiet import register_environment

FAMILIES: dict[str, type[Family]] = {"halfcheetah-vel": HalfCheetahVel}

for _name, _family in FAMILIES.items():
    register_environment("ear_" + _name.replace("-", "_"), _family)


def make_family(name: str, engine: str = "auto") -> Family:
    """A family by name, on an engine.

    Raises:
      UsageError: there is no such family or engine.
      RunError: the engine cannot run here.
    """
    if name not in FAMILIES:
        raise unknown("family", name, FAMILIES)
    return FAMILIES[name](engine=engine)
