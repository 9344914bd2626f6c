"""Settings by role, frozen and complete before JAX runs."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field
from typing import Any, Literal, get_type_hints

import tyro

from ear_jax.errors import UsageError, unknown

MAX_SEED = 2**31  # int32, as JAX counts


@dataclass(frozen=True)
class NetworkConfig:
    width: int = 400
    """Units in every hidden layer but the task encoder's."""
    encoder_layers: int = 2
    """Hidden layers of the state encoder φ."""
    decoder_layers: int = 4
    """Hidden layers of the action decoder ψ."""
    critic_layers: int = 4
    """Hidden layers of each critic."""
    task_layers: int = 0
    """Hidden layers of the task encoder; the paper's is a single linear layer."""
    task_width: int = 400
    """Units in each of those."""
    lse_size: int = 16
    """Size of the latent state embedding."""
    lte_size: int = 3
    """Size of the latent task embedding."""
    lte_start: Literal["spread", "gathered"] = "spread"
    """Where LTEs begin: anywhere on their sphere, or all within a few degrees."""
    normalise_lse: bool = True
    """Put the LSE on its unit sphere."""
    normalise_lte: bool = True
    """Put the LTE on its unit sphere."""
    critic_layer_norm: bool = False
    """LayerNorm in the critics."""
    standardise_obs: bool = False
    """Show the networks observations in standard deviations from the mean of replay."""
    history: int = 1
    """Latest observations shown to the agent at once; a recurrent one reads them in their order."""
    initialiser: Literal["authors", "fan_in"] = "authors"
    """Weights as in the authors' code, or uniform by fan-in."""
    matmul: Literal["float32", "bfloat16"] = "float32"
    """What hidden layers multiply while learning; bfloat16 is twice as fast on a CPU with AMX."""


@dataclass(frozen=True)
class SacConfig:
    lr: float = 3e-4
    """Adam's step size, for the policy, each critic and the temperature."""
    lr_decay: int = 0
    """Updates in which the step size falls evenly to a tenth, where it stays; 0: it does not fall."""
    discount: float = 0.99
    pessimism: float = 1.0
    """Which value of the two critics counts: at 1 the lesser, as in SAC, at 0 their mean."""
    tau: float = 0.005
    """How far the target critics follow the critics at each update."""
    batch_size: int = 1280
    """Transitions in an update, the same number for every task."""
    updates: int = 200
    """Gradient steps in an epoch."""
    lte_noise: float = 0.02
    """σ of the noise on the LTE in the actor's objectives; 0 is the ablation."""
    reward_scale: float = 1.0
    """What rewards are multiplied by in the critics' targets."""
    initial_temperature: float = 1.0
    """The entropy's weight before it is learnt."""
    max_grad_norm: float = 10.0
    """Global norm to which each network's gradient is clipped."""


@dataclass(frozen=True)
class MamlConfig:
    inner_lr: float = 0.1
    """Step size of the gradient step that tunes the policy to a task."""
    max_divergence: float = 0.01
    """How far an update may move the tuned policies, their mean KL divergence."""
    discount: float = 0.99


@dataclass(frozen=True)
class CollectConfig:
    envs: int = 1
    """Environments per task."""
    steps: int = 200
    """Steps of each environment in an epoch; of MAML, half before and half after its step."""
    pretrain_epochs: int = 20
    """Epochs of collection with the untrained policy, without updates."""
    stagger: bool = False
    """Start the environments anywhere within their first episode."""


@dataclass(frozen=True)
class ReplayConfig:
    capacity: int = 1_000_000
    """Transitions held, all tasks together; each task's ring has an equal part."""
    share_experience: bool = False
    """Train every task on all tasks' transitions, scored for it."""
    own_share: float = 0.0
    """With shared experience: the part of a batch that still comes from the task's own transitions."""
    symmetry: bool = False
    """Turn and mirror transitions at random, where the robot has symmetries (Ant-Dir)."""


@dataclass(frozen=True)
class EnvConfig:
    lateral_weight: float | None = None
    """Ant-Dir: weight of the lateral speed's penalty (the authors' code: 0, the paper's text: 1)."""
    jump_height: Literal["hind_foot", "torso"] | None = None
    """HalfCheetah-Run-Jump: whose height a jump is (the paper: the hind foot, the authors' code: the torso)."""


@dataclass(frozen=True)
class LogConfig:
    epochs: int = 10
    """Epochs in a block: one compiled call, then one evaluation and one row a seed."""
    episodes: int = 3
    """Evaluation episodes per task."""


@dataclass(frozen=True)
class CheckpointConfig:
    blocks: int = 5
    """Blocks between checkpoints."""
    replay: bool = True
    """Save the replay too; without it checkpoints are small, and a run that continues from one has to fill it anew."""


