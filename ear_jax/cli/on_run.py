"""What every command on a trained run takes, and how it is read."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from ear_jax.config import MAX_SEED
from ear_jax.errors import UsageError
from ear_jax.process.runtime import enable_cache
from ear_jax.runs.trained import Trained, check_policy, load


@dataclass(frozen=True, kw_only=True)
class OnRun:
    """What every command takes that plays a trained policy."""

    run: tyro.conf.Positional[Annotated[Path, tyro.conf.arg(metavar="RUN")]]
    """The run directory, an exported file, or pretrained:NAME."""
    seed: int = 0
    """Seeds the starts, which no training step has seen, and all else that is drawn."""
    family: str | None = None
    """A family of your own has to be named again, as for `ear train`."""
    engine: str | None = None
    """Physics engine: auto, native (CPU), mjx or warp; by default the run's own."""
    json: bool = False
    """Print one JSON document and nothing else."""

    def load(self) -> Trained:
        """The run; raises as `trained.load` does, and UsageError for a seed that is none."""
        if not 0 <= self.seed < MAX_SEED:
            raise UsageError(f"--seed {self.seed} is out of range; it must be from 0 to {MAX_SEED - 1}")
        enable_cache()
        return load(self.run, self.family, self.engine)


@dataclass(frozen=True, kw_only=True)
class OnPolicy(OnRun):
    """What a command takes besides that shows one of a run's policies."""

    policy: int = 0
    """Of a run of several seeds, whose policy: 0 is the first."""

    def load(self) -> Trained:
        """The run; raises as `OnRun.load` does, and UsageError for a policy that it does not have."""
        trained = super().load()
        check_policy(trained, self.policy)
        return trained
