"""The settings of a training run, frozen and complete before JAX runs."""

from __future__ import annotations

import dataclasses
import reprlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal, get_type_hints

import tyro

from ear_jax.errors import UsageError, unknown
from ear_jax.names import METHODS

MAX_SEED = 2**31  # JAX takes seeds as int32
RETIRED = ("network.kernels",)  # settings in files of earlier versions; they chose between equal computations


def _given(metavar: str, default: str) -> Any:
    """Describes a setting for `--help`: the name of its value, and in words what holds if none is given."""
    return tyro.conf.arg(metavar=metavar, help_behavior_hint=f"(default: {default})")


@dataclass(frozen=True)
class NetworkConfig:
    """Sizes, normalisation, initial weights and precision of the networks."""

    width: int = 400
    """Units in each hidden layer, except the task encoder's."""
    encoder_layers: int = 2
    """Hidden layers of the state encoder φ."""
    decoder_layers: int = 4
    """Hidden layers of the action decoder ψ."""
    critic_layers: int = 4
    """Hidden layers of each critic."""
    critic_blocks: int = 0
    """Residual blocks of two layers with LayerNorm (BRO); they replace each critic's hidden layers but the first."""
    critic_bins: int = 0
    """Bins of return whose probabilities each critic predicts (C51), within ± sac.return_scale; 0 predicts Q itself."""
    critic_batch_norm: bool = False
    """Critics of BatchNorm layers, in place of LayerNorm, whose weights keep unit norm (XQC)."""
    critic_task: Literal["onehot", "lte", "both"] = "onehot"
    """Critics' input about the task; an LTE given to critics is also taught by them (BRC)."""
    task_layers: int = 0
    """Hidden layers of the task encoder; the paper has none, only a linear layer."""
    task_width: int = 400
    """Units in each hidden layer of the task encoder."""
    lse_size: int = 16
    """Size of the sensory embedding (LSE)."""
    lte_size: int = 3
    """Size of the task embedding (LTE)."""
    lte_start: Literal["spread", "gathered"] = "spread"
    """Initial LTEs: anywhere on their sphere, or within a few degrees of each other."""
    normalise_lse: bool = True
    """Project the LSE onto the unit sphere."""
    normalise_lte: bool = True
    """Project the LTE onto the unit sphere."""
    equivariant: bool = False
    """Bring symmetric tasks to one before the networks see them, and turn their actions back (Ant-Dir)."""
    critic_layer_norm: bool = False
    """Apply LayerNorm in the critics' hidden layers."""
    standardise_obs: bool = False
    """Standardise observations by the mean and standard deviation of those in replay."""
    history: int = 1
    """Number of latest observations the agent sees at once; a recurrent agent reads them in order."""
    initialiser: Literal["authors", "fan_in"] = "authors"
    """Initial weights: as in the authors' code, or uniform by fan-in."""
    matmul: Literal["float32", "bfloat16"] = "float32"
    """Precision of the hidden layers' matmuls during updates; bfloat16 is faster on CPUs with AMX or AVX-512 BF16."""


@dataclass(frozen=True)
class SacConfig:
    """Updates by SAC."""

    lr: float = 3e-4
    """Adam's step size for the policy, each critic and the temperature."""
    lr_decay: int = 0
    """Updates over which the step size falls linearly to a tenth; 0 keeps it constant."""
    discount: float = 0.99
    """Discount factor γ."""
    pessimism: float = 1.0
    """Aggregation of the two critics: 1 takes the minimum (SAC), 0 the mean, linear between."""
    tau: float = 0.005
    """Share of the critics mixed into the target critics at each update."""
    batch_size: int = 1280
    """Transitions per update, split evenly over the tasks."""
    policy_share: int = 1
    """Policy and temperature learn from every n-th transition of a batch, critics from all."""
    updates: int = 200
    """Updates per epoch."""
    lte_noise: float = 0.02
    """σ of the noise added to the LTE whenever an update samples actions; 0 is the paper's ablation."""
    reward_scale: float = 1.0
    """Factor on rewards in the critics' targets."""
    return_scale: float = 0.0
    """Scale each task's rewards so that the largest return seen is this, and clip targets there (BRC); 0 does not."""
    outcome_weight: float = 0.0
    """Weight of a loss by which φ learns to predict the step's outcome and the next LSE (MR.Q)."""
    weight_decay: float = 0.0
    """Decay of weights, relative to the step size (AdamW); biases and normalisation are left out."""
    initial_temperature: float = 1.0
    """Initial weight of the entropy, which is then learnt."""
    max_grad_norm: float = 10.0
    """Global norm at which the gradients of the policy, of each critic and of the temperature are clipped."""


