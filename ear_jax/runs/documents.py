"""The words of a run about itself: the document of its checkpoints, the rows of its metrics and its first line."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import jax
import numpy as np

from ear_jax.config import Config
from ear_jax.envs.signature import first_change, is_signature
from ear_jax.learning.episodes import Episodes
from ear_jax.learning.sac_state import CRITICS
from ear_jax.process import hosts
from ear_jax.process.precision import equal_bits, product
from ear_jax.runs import records, training
from ear_jax.runs.seeds import seed_range
from ear_jax.runs.training import Program


def header(program: Program, place: str | Path) -> str:
    """Returns the line that a run prints first."""
    config, engine = program.config, program.family.engine.name
    counts = program.agent.parameter_counts
    products = product(config.network.matmul)
    rounded = "" if products == "float32" else f" in {products}"
    over = f" on {hosts.count()} hosts" if hosts.count() > 1 else ""
    critics = f", {CRITICS} critics of {counts['critic']:,}" if counts["critic"] else ""
    return (
        f"{config.family} · {config.agent} · preset {config.preset} · {len(program.tasks)} tasks · "
        f"{seed_range(config)}{over} · policy of {counts['policy']:,} parameters{critics} · "
        f"engine {engine} on {jax.default_backend()}{rounded} · {equal_bits(engine)} · {place}"
    )


def about(program: Program, config: Config) -> dict[str, Any]:
    """Returns the document that describes a run in its `config.json` and checkpoints."""
    beside = program.config.seeds // config.seeds
    return {
        "config": dataclasses.asdict(config),
        "tasks": program.tasks.document,
        "parameters": program.agent.parameter_counts,
        "fingerprint": program.tasks.fingerprint,
        **({"signature": program.signature} if program.signature else {}),
        "engine": program.family.engine.name,
        "replay": config.checkpoint.replay,
        **({"runs_side_by_side": beside} if beside > 1 else {}),
        **records.provenance(),
    }


def differences(document: dict[str, Any], program: Program) -> list[str]:
    """Lists differences from the engine and versions that wrote a step, which may change results in the last bit."""
    now = {"engine": program.family.engine.name, **records.versions()}
    before = {"engine": document["engine"], **document["versions"]}
    return [f"{name} was {before[name]}, is {value}" for name, value in now.items() if before.get(name, value) != value]


def changed_code(holder: Path, document: dict[str, Any], program: Program) -> str | None:
    """Tells in words that a user's family is not the one that a run or file was trained on; None if it seems to be."""
    before = document.get("signature")
    part = first_change(before, program.signature) if is_signature(before) and program.signature else None
    return f"{holder} was trained on other code of its family: {part} is not what it was" if part else None


def rows_of(
    program: Program,
    collected: np.ndarray,
    epoch: int,
    seconds: float,
    metrics: list[training.Metrics],
    episodes: Episodes,
) -> list[dict[str, Any]]:
    """Builds one row per member: means of metrics over the block's epochs, and evaluated returns by task.

    Args:
      program: of the members.
      collected: epochs of collection of each member, [members]; all have the same number.
      epoch, seconds: at the end of the block.
      metrics: of each epoch, [members].
      episodes: of the evaluation, [members, tasks, episodes].
    """
    returns = episodes.returns.mean(axis=-1)  # [members, tasks]
    means = jax.tree.map(lambda *epochs: np.mean(epochs, axis=0), *metrics)  # each [members]
    return [
        {
            "epoch": epoch,
            "env_steps": program.env_steps(int(collected[0])),
            "updates": epoch * program.config.sac.updates,
            "seconds": round(seconds, 3),
            "mean_return": float(of_member.mean()),
            "returns": dict(zip(program.tasks.names, of_member.tolist(), strict=True)),
            **{name: float(value[index]) for name, value in means.items()},
        }
        for index, of_member in enumerate(returns)
    ]