@dataclass(frozen=True)
class Config:
    """A training run."""

    family: tyro.conf.Positional[str]
    preset: str = "fast"
    """paper, fast or smoke, and what is other: +no-noise, +no-norm, +task-hidden, +wide, +gathered, or several."""
    agent: str = "ear"
    """ear, ear-rnn (recurrent), onehot, onehot-blind (the one-hot zeroed), multihead, pearl or maml."""
    engine: str = "auto"
    """Physics engine: auto, native (CPU), mjx, or warp (an extra; NVIDIA's kernels)."""
    seed: int = 0
    """The first seed."""
    seeds: int = 1
    """Seeds trained side by side: seed, seed + 1, …"""
    epochs: int = 4000
    """Stop after this many epochs in all."""
    minutes: float | None = None
    """Stop at the first block boundary past this much wall time in all."""
    tasks: tuple[str, ...] = ()
    """Training tasks, named as a person would (2 or vel-2); none: the paper's."""
    env: EnvConfig = field(default_factory=EnvConfig)
    network: NetworkConfig = field(default_factory=NetworkConfig)
    sac: SacConfig = field(default_factory=SacConfig)
    maml: MamlConfig = field(default_factory=MamlConfig)
    collect: CollectConfig = field(default_factory=CollectConfig)
    replay: ReplayConfig = field(default_factory=ReplayConfig)
    log: LogConfig = field(default_factory=LogConfig)
    checkpoint: CheckpointConfig = field(default_factory=CheckpointConfig)


def run_name(config: Config) -> str:
    """What a run's directory is called unless its user names it; of path/to/file.py:ClassName, the class."""
    family = config.family.rpartition(":")[2].lower()
    several = f"s{config.seed}-{config.seed + config.seeds - 1}"
    return f"{family}-{config.agent}-{config.preset}-seed{config.seed if config.seeds == 1 else several}"


def from_dict(values: dict[str, Any], kind: type = Config, where: str = "") -> Any:
    """Builds a configuration from nested dictionaries such as JSON holds; what is absent keeps its default.

    Raises:
      UsageError: a setting that does not exist.
    """
    types = get_type_hints(kind)
    given: dict[str, Any] = {}
    for name, value in values.items():
        if name not in types:
            raise unknown("setting", where + name, [where + known for known in types])
        if dataclasses.is_dataclass(types[name]):
            value = from_dict(value, types[name], f"{where}{name}.")
        given[name] = tuple(value) if isinstance(value, list) else value
    return kind(**given)


def flat(config: Config) -> dict[str, Any]:
    """Every setting by its name, as in sac.lr."""
    return flat_tree(dataclasses.asdict(config))


def flat_tree(tree: dict[str, Any], where: str = "") -> dict[str, Any]:
    """Nested dictionaries as one, by names as in sac.lr."""
    found: dict[str, Any] = {}
    for name, value in tree.items():
        found |= flat_tree(value, f"{where}{name}.") if isinstance(value, dict) else {where + name: value}
    return found


def check(config: Config) -> None:
    """Raises UsageError for the first value out of its range, with what is allowed.

    Methods and learners check what is theirs.
    """
    for name, minimum in _MINIMA.items():
        value = _setting(config, name)
        if value is not None and not value >= minimum:
            raise UsageError(f"{flag(name)} {value} is too small; it must be at least {minimum}")
    for name, (low, high) in _RANGES.items():
        value = _setting(config, name)
        if not low < value <= high:
            raise UsageError(f"{flag(name)} {value} is out of range; it must be above {low:g} and at most {high:g}")
    if config.seed + config.seeds > MAX_SEED:
        raise UsageError(f"--seed {config.seed} is too large; the last seed must be below {MAX_SEED}")
    for name in ("sac.lte_noise", "sac.pessimism", "replay.own_share"):
        if not 0 <= _setting(config, name) <= 1:
            raise UsageError(f"{flag(name)} {_setting(config, name)} is out of range; it must be from 0 to 1")


_MINIMA: dict[str, int] = {
    "seed": 0,
    "seeds": 1,
    "epochs": 1,
    "minutes": 0,
    **{f"network.{name}": 1 for name in ("width", "task_width", "lse_size", "lte_size", "history")},
    **{f"network.{name}_layers": 0 for name in ("encoder", "decoder", "critic", "task")},
    "sac.lr_decay": 0,
    "sac.batch_size": 1,
    "sac.updates": 1,
    "collect.envs": 1,
    "collect.steps": 1,
    "collect.pretrain_epochs": 1,
    "replay.capacity": 1,
    "log.epochs": 1,
    "log.episodes": 1,
    "checkpoint.blocks": 1,
}
_RANGES: dict[str, tuple[float, float]] = {
    "sac.lr": (0.0, 1.0),
    "sac.discount": (0.0, 1.0),
    "maml.discount": (0.0, 1.0),
    "maml.inner_lr": (0.0, 1e3),
    "maml.max_divergence": (0.0, 1e3),
    "sac.tau": (0.0, 1.0),
    "sac.reward_scale": (0.0, 1e6),
    "sac.initial_temperature": (0.0, 1e6),
    "sac.max_grad_norm": (0.0, 1e9),
}


def flag(name: str) -> str:
    """A setting as it is written on the command line."""
    return "--" + name.replace("_", "-")


def _setting(config: Config, name: str) -> Any:
    value: Any = config
    for part in name.split("."):
        value = getattr(value, part)
    return value
