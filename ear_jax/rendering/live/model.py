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
from ear_jax.physics.models import compile_model, moving_numbers

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
    numbers, others = moving_numbers(one), moving_numbers(other)
    pairs = [(numbers[name], others[name]) for name in numbers if name != "geom_margin"]
    return all(
        left.shape == right.shape and np.allclose(left, right, rtol=TOLERANCE, atol=1e-6) for left, right in pairs
    )
