"""The platform that programs are traced for: some parts are written otherwise for an accelerator than for a CPU."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from contextvars import ContextVar
from typing import Any

import jax

_target: ContextVar[str | None] = ContextVar("target", default=None)


def on_accelerator() -> bool:
    """Returns whether programs traced now are for an accelerator: JAX's default device, or as `tracing_for` says."""
    return (_target.get() or jax.default_backend()) != "cpu"


@contextmanager
def tracing_for(platform: str) -> Iterator[None]:
    """Traces programs within as for another platform, `gpu` or `cpu`, than that of JAX's default device."""
    token = _target.set(platform)
    try:
        yield
    finally:
        _target.reset(token)


def exact_matmul() -> AbstractContextManager[Any]:
    """Makes an accelerator multiply float32 within, where by default it rounds factors to 10 bits (TF32)."""
    return jax.default_matmul_precision("highest") if on_accelerator() else nullcontext()
