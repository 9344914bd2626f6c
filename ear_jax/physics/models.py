"""Gymnasium's MuJoCo models, read from the installed package and never copied."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import mujoco
import numpy as np

from ear_jax.errors import RunError, UsageError, unknown


def package_directory(name: str) -> Path | None:
    """Returns an installed package's directory without importing it; None if it is not installed."""
    spec = importlib.util.find_spec(name)
    return Path(spec.submodule_search_locations[0]) if spec and spec.submodule_search_locations else None


def gymnasium_model_path(filename: str) -> Path:
    """Returns the path of a model in the installed `gymnasium`, without importing its environments.

    Raises:
      UsageError: it has no such model.
      RunError: it is not installed.
    """
    package = package_directory("gymnasium")
    if package is None:
        raise RunError("the models come from the 'gymnasium' package, which is not installed: pip install gymnasium")
    path = package / "envs" / "mujoco" / "assets" / filename
    if not path.is_file():
        error = unknown("model", filename, [model.name for model in path.parent.glob("*.xml")])
        raise UsageError(f"{error}; for a model of your own, define load() to return its mujoco.MjModel")
    return path


def load_model(filename: str) -> mujoco.MjModel:
    """Compiles one of Gymnasium's models, e.g. `half_cheetah.xml`."""
    return compile_model(mujoco.MjSpec.from_file(str(gymnasium_model_path(filename))))


SIZES = ("nq", "nv", "nu", "na", "nbody", "njnt", "ngeom", "nmocap", "neq", "ntendon", "nexclude", "npair")
MOVING = (
    *("body_", "jnt_", "dof_", "geom_", "eq_", "tendon_", "wrap_", "exclude_", "pair_"),
    *("actuator_", "qpos"),
)
SEEN = ("_rgba", "_matid", "_group", "_user")  # endings of what only pictures and users read


def moving_numbers(model: mujoco.MjModel) -> dict[str, np.ndarray]:
    """Returns the numbers of a model that say how it moves, by name: its sizes, options and arrays."""
    names = [name for name in dir(model) if name.startswith(MOVING) and not name.endswith(SEEN)]
    numbers = {name: getattr(model, name) for name in (*SIZES, *names)}
    numbers |= {f"opt.{name}": getattr(model.opt, name) for name in dir(model.opt) if not name.startswith("_")}
    arrays = {name: np.asarray(value) for name, value in numbers.items()}
    return {
        name: value for name, value in arrays.items() if value.dtype == bool or np.issubdtype(value.dtype, np.number)
    }


def compile_model(spec: mujoco.MjSpec) -> mujoco.MjModel:
    """Compiles a model made for MuJoCo 3.3 or older, as Gymnasium's are.

    MuJoCo warns about the deprecated `settotalmass` in a MUJOCO_LOG.TXT in the user's directory. The mass is therefore
    set on the compiled model, with identical constants.

    A contact's margin is the sum of its two geoms' margins in MuJoCo 3.14 and later, and was the larger one up to 3.3.
    All geoms of these models have equal margins, so halving them restores the intended physics; otherwise the ant
    stands 1 cm higher.
    """
    total_mass = spec.compiler.settotalmass
    spec.compiler.settotalmass = -1
    model = spec.compile()
    if total_mass > 0:
        mujoco.mj_setTotalmass(model, total_mass)
        mujoco.mj_setConst(model, mujoco.MjData(model))
    model.geom_margin[:] /= 2
    return model
