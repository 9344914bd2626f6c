"""The presets: what each changes in the defaults of `config.py`, as data."""

from __future__ import annotations

from fnmatch import fnmatch
from typing import Any

from ear_jax.config import Config, flag, flat, flat_tree, from_dict
from ear_jax.errors import UsageError, unknown

# The defaults are the paper's for HalfCheetah-Vel.
_FAST: dict[str, Any] = {
    "epochs": 380,
    "network": {
        "width": 256,
        "encoder_layers": 1,
        "decoder_layers": 2,
        "critic_layers": 2,
        "critic_layer_norm": True,
        "standardise_obs": True,
        "initialiser": "fan_in",
    },
    "sac": {
        "lr": 1e-3,
        "lr_decay": 152_000,  # all of its updates
        "discount": 0.98,
        "batch_size": 480,
        "updates": 400,
        "reward_scale": 0.1,
        "initial_temperature": 0.01,
    },
    "collect": {"envs": 8, "steps": 25, "stagger": True},
    "replay": {"share_experience": True, "capacity": 200_000},
}
PRESETS: dict[str, dict[str, Any]] = {
    "paper": {},
    "fast": _FAST,
    "smoke": {
        **_FAST,
        "epochs": 200,
        "network": {**_FAST["network"], "width": 128},
        "sac": {**_FAST["sac"], "batch_size": 240, "updates": 200, "lr_decay": 0},
        "replay": {"share_experience": True, "capacity": 300_000},
    },
}

# And what it changes for one family (the paper's table of hyperparameters).
_PAPER_LEGGED = {"epochs": 5000}
_FAST_REACH: dict[str, Any] = {"network": {"history": 2}, "sac": {"reward_scale": 0.01}}
FAMILY_PRESETS: dict[tuple[str, str], dict[str, Any]] = {
    ("paper", "hopper-vel"): _PAPER_LEGGED,
    ("paper", "walker-vel"): _PAPER_LEGGED,
    ("paper", "ant-dir"): {"epochs": 10_000, "sac": {"batch_size": 1920}, "replay": {"capacity": 1_200_000}},
    # The last 100 epochs, as of the others. Of those a 24th are a task's own, too few to learn speed in its direction.
    # And the ant is the same from four sides and in a mirror: each step shows eight, and no direction goes its own way.
    ("fast", "ant-dir"): {"replay": {"capacity": 480_000, "own_share": 0.5, "symmetry": True}},
    # Their step is 8 ms, a sixth of the others': at 0.98 nothing past 0.4 s, less than a hop, would count.
    # The lesser of two critics holds it back from hopping: most seeds learn to run while they sink, and fall.
    ("fast", "hopper-vel"): {"sac": {"discount": 0.99, "pessimism": 0.0}},
    ("fast", "walker-vel"): {"sac": {"discount": 0.99}},
    # Meta-World shows two steps at once. Its rewards are up to 10, where those of the others are about 1.
    ("paper", "reach"): {"network": {"history": 2}},
    ("fast", "reach"): {**_FAST_REACH, "epochs": 100, "sac": {**_FAST_REACH["sac"], "lr_decay": 40_000}},
    ("smoke", "reach"): {"tasks": ("0", "108", "216"), **_FAST_REACH},
    ("smoke", "halfcheetah-vel"): {"tasks": ("1", "2", "3")},
    ("smoke", "hopper-vel"): {"tasks": ("0.4", "1", "1.6"), "sac": {"discount": 0.99}},
    ("smoke", "walker-vel"): {"tasks": ("0.4", "1", "1.6"), "sac": {"discount": 0.99}},
    ("smoke", "ant-dir"): {"tasks": ("0", "90", "180", "270")},
    ("smoke", "halfcheetah-run-jump"): {"tasks": ("back-1", "back-3", "jump-5")},
}

# And for one agent: the code of the baselines, and how far back a recurrent one reads.
_RECURRENT = {"network": {"history": 8}}
_INFERRED = {"lte_size": 5, "task_width": 200, "task_layers": 3}
_TUNED: dict[str, Any] = {
    "network": {"width": 64, "decoder_layers": 2, "initialiser": "fan_in", "standardise_obs": False},
    "sac": {"updates": 1, "lr_decay": 0},
    "collect": {"envs": 20, "steps": 400, "pretrain_epochs": 1, "stagger": False},
}
AGENT_PRESETS: dict[tuple[str, str], dict[str, Any]] = {
    ("paper", "multihead"): {
        "network": {"decoder_layers": 3, "critic_layers": 3},
        "sac": {"max_grad_norm": 1.0},
    },
    ("paper", "pearl"): {
        "network": {**_INFERRED, "width": 300, "decoder_layers": 3, "critic_layers": 3},
        "sac": {"reward_scale": 5.0},
    },
    **{(preset, "pearl"): {"network": _INFERRED} for preset in ("fast", "smoke")},
    # A step of MAML needs fresh episodes of all tasks, before and after tuning: 20 of each.
    ("paper", "maml"): {**_TUNED, "epochs": 1000},
    ("fast", "maml"): {**_TUNED, "epochs": 300},
    ("smoke", "maml"): {**_TUNED, "epochs": 20},
    **{(preset, "ear-rnn"): _RECURRENT for preset in PRESETS},
    # An update takes 4.5 times as long as EAR's, and an hour of one core has room for no more epochs.
    ("fast", "ear-rnn"): {**_RECURRENT, "epochs": 110, "sac": {"lr_decay": 44_000}},
}

