"""What of the paper is there: the records of runs, told apart by their settings. Imports no JAX.

A record is a run directory without its checkpoints, of one seed or of several side by side: `config.json`,
`metrics.jsonl`, the policy as `ear export` writes it, and a JSON document an analysis, with its picture where that is
kept.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path

from ear_jax import records
from ear_jax.config import Config, from_dict, run_name
from ear_jax.errors import UsageError
from ear_jax.presets import preset_config
from experiments.paper import Analysis, Experiment, Method

RECORDS = Path(__file__).with_name("records")
POLICY = "policy.safetensors"
BUDGET = ("seeds", "epochs", "minutes", "engine", "log", "checkpoint")  # settings by which a run is no other run


@dataclass(frozen=True)
class Job:
    """One seed of a method, and the analyses that are wanted of it."""

    config: Config
    analyses: tuple[Analysis, ...]

    @property
    def name(self) -> str:
        return run_name(self.config)

    @property
    def record(self) -> Path:
        """Where it is recorded: by itself or, if it is not, with the seeds that it was trained beside."""
        alone, method = RECORDS / self.name, self.name.removesuffix(str(self.config.seed))
        if not alone.exists():
            for together in sorted(RECORDS.glob(f"{method}s*-*")):
                first, last = map(int, together.name.removeprefix(f"{method}s").split("-"))
                if first <= self.config.seed <= last:
                    return together
        return alone

    @property
    def policy(self) -> Path:
        """Where the record has what the run has learnt."""
        return self.record / POLICY


def jobs(experiment: Experiment, preset: str, seeds: int | None = None, minutes: float | None = None) -> list[Job]:
    """All that an experiment needs under a preset.

    Args:
      experiment: which.
      preset: a preset's name.
      seeds: how many; by default the experiment's.
      minutes: where to stop each run; by default the preset's epochs decide.
    """

    def job(method: Method, seed: int) -> Job:
        config = preset_config(method.family, preset + method.ablation, method.agent)
        return Job(dataclasses.replace(config, seed=seed, minutes=minutes), method.analyses)

    return [job(method, seed) for seed in range(seeds or experiment.seeds) for method in experiment.methods]


def is_trained(job: Job) -> bool:
    """Whether the record is of a run with today's settings that has come to the end of its budget."""
    rows = records.read_rows(job.record / "metrics.jsonl")
    if not rows:
        return False
    try:
        made = from_dict(records.read_run(job.record)["config"])
    except UsageError:  # no configuration, or a setting that is no more
        return False
    budget = {name: getattr(job.config, name) for name in (*BUDGET, "seed")}
    last, minutes = rows[-1], job.config.minutes
    spent = last["epoch"] >= job.config.epochs or (minutes is not None and last["seconds"] >= 60 * minutes)
    held = range(made.seed, made.seed + made.seeds)
    return spent and job.config.seed in held and dataclasses.replace(made, **budget) == job.config


def missing(job: Job) -> list[Analysis]:
    """The analyses whose documents are not there; all, where the run is not."""
    trained = is_trained(job)
    return [one for one in job.analyses if not (trained and (job.record / f"{one.name}.json").is_file())]


def is_whole(job: Job) -> bool:
    return is_trained(job) and not missing(job)
