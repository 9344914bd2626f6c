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
    sizes = ("nq", "nv", "nu", "nbody", "njnt", "ngeom", "nmocap", "neq", "ntendon")
    if any(getattr(one, size) != getattr(other, size) for size in sizes):
        return False
    options = ("timestep", "integrator", "cone", "solver", "gravity", "iterations")
    if not all(np.allclose(getattr(one.opt, name), getattr(other.opt, name)) for name in options):
        return False
    for name in dir(one):
        if name.startswith(("body_", "jnt_", "dof_", "actuator_", "geom_", "eq_", "qpos")) and name != "geom_margin":
            left, right = getattr(one, name), getattr(other, name)
            if not isinstance(left, np.ndarray) or not np.issubdtype(left.dtype, np.floating):
                continue
            if left.shape != right.shape or not np.allclose(left, right, rtol=TOLERANCE, atol=1e-6):
                return False
    return True
