"""The records of runs, identified by their settings, and what is missing of the paper. Imports no JAX.

A record is a run directory without its checkpoints, with one seed or several side by side: `config.json`,
`metrics.jsonl`, the policy as `ear export` writes it, and a JSON document for each analysis, some with a picture.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Any

from ear_jax.config import Config, from_dict, run_name
from ear_jax.errors import UsageError
from ear_jax.presets import preset_config
from ear_jax.runs import records
from experiments.paper import Analysis, Experiment, Method

RECORDS = Path(__file__).with_name("records")
POLICY = "policy.safetensors"
# Settings in which runs may differ and still count as the same: length, seeds, logging, and the preset's name.
BUDGET = ("seed", "seeds", "epochs", "minutes", "engine", "log", "checkpoint", "preset")


@dataclass(frozen=True)
class Job:
    """One seed of a method, or several side by side, with the analyses wanted of it."""

    config: Config
    analyses: tuple[Analysis, ...]

    @property
    def name(self) -> str:
        return run_name(self.config)

    @property
    def record(self) -> Path:
        """The job's record, existing or not: a directory of its own, or one with seeds trained side by side."""
        alone, method = RECORDS / self.name, self.name.removesuffix(str(self.config.seed))
        candidates = [alone, *sorted(RECORDS.glob(f"{method}s*"))]
        return next((record for record in candidates if _holds(record, self.config)), alone)

    @property
    def policy(self) -> Path:
        """The exported policy in the record."""
        return self.record / POLICY


def jobs(experiment: Experiment, preset: str, seeds: int | None = None, minutes: float | None = None) -> list[Job]:
    """Returns all jobs of an experiment under a preset.

    Args:
      experiment: the table or figure.
      preset: a preset's name.
      seeds: number of seeds; by default the method's, or else the experiment's.
      minutes: wall time after which each run stops; by default the preset's epochs decide.
    """

    def job(method: Method, seed: int) -> Job:
        config = preset_config(method.family, preset + method.variant, method.agent)
        return Job(dataclasses.replace(config, seed=seed, minutes=minutes), method.analyses)

    counts = {method: seeds or method.seeds or experiment.seeds for method in experiment.methods}
    return [
        job(method, seed)
        for seed in range(max(counts.values(), default=0))
        for method in counts
        if seed < counts[method]
    ]


def is_trained(job: Job) -> bool:
    """Returns whether a run with today's settings is recorded to the end of its budget."""
    return _holds(job.record, job.config)


def _holds(record: Path, config: Config) -> bool:
    rows = records.read_rows(record / "metrics.jsonl")
    if not rows:
        return False
    try:
        recorded = from_dict(records.read_run(record)["config"])
    except UsageError:  # no configuration, or a setting that no longer exists
        return False
    budget = {name: getattr(config, name) for name in BUDGET}
    last, minutes = rows[-1], config.minutes
    spent = last["epoch"] >= config.epochs or (minutes is not None and last["seconds"] >= 60 * minutes)
    includes_seeds = recorded.seed <= config.seed and config.seed + config.seeds <= recorded.seed + recorded.seeds
    return spent and includes_seeds and dataclasses.replace(recorded, **budget) == config


def is_kept(job: Job) -> bool:
    """Returns whether the record has everything needed from the run, wherever that was trained."""
    return is_trained(job) and job.policy.is_file()


def side_by_side(wanted: list[Job]) -> list[Job]:
    """Returns the same jobs, with the missing seeds of each method merged into one run from the first to the last."""
    kept = [job for job in wanted if is_kept(job)]
    lacking = _by_method([job for job in wanted if job not in kept])
    return kept + [_of_seeds(jobs[0], min(seeds), max(seeds)) for seeds, jobs in lacking]


def named_together(wanted: list[Job], name: str) -> Job | None:
    """Returns the job of that name which trains several seeds of a method side by side, or None.

    Unlike the jobs of `side_by_side`, it does not depend on which seeds are missing by now.
    """
    together = (
        _of_seeds(jobs[0], first, last) for seeds, jobs in _by_method(wanted) for first, last in combinations(seeds, 2)
    )
    return next((job for job in together if job.name == name), None)


def _by_method(wanted: list[Job]) -> list[tuple[list[int], list[Job]]]:
    """Groups jobs that differ in their seed alone; returns each group's seeds, ascending, and jobs."""
    groups: dict[Any, list[Job]] = {}
    for job in wanted:
        groups.setdefault((dataclasses.replace(job.config, seed=0), job.analyses), []).append(job)
    return [(sorted(job.config.seed for job in group), group) for group in groups.values()]


def _of_seeds(job: Job, first: int, last: int) -> Job:
    return Job(dataclasses.replace(job.config, seed=first, seeds=1 + last - first), job.analyses)


def missing(job: Job) -> list[Analysis]:
    """Returns the analyses without a document, and those of a policy to be written anew; all if the run is missing."""
    trained = is_trained(job)
    lacking = {one for one in job.analyses if not (trained and (job.record / f"{one.name}.json").is_file())}
    written = {one.writes for one in lacking if one.writes}
    return [one for one in job.analyses if one in lacking or one.of in written]


def is_complete(job: Job) -> bool:
    """Returns whether a job is trained and has all its analyses."""
    return is_trained(job) and not missing(job)
