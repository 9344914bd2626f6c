"""EAR's critics and policy as Pallas kernels for NVIDIA GPUs, behind SAC's learner; a CPU interprets them."""

from ear_jax.fused.choice import choose_learner, why_not

__all__ = ["choose_learner", "why_not"]
