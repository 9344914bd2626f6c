"""The MuJoCo model as text that the browser's MuJoCo compiles."""

from __future__ import annotations

import contextlib
import tempfile
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from ear_jax.envs import Family
from ear_jax.errors import RunError, UsageError
from ear_jax.physics.models import compile_model

TOLERANCE = 1e-4  # relative; MJCF has six digits
# Parts of a model that move it, and of these what is only seen, or set after compiling.
MOVING = (
    *("nq", "nv", "nu", "na", "nbody", "njnt", "ngeom", "nmocap", "neq", "ntendon", "nexclude", "npair"),
    *("body_", "jnt_", "dof_", "geom_", "eq_", "tendon_", "wrap_", "exclude_", "pair_", "actuator_", "qpos"),
)
UNMOVING = ("geom_margin", "geom_rgba", "geom_matid", "geom_group", "tendon_rgba", "tendon_matid", "tendon_group")
DEFAULT = ' input="pos"'  # of actuators: this MuJoCo writes it, and the browser's refuses it


def portable(family: Family) -> dict[str, Any]:
    """Returns a family's model as MJCF, `xml`, with the `margins` that its geoms get after compiling.

    Raises:
      UsageError: the model cannot be written as MJCF, for example because it has meshes.
    """
    for xml in _sources(family):
        try:
            with warnings.catch_warnings(action="ignore"):  # of attributes that MuJoCo itself has written
                rebuilt = compile_model(mujoco.MjSpec.from_string(xml))
        except ValueError:
            continue
        if _same(rebuilt, family.model):
            return {"xml": xml.replace(DEFAULT, ""), "margins": family.model.geom_margin.tolist()}
    raise UsageError("the page cannot rebuild the family's model from MJCF; `source()` may return its text")


def _sources(family: Family) -> Iterator[str]:
    """Yields texts that may be the model's: the family's own, and that of the file which its `load` read last."""
    with contextlib.suppress(AttributeError, UsageError, RunError, OSError):
        yield family.source()
    with tempfile.TemporaryDirectory() as scratch:
        path = Path(scratch) / "model.xml"
        try:
            mujoco.mj_saveLastXML(str(path), family.load())
            yield path.read_text(encoding="utf-8")
        except (mujoco.FatalError, ValueError, OSError):
            return


def _same(one: mujoco.MjModel, other: mujoco.MjModel) -> bool:
    """Returns True if two models agree in all that moves them, except margins."""
    parts = [(one.opt, other.opt, name) for name in dir(one.opt) if not name.startswith("_")]
    parts += [(one, other, name) for name in dir(one) if name.startswith(MOVING) and name not in UNMOVING]
    return all(_equal(getattr(left, name), getattr(right, name)) for left, right, name in parts)


def _equal(one: Any, other: Any) -> bool:
    """Returns whether two values are equal up to the digits of MJCF, if they are numbers."""
    left, right = np.asarray(one), np.asarray(other)
    if not np.issubdtype(left.dtype, np.number) and left.dtype != bool:
        return True
    return left.shape == right.shape and np.allclose(left, right, rtol=TOLERANCE, atol=1e-6)
