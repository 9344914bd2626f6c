"""Limits of settings: the range of each, checked before anything is built or read."""

from __future__ import annotations

import math

from ear_jax.config import MAX_SEED, Config, flag, flat
from ear_jax.errors import UsageError

MAX_COUNT = 2**31 - 1  # counters and indices are int32
MAX_LAYERS = 100  # each is traced anew, so many more would take hours to compile
MAX_TASKS = 1000


def check(config: Config) -> None:
    """Raises UsageError for the first value out of its range, naming the range.

    Methods and learners check the settings that only they read.
    """
    settings = flat(config)
    for name, value in settings.items():
        if isinstance(value, float) and not math.isfinite(value):
            raise UsageError(f"{flag(name)} {value} is out of range; it must be finite")
        if isinstance(value, int):
            _check_count(name, value)
    for name, minimum in _MINIMA.items():
        value = settings[name]
        if value is not None and not value >= minimum:
            raise UsageError(f"{flag(name)} {value} is too small; it must be at least {minimum}")
    for name, (low, high) in _RANGES.items():
        value = settings[name]
        if not low < value <= high:
            raise UsageError(f"{flag(name)} {value} is out of range; it must be above {low:g} and at most {high:g}")
    if config.minutes is not None and not config.minutes > 0:
        raise UsageError(f"--minutes {config.minutes:g} is too small; it must be above 0")
    if config.seed + config.seeds > MAX_SEED:
        raise UsageError(f"--seed {config.seed} is too large; the last seed must be below {MAX_SEED}")
    for name in ("sac.lte_noise", "sac.pessimism", "sac.weight_decay", "replay.own_share"):
        if not 0 <= settings[name] <= 1:
            raise UsageError(f"{flag(name)} {settings[name]} is out of range; it must be from 0 to 1")
    if len(config.tasks) > MAX_TASKS:
        raise UsageError(f"--tasks names {len(config.tasks)} tasks; there may be at most {MAX_TASKS}")
    if config.task_count and config.task_count > MAX_TASKS:
        raise UsageError(f"--task-count {config.task_count} is too large; it must be at most {MAX_TASKS}")


def _check_count(name: str, value: int) -> None:
    limit = MAX_LAYERS if name.endswith(("_layers", "_blocks")) else MAX_COUNT
    if value > limit and name not in ("seed", "replay.capacity"):  # the one has a range, the other has to fit in memory
        raise UsageError(f"{flag(name)} {value} is too large; it must be at most {limit}")


_MINIMA: dict[str, int] = {
    "seed": 0,
    "seeds": 1,
    "epochs": 1,
    "task_count": 1,
    "meta_batch": 1,
    **{f"network.{name}": 1 for name in ("width", "task_width", "lse_size", "lte_size", "history")},
    **{f"network.{name}_layers": 0 for name in ("encoder", "decoder", "critic", "task")},
    **{f"network.critic_{name}": 0 for name in ("blocks", "bins")},
    **{f"sac.{name}": 0 for name in ("lr_decay", "return_scale", "outcome_weight")},
    **{f"sac.{name}": 1 for name in ("batch_size", "policy_share", "updates")},
    **{f"collect.{name}": 1 for name in ("envs", "steps", "hold_noise", "pretrain_epochs")},
    "replay.capacity": 1,
    "log.epochs": 1,
    "log.episodes": 1,
    "checkpoint.blocks": 1,
}
_RANGES: dict[str, tuple[float, float]] = {
    "sac.lr": (0.0, 1.0),
    "sac.discount": (0.0, 1.0),
    "maml.discount": (0.0, 1.0),
    "maml.gae_lambda": (0.0, 1.0),
    "maml.inner_lr": (0.0, 1e3),
    "maml.max_divergence": (0.0, 1e3),
    "sac.tau": (0.0, 1.0),
    "sac.reward_scale": (0.0, 1e6),
    "sac.initial_temperature": (0.0, 1e6),
    "sac.max_grad_norm": (0.0, 1e9),
}