@dataclass(frozen=True)
class MamlConfig:
    """Updates by MAML."""

    inner_lr: float = 0.1
    """Size of the gradient step that adapts the policy to a task."""
    max_divergence: float = 0.01
    """Limit on the mean KL divergence by which an update changes the adapted policies."""
    discount: float = 0.99
    """Discount factor γ of MAML's returns."""
    gae_lambda: float = 1.0
    """λ of MAML's advantages: 1 uses all later rewards; less relies more on a baseline, which is less noisy."""


@dataclass(frozen=True)
class CollectConfig:
    """Collection of experience."""

    envs: int = 1
    """Environments per task."""
    steps: int = 200
    """Steps of each environment per epoch; MAML takes half before its gradient step and half after."""
    pretrain_epochs: int = 20
    """Epochs of collection with the untrained policy before the first update."""
    hold_noise: int = 1
    """Longest time, in steps, that an action's noise is held; k steps with probability ∝ k⁻² (FlashSAC)."""
    overlap: bool = False
    """Collect while learning, with the policy of the epoch before; needs engine native."""
    stagger: bool = False
    """Start the episode clocks at random, so that environments do not all reset at once."""


@dataclass(frozen=True)
class ReplayConfig:
    """Storage of transitions and the transitions drawn from it."""

    capacity: int = 1_000_000
    """Transitions held for all tasks together, split evenly over the tasks."""
    share_experience: bool = False
    """Train every task on the transitions of all tasks, with its own reward."""
    own_share: float = 0.0
    """With shared experience, the share of a batch drawn from the task's own transitions only."""
    symmetry: bool = False
    """Rotate and mirror transitions at random, for robots with symmetries (Ant-Dir)."""


@dataclass(frozen=True)
class EnvConfig:
    """Options of single families."""

    lateral_weight: Annotated[float | None, _given("FLOAT", "0")] = None
    """Ant-Dir: weight of the penalty on lateral speed (the authors' code: 0; the paper's text gives no weight)."""
    jump_height: Annotated[Literal["hind_foot", "torso"] | None, _given("{hind_foot,torso}", "hind_foot")] = None
    """HalfCheetah-Run-Jump: body whose height is rewarded (the paper: hind foot, the authors' code: torso)."""


@dataclass(frozen=True)
class LogConfig:
    """Evaluation and metrics."""

    epochs: int = 10
    """Epochs per block; each block ends with an evaluation and a row of metrics per seed."""
    episodes: int = 3
    """Evaluation episodes per task."""
    tensorboard: bool = False
    """Copy the metrics to event files in the run's directory, for TensorBoard."""
    wandb: bool = False
    """Copy the metrics to Weights & Biases (pip install 'ear-jax[wandb]'); works offline with WANDB_MODE=offline."""


@dataclass(frozen=True)
class CheckpointConfig:
    """Checkpoints."""

    blocks: int = 5
    """Blocks between checkpoints."""
    replay: bool = True
    """Save the replay; without it checkpoints are small, but a continued run has to refill it."""


@dataclass(frozen=True)
class Config:
    """All settings of a training run."""

    family: tyro.conf.Positional[Annotated[str, tyro.conf.arg(metavar="FAMILY")]]
    """Task family: a name from `ear families`, or path/to/file.py:ClassName."""
    preset: Annotated[str, tyro.conf.arg(metavar="PRESET")] = "fast"
    """paper, fast, smoke; variants +no-noise +no-norm +task-hidden +wide +gathered +equivariant +categorical +both."""
    agent: Annotated[str, tyro.conf.arg(metavar="AGENT", help=f"The method: {', '.join(METHODS)}.")] = "ear"
    """The method, by its name; ear is the paper's."""
    engine: Annotated[str, tyro.conf.arg(metavar="ENGINE")] = "auto"
    """Physics engine: auto, native (CPU), mjx, mjx-fixed, or warp (NVIDIA GPUs; pip install 'ear-jax[warp]')."""
    seed: int = 0
    """First seed."""
    seeds: int = 1
    """Number of seeds trained together: seed, seed + 1, …"""
    epochs: int = 4000
    """Total epochs, including those before a continuation."""
    minutes: Annotated[float | None, _given("FLOAT", "no limit")] = None
    """Total minutes of wall time, including those before a continuation; the run stops after that block."""
    tasks: Annotated[tuple[str, ...], _given("[TASK ...]", "the paper's")] = ()
    """Training tasks by name, such as 2 or vel-2; the paper's by default."""
    task_count: Annotated[int | None, _given("INT", "the paper's tasks")] = None
    """Number of training tasks, spread evenly over the family's range, unless --tasks names them."""
    meta_batch: Annotated[int | None, _given("INT", "all")] = None
    """Tasks that an update of pearl or maml learns from; if there are more, they are drawn anew for each."""
    env: EnvConfig = field(default_factory=EnvConfig)
    network: NetworkConfig = field(default_factory=NetworkConfig)
    sac: SacConfig = field(default_factory=SacConfig)
    maml: MamlConfig = field(default_factory=MamlConfig)
    collect: CollectConfig = field(default_factory=CollectConfig)
    replay: ReplayConfig = field(default_factory=ReplayConfig)
    log: LogConfig = field(default_factory=LogConfig)
    checkpoint: CheckpointConfig = field(default_factory=CheckpointConfig)


