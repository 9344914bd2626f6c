"""The interface of a method: its agent, its learner, the settings it ignores, its presets and its checks."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from fnmatch import fnmatch
from typing import Any

from ear_jax.agents import Agent
from ear_jax.config import Config
from ear_jax.learning.learner import Learner
from ear_jax.learning.sac import SacLearner

# Settings that many methods do not read, as patterns of `fnmatch`.
OF_MAML = ("maml.*",)
OF_META_LEARNING = (*OF_MAML, "meta_batch")
OF_EMBEDDINGS = (
    *("sac.lte_noise", "sac.outcome_weight", "network.normalise_*"),
    *(f"network.{name}" for name in ("lse_size", "lte_start", "encoder_layers", "critic_task")),
)
OF_A_TASK_ENCODER = ("network.lte_size", "network.task_*")


@dataclass(frozen=True)
class Sizes:
    """Sizes of the networks' inputs and outputs."""

    obs: int  # the agent's input, `network.history` observations together
    action: int
    tasks: int
    outcomes: int = 0  # that a step yields; read by agents that predict them


def _accept(config: Config) -> None:
    """Accepts every configuration."""


@dataclass(frozen=True)
class Method:
    """One method of multi-task learning, found by its name in `METHODS`."""

    name: str
    build: Callable[[Sizes, Config], Agent]
    learner: type[Learner] = SacLearner  # trains the agent
    unread: tuple[str, ...] = OF_META_LEARNING  # patterns of settings that neither the agent nor the learner reads
    # Preset, or variant of a preset → settings changed for this method.
    presets: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    families: Mapping[str, Mapping[str, Mapping[str, Any]]] = field(default_factory=dict)  # the same of single families
    check: Callable[[Config], None] = _accept  # raises UsageError for settings it does not support

    def reads(self, setting: str) -> bool:
        """Returns whether a setting, such as `sac.lr`, has an effect on this method."""
        return not any(fnmatch(setting, pattern) for pattern in self.unread)
