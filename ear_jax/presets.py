"""Presets: changes to the defaults of `config.py`, to which families and methods add their own.

Families and methods are imported when a preset is asked for theirs, so that its name alone can be checked without JAX.
"""

from __future__ import annotations

from typing import Any

from ear_jax.config import Config, flag, flat, flat_tree, from_dict
from ear_jax.config_files import merged
from ear_jax.errors import UsageError, known_name

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
        "lr_decay": 152_000,  # all updates of the run
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

# Variants follow a preset's name after a +, as in fast+no-noise: the paper's ablations of EAR (appendix B.7), the
# hidden layer of the task encoder in the authors' code, networks that need more than an hour of one core, LTEs that
# start close together, the critics of BRC (naumix/BiggerRegularizedCategorical), networks that turn with the robot,
# and Run-Jump with two tasks that reward running and jumping at once.
VARIANTS: dict[str, dict[str, Any]] = {
    "no-noise": {"sac": {"lte_noise": 0.0}},
    "no-norm": {"network": {"normalise_lse": False, "normalise_lte": False}},
    "task-hidden": {"network": {"task_layers": 1}},
    "wide": {"network": {"width": 512, "matmul": "bfloat16"}},
    "gathered": {"network": {"lte_start": "gathered"}},
    "equivariant": {
        "epochs": 190,
        "network": {"equivariant": True},
        "sac": {"lr_decay": 76_000},
    },
    # An update takes three times as long on a CPU, so a run has half as many.
    "categorical": {
        "epochs": 190,
        "network": {"critic_blocks": 2, "critic_bins": 101, "critic_task": "both"},
        "sac": {"lr_decay": 76_000, "return_scale": 10.0, "weight_decay": 0.01},
    },
    "both": {
        "tasks": (*(f"back-{speed}" for speed in range(1, 8)), "jump-1", "jump-5", "jump-10", "both-2-5", "both-4-5"),
    },
}


def check_effect(config: Config) -> None:
    """Raises UsageError for a setting that was changed from the preset's although the agent does not read it."""
    from ear_jax.methods import find_method

    method = find_method(config.agent)
    preset = flat(preset_config(config.family, config.preset, config.agent))
    for name, value in flat(config).items():
        if value != preset[name] and not method.reads(name):
            raise UsageError(f"{flag(name)} {value} would change nothing: agent {config.agent!r} has no use for it")
    if config.tasks and config.task_count != preset["task_count"]:
        raise UsageError(f"--task-count {config.task_count} would change nothing: the tasks are named")


def preset_config(family: str, preset: str, agent: str = "ear") -> Config:
    """Returns the configuration of a preset.

    Args:
      family: a family's name.
      preset: `paper`, `fast` or `smoke`, alone or with variants, as in `fast+no-noise+no-norm`.
      agent: a method's name.

    Raises:
      UsageError: the preset, a variant or the agent is unknown, or a variant changes a setting the agent does not read.
    """
    from ear_jax.envs.registry import family_presets
    from ear_jax.methods import find_method

    base, variants = parts(preset)
    method = find_method(agent)
    own = family_presets(family)
    for name in own:
        known_name(f"preset in those of {family}", name, PRESETS)
    changes = merged(PRESETS[base], own.get(base, {}))
    changes = merged(changes, method.presets.get(base, {}))
    changes = merged(changes, method.families.get(base, {}).get(family, {}))
    for variant in variants:
        for name in flat_tree(VARIANTS[variant]):
            if not method.reads(name):
                raise UsageError(f"agent {agent!r} has no use for {flag(name)}, which --preset {preset} sets")
        changes = merged(merged(changes, VARIANTS[variant]), method.presets.get(variant, {}))
    config: Config = from_dict({"family": family, "preset": preset, "agent": agent, **changes})
    return config


def draft_config(family: str, preset: str, agent: str = "ear") -> Config:
    """Returns the configuration of a preset without the changes of family and agent; raises UsageError as `parts`."""
    base, variants = parts(preset)
    changes = PRESETS[base]
    for variant in variants:
        changes = merged(changes, VARIANTS[variant])
    config: Config = from_dict({"family": family, "preset": preset, "agent": agent, **changes})
    return config


def parts(preset: str) -> tuple[str, list[str]]:
    """Splits the name of a preset into its base and variants; raises UsageError if there is no such base or variant."""
    base, *variants = preset.split("+")
    return known_name("preset", base, PRESETS), [known_name("preset variant", one, VARIANTS) for one in variants]
