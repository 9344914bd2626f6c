"""The options shared by all commands that take a trained run."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from ear_jax import pretrained
from ear_jax.cli.arguments import option
from ear_jax.config import MAX_SEED
from ear_jax.errors import UsageError, known_name
from ear_jax.names import ENGINES, family_name
from ear_jax.process.environment import start_jax
from ear_jax.process.terminal import sign_of_life
from ear_jax.runs import records
from ear_jax.runs.directory import is_run

if TYPE_CHECKING:
    from ear_jax.runs.trained import Trained


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
    """Physics engine: auto, native (CPU), mjx, mjx-fixed or warp."""
    json: bool = False
    """Print one JSON document and nothing else."""

    def load(self) -> Trained:
        """Loads the run, after the checks that need no JAX.

        Raises:
          UsageError, RunError: as `trained.load`, or JAX cannot work here; UsageError also for a seed out of range.
        """
        if not 0 <= self.seed < MAX_SEED:
            raise UsageError(f"--seed {self.seed} is out of range; it must be from 0 to {MAX_SEED - 1}")
        engine = None if self.engine is None else known_name("engine", self.engine, ("auto", *ENGINES))
        return load_run(self.run, self.family, engine)


def load_run(run: Path, family: str | None, engine: str | None) -> Trained:
    """Loads a run as `trained.load` does, and shows meanwhile that it works; what cannot be is refused before JAX."""
    check_run(run)
    family = None if family is None else family_name(family)
    with sign_of_life(f"loading {run}"):
        start_jax()
        from ear_jax.runs.trained import load

        return load(run, family, engine)


def check_run(run: Path) -> None:
    """Raises UsageError or RunError if there is neither a run, a file nor a pretrained agent of that name."""
    if str(run).startswith(pretrained.PREFIX):
        pretrained.card(str(run).removeprefix(pretrained.PREFIX))
    elif not (run.is_file() or is_run(run)):
        records.read_run(run)


@dataclass(frozen=True, kw_only=True)
class OnPolicy(OnRun):
    """The options of commands that show one of a run's policies."""

    policy: int = 0
    """The policy to show of a run with several seeds; 0 is the first seed's."""

    def load(self) -> Trained:
        """Loads the run; raises as `OnRun.load` does, and UsageError for a policy out of range."""
        trained = super().load()
        from ear_jax.runs.trained import check_policy

        check_policy(trained, self.policy)
        return trained
