"""The robots: Gymnasium's own MuJoCo models, found in the installed package and never copied."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import mujoco

from ear_jax.errors import RunError, unknown


def gymnasium_model_path(filename: str) -> Path:
    """Where the installed `gymnasium` keeps a model, found without importing its environments.

    Raises:
      UsageError: it has no such model.
      RunError: it is not installed.
    """
    spec = importlib.util.find_spec("gymnasium")
    if spec is None or not spec.submodule_search_locations:
        raise RunError("the models come from the 'gymnasium' package, which is not installed: pip install gymnasium")
    path = Path(spec.submodule_search_locations[0]) / "envs" / "mujoco" / "assets" / filename
    if not path.is_file():
        raise unknown("model", filename, [model.name for model in path.parent.glob("*.xml")])
    return path


def load_model(filename: str) -> mujoco.MjModel:
    """Compiles one of Gymnasium's models, e.g. `half_cheetah.xml`.

    `settotalmass` is deprecated and MuJoCo would complain into a MUJOCO_LOG.TXT in the user's directory, so the mass
    is set on the compiled model instead, with identical constants.

    Since 3.17 MuJoCo adds the contact margins of the two geoms that meet, where 3.3 and before took the larger. All
    geoms of one of these models have the same, so half of it is the physics the models were made for; with the whole
    the ant would stand 1 cm higher.
    """
    spec = mujoco.MjSpec.from_file(str(gymnasium_model_path(filename)))
    total_mass = spec.compiler.settotalmass
    spec.compiler.settotalmass = -1
    model = spec.compile()
    if total_mass > 0:
        mujoco.mj_setTotalmass(model, total_mass)
        mujoco.mj_setConst(model, mujoco.MjData(model))
    model.geom_margin[:] /= 2
    return model
