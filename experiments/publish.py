"""`python -m experiments publish RECORD`: adds a record's policy to the agents that ship with the package."""

from __future__ import annotations

import dataclasses
import hashlib
import os
import re
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tyro

from ear_jax import pretrained
from ear_jax.cli.arguments import parse
from ear_jax.config import CheckpointConfig, Config, LogConfig
from ear_jax.errors import RunError, UsageError
from ear_jax.files.replacing import lock_file, replace_file
from ear_jax.runs import records
from ear_jax.runs.card import command_line, make_card
from ear_jax.runs.trained import Trained, load, pick, save
from experiments.commands import IN_HAND, RUNS
from experiments.inventory import POLICY
from experiments.paper import EVALUATION, REFINED, REFINED_EVALUATION
from experiments.report.measures import mean_return, refinements
from experiments.report.run_index import named, recorded_runs

FILE_BYTES, ALL_BYTES = 2_000_000, 10_000_000  # limits for one file and for all together


@dataclass(frozen=True)
class PublishCommand:
    """Add a record's policy to the agents that ship with the package, and write its card."""

    record: tyro.conf.Positional[Path]
    """The record's directory, with policy.safetensors, metrics.jsonl and, for the card's limits, evaluation.json."""
    name: str | None = None
    """The agent's name; by default its family, with the method if that is not ear. Replaces an agent of that name."""
    policy: int | None = None
    """The policy in a record of several seeds; 0 is the first."""
    refined: bool = False
    """Add the record's refined.safetensors, with the limits of refined-evaluation.json."""


def main(words: list[str]) -> None:
    command = parse(PublishCommand, words, "publish", program="python -m experiments")
    card = publish(command.record, command.name, command.policy, command.refined)
    print(f"{pretrained.PREFIX}{card['name']}: {card['bytes']:,} bytes, mean return {card['mean_return']:.1f}")
    print(card["limits"])


def publish(record: Path, name: str | None = None, index: int | None = None, refined: bool = False) -> dict[str, Any]:
    """Copies a record's policy into the package and writes its card.

    Args:
      record: the record's directory.
      name: the agent's name; by default its family, with the method if that is not ear.
      index: the policy in a record of several seeds.
      refined: take the refined policy.

    Returns:
      The card.

    Raises:
      UsageError: the record or the policy does not exist, several policies and no index, an invalid name, or a family
        outside ear_jax.
      RunError: files are missing, disagree with each other, or are too large.
    """
    policy = record / (REFINED if refined else POLICY)
    if not record.is_dir():
        raise UsageError(f"no record {record}: there is no such directory")
    for path, source in (
        (policy, "`ear refine`" if refined else "`ear export`"),
        (record / "metrics.jsonl", "`ear train`"),
    ):
        if not path.is_file():
            raise RunError(f"{record} has no {path.name}, which {source} writes")
    recorded, rows = load(policy), records.read_rows(record / "metrics.jsonl", required=records.METRICS)
    seeds = recorded.program.config.seeds
    if seeds > 1 and index is None:
        raise UsageError(f"{policy} holds {seeds} seeds and an agent has one: choose it with --policy 0 to {seeds - 1}")
    trained = pick(recorded, index or 0)
    config = trained.program.config
    name = name or (config.family if config.agent == "ear" else f"{config.family}-{config.agent}")
    if not re.fullmatch(r"[a-z][a-z0-9-]*", name):
        raise UsageError(f"--name {name} cannot name an agent; use lower-case letters, digits and -")
    evaluation = read_evaluation(record / f"{(REFINED_EVALUATION if refined else EVALUATION).name}.json", trained)
    card = make_card(name, trained, command_line(recorded.program.config), rows, evaluation)
    card |= among_seeds(trained, refined)
    with tempfile.TemporaryDirectory() as scratch:
        if seeds > 1:
            policy = Path(scratch) / policy.name
            save(policy, trained, rows)
        content = policy.read_bytes()
    check_size(len(content), name)
    card |= {"record": record.resolve().name, "bytes": len(content), "sha256": hashlib.sha256(content).hexdigest()}
    ship(name, content, card)
    return card


def ship(name: str, content: bytes, card: dict[str, Any]) -> None:
    """Writes an agent's file and card; at any moment the agent before or this one loads, as `pretrained.find` does."""
    file, new = (pretrained.FOLDER / f"{name}.safetensors{kind}" for kind in ("", pretrained.NEW))
    with lock_file(RUNS / IN_HAND / f"{name}.agent"):
        with replace_file(new) as scratch:
            scratch.write_bytes(content)
        records.write_json(file.with_suffix(".json"), card)
        os.replace(new, file)


def check_size(size: int, name: str) -> None:
    """Raises RunError if a policy is too large to ship as `name`, alone or together with the other agents."""
    if size > FILE_BYTES:
        raise RunError(f"{name} has {size:,} bytes; an agent may have at most {FILE_BYTES:,}")
    others = [path for path in pretrained.FOLDER.glob("*.safetensors") if path.stem != name]
    total = size + sum(path.stat().st_size for path in others)
    if total > ALL_BYTES:
        raise RunError(f"with {name} all agents would have {total:,} bytes; the limit is {ALL_BYTES:,}")


def among_seeds(trained: Trained, refined: bool) -> dict[str, Any]:
    """Returns the number of recorded seeds that an agent was chosen among, and their mean return."""

    def method(config: Config) -> Config:
        return dataclasses.replace(
            config, seed=0, seeds=1, engine="auto", log=LogConfig(), checkpoint=CheckpointConfig()
        )

    ours = method(named(trained.program.config))
    runs = [run for run in recorded_runs() if method(run.config) == ours]
    returns = [entry["after"] for entry in refinements(runs)] if refined else [mean_return(run) for run in runs]
    return {"seeds": len(returns), "mean_of_seeds": sum(returns) / len(returns)} if returns else {}


def read_evaluation(path: Path, trained: Trained) -> dict[str, Any] | None:
    """Returns a record's evaluation, if any; raises RunError if it belongs to another policy or cannot be read."""
    if not path.is_file():
        return None
    document = records.read_json(path)
    try:
        evaluated_at, seeds = document["updates"], [entry["seed"] for entry in document["seeds"]]
    except (KeyError, TypeError) as error:
        raise RunError(f"{path} cannot be read: {error}") from None
    updates = trained.epoch * trained.program.config.sac.updates
    if evaluated_at != updates:
        raise RunError(
            f"{path} is from {evaluated_at:,} updates and the policy from {updates:,}; run `ear evaluate` again"
        )
    if (seed := trained.program.config.seed) not in seeds:
        raise RunError(f"{path} lacks seed {seed}; run `ear evaluate` again")
    return document
