"""What of the paper is there: the records of runs, told apart by their settings. Imports no JAX.

A record is a run directory without its checkpoints, of one seed or of several side by side: `config.json`,
`metrics.jsonl`, the policy as `ear export` writes it, and a JSON document an analysis, with its picture where that is
kept.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path

from ear_jax.config import Config, from_dict, run_name
from ear_jax.errors import UsageError
from ear_jax.presets import preset_config
from ear_jax.runs import records
from experiments.paper import Analysis, Experiment, Method

RECORDS = Path(__file__).with_name("records")
POLICY = "policy.safetensors"
# Settings by which a run is no other run: how long it may go on and what is watched, and what the others are called.
BUDGET = ("seed", "seeds", "epochs", "minutes", "engine", "log", "checkpoint", "preset")


@dataclass(frozen=True)
class Job:
    """One seed of a method, or several side by side, and the analyses that are wanted of it."""

    config: Config
    analyses: tuple[Analysis, ...]

    @property
    def name(self) -> str:
        return run_name(self.config)

    @property
    def record(self) -> Path:
        """Where it is recorded, or would be: by itself, or among the seeds that it was trained beside."""
        alone, method = RECORDS / self.name, self.name.removesuffix(str(self.config.seed))
        places = [alone, *sorted(RECORDS.glob(f"{method}s*"))]
        return next((place for place in places if _holds(place, self.config)), alone)

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
        config = preset_config(method.family, preset + method.variant, method.agent)
        return Job(dataclasses.replace(config, seed=seed, minutes=minutes), method.analyses)

    return [job(method, seed) for seed in range(seeds or experiment.seeds) for method in experiment.methods]


def is_trained(job: Job) -> bool:
    """Whether there is a record of a run with today's settings that has come to the end of its budget."""
    return _holds(job.record, job.config)


def _holds(record: Path, config: Config) -> bool:
    rows = records.read_rows(record / "metrics.jsonl")
    if not rows:
        return False
    try:
        made = from_dict(records.read_run(record)["config"])
    except UsageError:  # no configuration, or a setting that is no more
        return False
    budget = {name: getattr(config, name) for name in BUDGET}
    last, minutes = rows[-1], config.minutes
    spent = last["epoch"] >= config.epochs or (minutes is not None and last["seconds"] >= 60 * minutes)
    seeds = made.seed <= config.seed and config.seed + config.seeds <= made.seed + made.seeds
    return spent and seeds and dataclasses.replace(made, **budget) == config


def is_kept(job: Job) -> bool:
    """Whether the record has all that is needed of the run, wherever that was trained."""
    return is_trained(job) and job.policy.is_file()


def side_by_side(wanted: list[Job]) -> list[Job]:
    """The same jobs, but where a method lacks several seeds, one run of all from the first to the last of these."""
    kept, lacking = [], {}
    for job in wanted:
        if is_kept(job):
            kept.append(job)
        else:
            lacking.setdefault((dataclasses.replace(job.config, seed=0), job.analyses), []).append(job.config.seed)
    together = [
        Job(dataclasses.replace(config, seed=min(seeds), seeds=1 + max(seeds) - min(seeds)), analyses)
        for (config, analyses), seeds in lacking.items()
    ]
    return kept + together


def missing(job: Job) -> list[Analysis]:
    """The analyses whose documents are not there; all, where the run is not."""
    trained = is_trained(job)
    return [one for one in job.analyses if not (trained and (job.record / f"{one.name}.json").is_file())]


def is_whole(job: Job) -> bool:
    return is_trained(job) and not missing(job)