def run_name(config: Config) -> str:
    """Returns the default name of a run's directory; a family path/to/file.py:ClassName is shortened to its class."""
    family = config.family.rpartition(":")[2].lower()
    seeds = str(config.seed) if config.seeds == 1 else f"s{config.seed}-{config.seed + config.seeds - 1}"
    return f"{family}-{config.agent}-{config.preset}-seed{seeds}"


def from_dict(values: Any, kind: type = Config, where: str = "") -> Any:
    """Builds a configuration from nested dictionaries, as in `config.json`; absent settings keep their defaults.

    Raises:
      UsageError: a setting does not exist, or is not of its type.
    """
    if not isinstance(values, dict):
        raise UsageError(f"{where.rstrip('.') or 'the configuration'} must be a table of settings")
    types = get_type_hints(kind)
    settings: dict[str, Any] = {}
    for name, value in values.items():
        if where + name in RETIRED:
            continue
        if name not in types:
            raise unknown("setting", where + name, [where + known for known in types])
        if dataclasses.is_dataclass(types[name]):
            settings[name] = from_dict(value, types[name], f"{where}{name}.")
        else:
            settings[name] = tuple(value) if isinstance(value, list) else value
            _check_type(where + name, settings[name], types[name])
    if kind is Config and "family" not in settings:
        raise UsageError("the setting 'family' is missing")
    return kind(**settings)


def _check_type(name: str, value: Any, kind: Any) -> None:
    """Raises UsageError unless a setting is of its type, and its text has no control characters."""
    import typeguard  # a fifth of the time in which a command refuses a mistake

    try:
        typeguard.check_type(value, kind, collection_check_strategy=typeguard.CollectionCheckStrategy.ALL_ITEMS)
        if isinstance(value, bool) and kind is not bool:  # a truth value is an int to Python
            raise typeguard.TypeCheckError("")
    except typeguard.TypeCheckError:
        wanted = kind.__name__ if isinstance(kind, type) else str(kind).replace("typing.", "")
        raise UsageError(f"the setting {name} is {reprlib.repr(value)}; it must be of type {wanted}") from None
    texts = value if isinstance(value, tuple) else (value,)
    if not all(text.isprintable() for text in texts if isinstance(text, str)):
        raise UsageError(f"the setting {name} is {reprlib.repr(value)}, which is not plain text")


def flat(config: Config) -> dict[str, Any]:
    """Returns every setting by its dotted name, such as sac.lr."""
    return flat_tree(dataclasses.asdict(config))


def flat_tree(tree: dict[str, Any], where: str = "") -> dict[str, Any]:
    """Flattens nested dictionaries into one with dotted names, such as sac.lr."""
    flattened: dict[str, Any] = {}
    for name, value in tree.items():
        flattened |= flat_tree(value, f"{where}{name}.") if isinstance(value, dict) else {where + name: value}
    return flattened


def is_on(number: Any) -> bool:
    """Returns whether a setting that 0 turns off is on; a number that the compiled program gets as an argument is."""
    return not isinstance(number, int | float) or number != 0


def flag(name: str) -> str:
    """Returns a setting's flag on the command line."""
    return "--" + name.replace("_", "-")


def env_flags(options: Mapping[str, Any]) -> str:
    """Returns options of a family as on the command line, each after a space."""
    return "".join(f" {flag(f'env.{name}')} {value}" for name, value in options.items())
