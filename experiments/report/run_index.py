"""The recorded runs by method, with their settings and metrics."""

from __future__ import annotations

import contextlib
import dataclasses
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from ear_jax.config import Config, flat, from_dict
from ear_jax.errors import UsageError
from ear_jax.presets import VARIANTS, preset_config
from ear_jax.runs import records
from ear_jax.runs.card import command_line
from experiments import inventory
from experiments.inventory import BUDGET
from experiments.paper import Experiment, Method

Key = tuple[str, str, str]  # family, agent, preset with its variants


@dataclass(frozen=True)
class Run:
    """One seed of a recorded run."""

    name: str  # of its directory in the records
    seed: int
    about: dict[str, Any]  # config.json
    rows: list[dict[str, Any]]  # metrics.jsonl, one row for each block of epochs

    @property
    def directory(self) -> Path:
        return inventory.RECORDS / self.name

    @property
    def last(self) -> dict[str, Any]:
        return self.rows[-1]

    @property
    def minutes(self) -> float:
        return self.last["seconds"] / 60

    @cached_property
    def config(self) -> Config:
        """The run's settings.

        Settings that no longer exist are dropped; settings added since have their defaults. A run whose flags amount
        to a variant of the preset is named as that variant.
        """
        known = dataclasses.asdict(Config(family=""))

        def keep(tree: dict[str, Any], known: dict[str, Any]) -> dict[str, Any]:
            kept = {name: value for name, value in tree.items() if name in known}
            return {
                name: keep(value, known[name]) if isinstance(value, dict) else value for name, value in kept.items()
            }

        return named(from_dict(keep(self.about["config"], known)))

    @property
    def variant(self) -> str:
        """The variant of the preset, as `+both`; empty if there is none."""
        _, plus, variant = self.config.preset.partition("+")
        return plus + variant

    @property
    def command(self) -> str:
        """The command that trains the run with today's presets, all its seeds together."""
        return command_line(self.config)

    @cached_property
    def changes(self) -> dict[str, Any]:
        """Settings of this run that differ from its preset today; budget, logging and checkpoints do not count."""
        return _changes(self.config)

    def document(self, name: str) -> dict[str, Any] | None:
        """Returns an analysis of the run; None if there is none.

        Raises:
          RunError: the file is not a JSON document.
        """
        if name not in self._read:
            path = self.directory / f"{name}.json"
            self._read[name] = records.read_json(path) if path.is_file() else None
        return self._read[name]

    @cached_property
    def _read(self) -> dict[str, dict[str, Any] | None]:
        """Analyses that have been read, by name."""
        return {}

    def of_seed(self, name: str, key: str) -> list[dict[str, Any]]:
        """Returns the entries of an analysis under a key that belong to this seed; empty without the analysis."""
        return [entry for entry in (self.document(name) or {}).get(key, []) if entry["seed"] == self.seed]


class RunIndex:
    """All recorded runs of a preset and its variants."""

    def __init__(self, preset: str):
        self.preset = preset
        self._runs: dict[Key, dict[int, Run]] = {}
        for run in recorded_runs():
            config = run.config
            if config.preset.split("+")[0] != preset.split("+")[0] or _other_tasks(run):
                continue
            seeds = self._runs.setdefault((config.family, config.agent, config.preset), {})
            if run.seed not in seeds or _rank(seeds[run.seed]) < _rank(run):
                seeds[run.seed] = run

    def runs(self, family: str, agent: str = "ear", variant: str = "") -> list[Run]:
        """Returns a method's runs, one for each seed; of two with one seed, today's settings win, then more updates."""
        seeds = self._runs.get((family, agent, self.preset + variant), {})
        return [seeds[seed] for seed in sorted(seeds)]

    def of(self, method: Method) -> list[Run]:
        return self.runs(method.family, method.agent, method.variant)

    def behind(self, experiment: Experiment) -> list[Run]:
        """Returns every run that an experiment can use."""
        return [run for method in experiment.methods for run in self.of(method)]

    def all(self) -> list[Run]:
        return [run for key in sorted(self._runs) for _, run in sorted(self._runs[key].items())]


def recorded_runs() -> list[Run]:
    """Returns each seed of each record that has a configuration and at least one row of metrics."""
    runs = []
    for path in sorted(inventory.RECORDS.glob("[!.]*/config.json")):
        about, rows = records.read_run(path.parent), records.read_rows(path.with_name("metrics.jsonl"))
        for seed in sorted({row["seed"] for row in rows}):
            runs.append(Run(path.parent.name, seed, about, [row for row in rows if row["seed"] == seed]))
    return runs


def _changes(config: Config) -> dict[str, Any]:
    today = flat(preset_config(config.family, config.preset, config.agent))
    return {
        name: value for name, value in flat(config).items() if name.split(".")[0] not in BUDGET and value != today[name]
    }


def named(config: Config) -> Config:
    """Returns the settings under the name of the variant that they equal, or unchanged."""
    for variant in VARIANTS if _changes(config) else ():
        with contextlib.suppress(UsageError):  # the agent does not read what the variant sets
            named = dataclasses.replace(config, preset=f"{config.preset}+{variant}")
            if not _changes(named):
                return named
    return config


def _rank(run: Run) -> tuple[bool, int]:
    """Ranks runs of the same seed: today's settings first, then the number of updates."""
    return not run.changes, run.last["updates"]


def _other_tasks(run: Run) -> bool:
    """Returns True if a run has other tasks or another reward than its preset, so that returns do not compare."""
    return any(name in ("tasks", "task_count") or name.startswith("env.") for name in run.changes)
