"""Imports whose output is discarded: MuJoCo XLA reports on stdout that Warp is missing, which would corrupt JSON."""

from __future__ import annotations

import contextlib
import io

with contextlib.redirect_stdout(io.StringIO()):
    from brax.envs import register_environment
    from brax.envs.base import Env, State
    from mujoco import mjx

__all__ = ["Env", "State", "mjx", "register_environment"]
