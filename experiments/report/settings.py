"""The paper's tables of settings, 2 and 3, beside our preset."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from ear_jax.config import Config
from ear_jax.envs import Family
from ear_jax.presets import preset_config
from experiments.paper import numbers
from experiments.report.blocks import Block, Table
from experiments.report.formatting import NO_RUN, count, printed
from experiments.report.run_index import RunIndex

AGENTS = {"EAR-SAC": "ear", "MAML": "maml", "PEARL": "pearl", "MHMT-SAC": "multihead", "OHE-SAC": "onehot"}


def _layers(hidden: int, kind: str = "MLP") -> str:
    return f"{hidden}-layer {kind}"


OURS: dict[str, Callable[[Config], Any]] = {
    "max episode frames": lambda config: Family.episode_length,
    "sensory encoder": lambda config: _layers(config.network.encoder_layers),
    "action decoder": lambda config: _layers(config.network.decoder_layers),
    "task encoder": lambda config: _layers(config.network.task_layers + 1, "FC"),
    "Q-network": lambda config: _layers(config.network.critic_layers),
    "LSE shape": lambda config: config.network.lse_size,
    "LTE shape": lambda config: config.network.lte_size,
    "optimizer": lambda config: "Adam",
    "learning rate": lambda config: config.sac.lr,
    "discount": lambda config: config.sac.discount,
    "batch size": lambda config: config.sac.batch_size,
    "replay buffer": lambda config: config.replay.capacity,
    "pretrain epochs": lambda config: config.collect.pretrain_epochs,
    "training epochs": lambda config: config.epochs,
    "optimization times": lambda config: config.sac.updates,
    "evaluation episodes": lambda config: config.log.episodes,
}


def hyperparameters(index: RunIndex) -> list[Block]:
    """Returns table 2; only hidden layers are counted, as in the paper."""
    data = numbers()["table-2"]
    configs = [preset_config(group.split(" and ")[0], index.preset) for group in data["columns"][1:]]
    rows = []
    for name, *theirs in data["panels"][""]:
        ours = [_cell(OURS[name](config)) for config in configs]
        cells = map(_cell, theirs)
        rows.append([name, *(cell for pair in zip(cells, ours, strict=True) for cell in pair)])
    heads = [f"{group}, {whose}" for group in data["columns"][1:] for whose in ("paper", "ours")]
    caption = (
        f"Settings of EAR-SAC. Ours: preset `{index.preset}` as it is today. The exponent of the paper's learning rate "
        "is missing in print."
    )
    return [Table(caption, ("setting", *heads), rows)]


def _cell(value: Any) -> str:
    return count(value) if isinstance(value, int) else printed(value)


def training_tasks(index: RunIndex) -> list[Block]:
    """Returns table 3; ours as recorded with the runs."""
    data = numbers()["table-3"]
    groups = [group.split(" and ") for group in data["columns"][1:]]
    rows = []
    for name, *theirs in data["panels"][""]:
        ours = [
            "; ".join(dict.fromkeys(_tasks(index, family, AGENTS[name]) for family in families)) for families in groups
        ]
        rows.append([name, *(cell for pair in zip(theirs, ours, strict=True) for cell in pair)])
    heads = [f"{group}, {whose}" for group in data["columns"][1:] for whose in ("paper", "ours")]
    return [Table("Training tasks. Ours: as recorded with the runs.", ("method", *heads), rows)]


def _tasks(index: RunIndex, family: str, agent: str) -> str:
    for run in index.runs(family, agent):
        tasks = run.about["tasks"]
        targets = [task["target"] for task in tasks if task["target"] is not None]
        return f"{len(tasks)} tasks from {min(targets):g} to {max(targets):g}" if targets else f"{len(tasks)} tasks"
    return NO_RUN
