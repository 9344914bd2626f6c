"""`python -m experiments publish RECORD`: makes a record's policy one of the agents that ship with the package."""

from __future__ import annotations

import hashlib
import json
import re
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tyro

from ear_jax import pretrained
from ear_jax.cli.arguments import parse
from ear_jax.errors import RunError, UsageError
from ear_jax.runs import records
from ear_jax.runs.trained import Trained, load, pick, save
from experiments.card import make_card
from experiments.commands import command_line

FILE_BYTES, ALL_BYTES = 2_000_000, 10_000_000  # the largest file, and all of them together


@dataclass(frozen=True)
class PublishCommand:
    """Make a record's policy one of the agents that ship with the package, and write its card."""

    record: tyro.conf.Positional[Path]
    """The record's directory: policy.safetensors, metrics.jsonl and, so that its limits are known, evaluation.json."""
    name: str | None = None
    """What to call it; by default its family, and its agent where that is not ear. An older one gives way."""
    policy: int | None = None
    """Of a record of several seeds, whose policy: 0 is the first."""


def main(words: list[str]) -> None:
    command = parse(PublishCommand, words, "publish", program="python -m experiments")
    card = publish(command.record, command.name, command.policy)
    print(f"{pretrained.PREFIX}{card['name']}: {card['bytes']:,} bytes, mean return {card['mean_return']:.1f}")
    print(card["limits"])


def publish(record: Path, name: str | None = None, index: int | None = None) -> dict[str, Any]:
    """Copies a record's policy into the package and writes its card.

    Args:
      record: the record's directory.
      name: what to call it; by default its family, and its agent where that is not ear.
      index: whose policy, where the record is of several seeds.

    Returns:
      The card.

    Raises:
      UsageError: no such record, no such policy in it or none named among several, a name that is none, or a family
        that is not ours.
      RunError: it lacks something, its parts are not of one moment, or it is too large.
    """
    policy = record / "policy.safetensors"
    if not record.is_dir():
        raise UsageError(f"{record} is no record: there is no such directory")
    for path, source in ((policy, "`ear export`"), (record / "metrics.jsonl", "`ear train`")):
        if not path.is_file():
            raise RunError(f"{record} has no {path.name}, which {source} writes")
    whole, rows = load(policy), records.read_rows(record / "metrics.jsonl")
    seeds = whole.program.config.seeds
    if seeds > 1 and index is None:
        raise UsageError(f"{policy} holds {seeds} seeds; an agent that ships has one: name it by --policy")
    trained = pick(whole, index or 0)
    config = trained.program.config
    name = name or (config.family if config.agent == "ear" else f"{config.family}-{config.agent}")
    if not re.fullmatch(r"[a-z][a-z0-9-]*", name):
        raise UsageError(f"--name {name} cannot name an agent; use small letters, digits and -")
    card = make_card(name, trained, command_line(whole.program.config), rows, read_evaluation(record, trained))
    with tempfile.TemporaryDirectory() as scratch:
        if seeds > 1:
            policy = Path(scratch) / policy.name
            save(policy, trained, rows)
        content = policy.read_bytes()
    check_size(len(content), name)
    card |= {"record": record.resolve().name, "bytes": len(content), "sha256": hashlib.sha256(content).hexdigest()}
    file = pretrained.FOLDER / f"{name}.safetensors"
    try:
        file.write_bytes(content)
    except OSError as error:
        raise RunError(f"cannot write {file}: {error.strerror}") from None
    records.write_json(file.with_suffix(".json"), card)
    return card


def check_size(size: int, name: str) -> None:
    """Raises RunError where a policy would be too large to ship as `name`, alone or with the others there are."""
    if size > FILE_BYTES:
        raise RunError(f"{name} has {size:,} bytes; an agent that ships has at most {FILE_BYTES:,}")
    others = [path for path in pretrained.FOLDER.glob("*.safetensors") if path.stem != name]
    total = size + sum(path.stat().st_size for path in others)
    if total > ALL_BYTES:
        raise RunError(f"with {name} the agents would have {total:,} bytes; all together have at most {ALL_BYTES:,}")


def read_evaluation(record: Path, trained: Trained) -> dict[str, Any] | None:
    """The record's evaluation, if there is one; raises RunError where it is of another policy or cannot be read."""
    path = record / "evaluation.json"
    if not path.is_file():
        return None
    try:
        document = json.loads(path.read_text())
        made_at, seeds = document["updates"], [one["seed"] for one in document["seeds"]]
    except (ValueError, KeyError, TypeError) as error:
        raise RunError(f"{path} cannot be read: {error}") from None
    updates = trained.epoch * trained.program.config.sac.updates
    if made_at != updates:
        raise RunError(f"{path} is of {made_at:,} updates, and the policy of {updates:,}; evaluate it anew")
    if (seed := trained.program.config.seed) not in seeds:
        raise RunError(f"{path} is not of seed {seed}; evaluate it anew")
    return document
