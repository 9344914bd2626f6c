"""The options shared by all commands that take a trained run."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from ear_jax.cli.arguments import option
from ear_jax.config import MAX_SEED
from ear_jax.errors import UsageError
from ear_jax.process.runtime import enable_cache
from ear_jax.runs.trained import Trained, check_policy, load


@dataclass(frozen=True, kw_only=True)
class OnRun:
    """The options of every command that plays a trained policy."""

    run: tyro.conf.Positional[Annotated[Path, tyro.conf.arg(metavar="RUN")]]
    """The run directory, an exported file, or pretrained:NAME."""
    seed: int = 0
    """Seed of all randomness; starts are never those of training."""
    family: Annotated[str | None, option("FAMILY", "the run's")] = None
    """The run's family, as for `ear train`; required for a family of your own."""
    engine: Annotated[str | None, option("ENGINE", "the run's")] = None
    """Physics engine: auto, native (CPU), mjx or warp."""
    json: bool = False
    """Print one JSON document and nothing else."""

    def load(self) -> Trained:
        """Loads the run; raises as `trained.load` does, and UsageError for a seed out of range."""
        if not 0 <= self.seed < MAX_SEED:
            raise UsageError(f"--seed {self.seed} is out of range; it must be from 0 to {MAX_SEED - 1}")
        enable_cache()
        return load(self.run, self.family, self.engine)


@dataclass(frozen=True, kw_only=True)
class OnPolicy(OnRun):
    """The options of commands that show one of a run's policies."""

    policy: int = 0
    """The policy to show of a run with several seeds; 0 is the first seed's."""

    def load(self) -> Trained:
        """Loads the run; raises as `OnRun.load` does, and UsageError for a policy out of range."""
        trained = super().load()
        check_policy(trained, self.policy)
        return trained
