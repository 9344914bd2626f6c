"""MuJoCo XLA, imported without its output: it reports on stdout that Warp is missing, which would corrupt JSON.

It takes two seconds, so only functions that use it import this module.
"""

from __future__ import annotations

import contextlib
import io

with contextlib.redirect_stdout(io.StringIO()):
    from mujoco import mjx

__all__ = ["mjx"]
