"""The user's environment: settings and variables under which JAX or MuJoCo cannot work as this package needs them.

Imports JAX and MuJoCo only in its functions, so that commands can refuse a mistake before these take their seconds.
"""

from __future__ import annotations

import os
from typing import Any

from ear_jax.errors import RunError
from ear_jax.process.memory import check_start

# Settings of JAX that change results or the layout of a saved state, or under which the code fails; and values needed.
NEEDED: dict[str, Any] = {
    "jax_enable_x64": False,
    "jax_disable_jit": False,
    "jax_default_prng_impl": "threefry2x32",
    "jax_threefry_partitionable": True,
    "jax_random_seed_offset": 0,
    "jax_high_dynamic_range_gumbel": False,
    "jax_numpy_dtype_promotion": "standard",
    "jax_numpy_rank_promotion": "allow",
}

THEIRS = ("JAX_", "XLA_", "CUDA_", "MUJOCO_", "PYOPENGL_")  # beginnings of variables that the two read


def start_jax() -> None:
    """Imports JAX and MuJoCo and turns on the compilation cache; raises RunError, in one line, if they cannot work."""
    check_start()
    for problem in problems():
        raise RunError(problem)
    from ear_jax.process.runtime import enable_cache

    enable_cache()


def problems() -> list[str]:
    """Lists in one line each what keeps JAX or MuJoCo from working here, with the variable at fault and the way out."""
    found = []
    try:
        import jax

        found += wrong_settings()
        jax.default_backend()
    except Exception as error:  # any of theirs: they are imported in a process that others set up
        found.append(_blame(error, "JAX", "JAX_PLATFORMS", "JAX_PLATFORMS=cpu"))
    try:
        import mujoco  # noqa: F401
    except Exception as error:
        found.append(_blame(error, "MuJoCo", "MUJOCO_GL", "MUJOCO_GL=egl"))
    return found


def check_settings() -> None:
    """Raises RunError for the first setting of JAX that `wrong_settings` finds."""
    for problem in wrong_settings():
        raise RunError(problem)


def wrong_settings() -> list[str]:
    """Lists settings of JAX with values that must not leak into a run: those that change its state or its numbers."""
    import jax

    found = []
    for name, needed in NEEDED.items():
        value = getattr(jax.config, name, needed)
        plain = getattr(value, "value", value)  # of an enumeration
        if plain == needed:
            continue
        variable = name.upper()
        if variable in os.environ:
            found.append(f"{variable}={os.environ[variable]} does not work with ear_jax; unset the variable")
        else:
            found.append(f'{name} is {plain}; ear_jax needs jax.config.update("{name}", {needed!r})')
    return found


def _blame(error: Exception, package: str, variable: str, instead: str) -> str:
    """Returns one line about a failure to start a package, with the variable that is the likely reason."""
    reason = next(iter(str(error).splitlines()), "its plugin or device is missing")
    way_out = f"unset it, or set {instead}"
    for name in [name for name in os.environ if name.startswith(THEIRS) and name in reason]:
        return f"{name}={os.environ[name]} does not work here: {reason}; unset it"
    if os.environ.get(variable):
        return f"{variable}={os.environ[variable]} does not work here ({package}: {reason}); {way_out}"
    return f"{package} cannot start here: {reason}"