# What a preset's name may go on with after a +, as in fast+no-noise: the paper's ablations of EAR (appendix B.7), the
# hidden layer that the authors' code has in the task encoder, networks that an hour of one core is too short for, and
# embeddings that unfold from one place.
VARIANTS: dict[str, dict[str, Any]] = {
    "no-noise": {"sac": {"lte_noise": 0.0}},
    "no-norm": {"network": {"normalise_lse": False, "normalise_lte": False}},
    "task-hidden": {"network": {"task_layers": 1}},
    "wide": {"network": {"width": 512, "matmul": "bfloat16"}},
    "gathered": {"network": {"lte_start": "gathered"}},
}


# Settings that an agent does not read, or a preset of it would have set. `fnmatch`'s patterns.
_OF_EMBEDDINGS = (
    *("sac.lte_noise", "network.normalise_*"),
    *(f"network.{name}" for name in ("lse_size", "lte_start", "encoder_layers")),
)
_OF_A_TASK_ENCODER = ("network.lte_size", "network.task_*")
_OF_SAC = (
    *(f"sac.{name}" for name in ("lr", "lr_decay", "discount", "pessimism", "tau", "batch_size")),
    *(f"sac.{name}" for name in ("reward_scale", "initial_temperature", "max_grad_norm")),
    *("network.critic_*", "network.standardise_obs", "replay.*"),
)
UNREAD: dict[str, tuple[str, ...]] = {
    "ear": ("maml.*",),
    "ear-rnn": ("maml.*",),
    "pearl": ("maml.*", *_OF_EMBEDDINGS),
    **dict.fromkeys(("onehot", "onehot-blind", "multihead"), ("maml.*", *_OF_EMBEDDINGS, *_OF_A_TASK_ENCODER)),
    "maml": ("network.matmul", *_OF_EMBEDDINGS, *_OF_A_TASK_ENCODER, *_OF_SAC),
}


def check_effect(config: Config) -> None:
    """Refuses a setting that differs from the preset's and that the agent does not read; raises UsageError."""
    preset, mine = flat(preset_config(config.family, config.preset, config.agent)), flat(config)
    for name, value in mine.items():
        if value != preset[name] and _is_unread(name, config.agent):
            raise UsageError(f"{flag(name)} {value} would change nothing: agent {config.agent!r} has no use for it")


def preset_config(family: str, preset: str, agent: str = "ear") -> Config:
    """The configuration a preset stands for.

    Args:
      family: a family's name.
      preset: `paper`, `fast` or `smoke`, alone or with variants, as in `fast+no-noise+no-norm`.
      agent: an agent's name.

    Raises:
      UsageError: no such preset or variant, or one that changes what the agent does not read.
    """
    base, *variants = preset.split("+")
    if base not in PRESETS:
        raise unknown("preset", base, PRESETS)
    changes = _merge(PRESETS[base], FAMILY_PRESETS.get((base, family), {}))
    changes = _merge(changes, AGENT_PRESETS.get((base, agent), {}))
    for variant in variants:
        if variant not in VARIANTS:
            raise unknown("variant of a preset", variant, VARIANTS)
        for name in flat_tree(VARIANTS[variant]):
            if _is_unread(name, agent):
                raise UsageError(f"agent {agent!r} has no use for {flag(name)}, which --preset {preset} sets")
        changes = _merge(changes, VARIANTS[variant])
    return from_dict({"family": family, "preset": preset, "agent": agent, **changes})


def _is_unread(name: str, agent: str) -> bool:
    return any(fnmatch(name, unread) for unread in UNREAD.get(agent, ()))


def _merge(base: dict[str, Any], changes: dict[str, Any]) -> dict[str, Any]:
    """Nested dictionaries, the second over the first."""
    merged = dict(base)
    for name, value in changes.items():
        merged[name] = _merge(base.get(name, {}), value) if isinstance(value, dict) else value
    return merged
