"""Imports that print: MuJoCo XLA, which Brax imports too, says on stdout that Warp is missing and would spoil JSON."""

from __future__ import annotations

import contextlib
import io

with contextlib.redirect_stdout(io.StringIO()):
    from brax.envs import register_environment
    from brax.envs.base import Env, State
    from mujoco import mjx

__all__ = ["Env", "State", "mjx", "register_environment"]
