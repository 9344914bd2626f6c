"""The choice between XLA's kernels and our own."""

from __future__ import annotations

from ear_jax.config import Config, is_on
from ear_jax.errors import UsageError
from ear_jax.fused.blocks import CHUNK
from ear_jax.fused.launch import LEAST_ROWS
from ear_jax.fused.learner import FusedSacLearner
from ear_jax.learning.learner import Learner
from ear_jax.learning.sac import SacLearner
from ear_jax.process.target import on_accelerator

MAX_WIDTH, MAX_LAYERS = 512, 3
PROVEN = False  # true once `benchmarks.gpu` has shown an update at least 1.5 times as fast on a GPU


def choose_learner(learner: type[Learner], config: Config) -> type[Learner]:
    """Returns the learner that `network.kernels` asks for, in place of a method's own.

    `auto` takes fused kernels on an accelerator where they apply, once `PROVEN` says that they are faster there.

    Raises:
      UsageError: fused kernels are asked for and do not apply.
    """
    asked = config.network.kernels
    if asked == "xla" or (asked == "auto" and not (PROVEN and on_accelerator())):
        return learner
    reason = why_not(learner, config)
    if reason and asked == "fused":
        raise UsageError(f"--network.kernels fused: {reason}; try --network.kernels xla")
    return learner if reason else FusedSacLearner


def why_not(learner: type[Learner], config: Config) -> str | None:
    """Returns why fused kernels do not apply to a configuration; None if they do."""
    network, sac = config.network, config.sac
    depths = {name: getattr(network, f"{name}_layers") for name in ("encoder", "decoder", "critic")}
    if learner is not SacLearner or config.agent != "ear":
        return f"they are for agent ear, not {config.agent}"
    if network.width % CHUNK or network.width > MAX_WIDTH:
        return f"--network.width {network.width} is not a multiple of {CHUNK} up to {MAX_WIDTH}"
    for name, depth in depths.items():
        if not 1 <= depth <= MAX_LAYERS:
            return f"--network.{name}-layers {depth} is not from 1 to {MAX_LAYERS}"
    other = network.critic_blocks or network.critic_bins or network.critic_batch_norm
    if not network.critic_layer_norm or other:
        return "critics need LayerNorm, and neither residual blocks, bins nor BatchNorm"
    for name in ("weight_decay", "outcome_weight"):
        if is_on(getattr(sac, name)):
            return f"they have no --sac.{name.replace('_', '-')}"
    if sac.batch_size // sac.policy_share % LEAST_ROWS:
        return f"a batch of {sac.batch_size // sac.policy_share} is not a multiple of {LEAST_ROWS}"
    return None
