"""The precision of a program's products on the device it runs on, and whether a repeated run has equal bits."""

from __future__ import annotations

import jax

from ear_jax.process.target import on_accelerator


def product(matmul: str = "float32") -> str:
    """Names the precision of hidden layers' products during updates, for `network.matmul`."""
    return "TF32" if matmul == "float32" and on_accelerator() else matmul


def equal_bits(engine: str) -> str:
    """Says in a few words whether two processes that train the same run get equal bits, as far as it is known.

    Args:
      engine: that of the run.
    """
    if on_accelerator():
        return "equal bits not measured"
    return "equal seeds give equal bits" if engine == "native" else f"equal bits not measured with {engine}"


def numbers() -> dict[str, str]:
    """Describes the arithmetic here: by part of the program, and what makes bits equal between processes."""
    if not on_accelerator():
        return {
            "networks": "float32, or bfloat16 in hidden layers with --network.matmul bfloat16",
            "physics": "float32 outside C MuJoCo, which steps in float64",
            "equal_bits": "equal seeds give equal bits on the same processor with the same versions and engine native; "
            "not measured with other engines",
        }
    return {
        "networks": "TF32 products (10 bits of mantissa), or bfloat16 with --network.matmul bfloat16; sums in float32",
        "embeddings": "float32",
        "physics": "float32 in MJX, float64 in C MuJoCo",
        "equal_bits": f"not measured on {jax.local_devices()[0].device_kind}: kernels are chosen by timing them, and a "
        "fresh compilation cache may choose others",
    }
