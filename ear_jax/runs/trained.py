"""A policy that was trained, as those see it who only use it: of a run's newest checkpoint, or of a file."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import jax

from ear_jax import pretrained
from ear_jax.agents.networks import Params
from ear_jax.config import from_dict
from ear_jax.envs import FAMILIES
from ear_jax.errors import RunError, UsageError
from ear_jax.process.runtime import compiler_options
from ear_jax.process.terminal import say
from ear_jax.runs import checkpoint, records, training
from ear_jax.runs.directory import check_tasks
from ear_jax.runs.export import SUFFIX, read_policy, write_policy
from ear_jax.runs.leaves import first_difference, layout, named_leaves, rebuild
from ear_jax.runs.training import Program, TrainState


@dataclass(frozen=True)
class Trained:
    """A run's newest policies, one a seed."""

    name: str  # as the user wrote it
    program: Program
    policies: Params  # each leaf [seeds, …]
    epoch: int
    directory: Path = Path()  # where what is found out about it is kept
    collected: int = 0  # epochs of collection
    about: dict[str, Any] = field(default_factory=dict)  # written with it: configuration, tasks, versions, machine

    @property
    def fingerprint(self) -> str:
        """Tells these policies from all others."""
        digest = hashlib.sha256()
        for leaf in jax.tree.leaves(jax.device_get(self.policies)):
            digest.update(leaf.tobytes())
        return digest.hexdigest()[:16]


def for_each_seed(trained: Trained, of_seed: Callable[..., Any], seed: int, *arguments: Any) -> Any:
    """What a function says of every seed's policy, in one compiled call, brought to the host.

    Args:
      trained: the policies.
      of_seed: (policy, key, …) → a pytree.
      seed: of the keys, one a policy.
      *arguments: what else it takes, each leaf [seeds, …].

    Returns:
      The pytree, each leaf [seeds, …].
    """
    keys = jax.random.split(jax.random.key(seed), trained.program.config.seeds)
    of_all = jax.jit(jax.vmap(of_seed), compiler_options=compiler_options())
    return jax.device_get(of_all(trained.policies, keys, *arguments))


def policy_of(trained: Trained, index: int) -> Params:
    """Returns the policy of one seed, each leaf without the axis of seeds; index 0 is the first seed."""
    return jax.tree.map(lambda leaf: leaf[index], trained.policies)


def pick(trained: Trained, policy: int) -> Trained:
    """The policy of one seed, as of a run of that seed alone.

    Args:
      trained: the policies.
      policy: whose: 0 is the first seed.

    Returns:
      That policy; `about` tells beside how many seeds it was trained.

    Raises:
      UsageError: there is no such policy.
    """
    check_policy(trained, policy)
    config, seed = trained.program.config, trained.program.config.seed + policy
    if config.seeds == 1:
        return trained
    policies = jax.tree.map(lambda leaf: leaf[policy : policy + 1], trained.policies)
    program = replace(trained.program, config=replace(config, seed=seed, seeds=1))
    alone = {**trained.about["config"], "seed": seed, "seeds": 1}
    about = {**trained.about, "config": alone, "side_by_side": config.seeds}
    return replace(trained, program=program, policies=policies, about=about)


def check_policy(trained: Trained, policy: int) -> None:
    """Raises UsageError for a policy that a run does not have."""
    if not 0 <= policy < (seeds := trained.program.config.seeds):
        raise UsageError(f"--policy {policy} is none of the run's: it has {seeds}, and the first is 0")


def load(path: Path, family: str | None = None, engine: str | None = None) -> Trained:
    """Reads the policies of a run's newest good checkpoint, of an exported file, or of a pretrained agent.

    Args:
      path: the run's directory, a file that `ear export` wrote, or `pretrained:NAME`.
      family: the family, as `ear train` takes it. It has to be named where it is not one of this package's: no code is
        run because a file says so.
      engine: the physics engine; by default a run's own, and for a file the one that is best here.

    Raises:
      UsageError: there is no run or no such pretrained agent, or its family has to be named.
      RunError: it has no checkpoint yet, or none that is whole, or the engine cannot run here.
    """
    if str(path).startswith(pretrained.PREFIX):
        name = str(path).removeprefix(pretrained.PREFIX)
        trained = _from_file(pretrained.find(name), family, engine)
        return replace(trained, name=str(path), directory=pretrained.results(name))
    return (_from_file if path.is_file() else _from_run)(path, family, engine)


def save(file: Path, trained: Trained, rows: list[dict[str, Any]]) -> str:
    """Writes policies to a file that `load` takes, and returns its card; arguments and errors as `describe` and
    `write_policy`."""
    about = {name: value for name, value in trained.about.items() if name != "leaves"}
    card = describe(trained, rows)
    codes = jax.vmap(trained.program.agent.codes)(trained.policies)
    write_policy(file, trained.policies, codes, about, card)
    return card


def describe(trained: Trained, rows: list[dict[str, Any]]) -> str:
    """The card: what a person should know who is handed the file.

    Args:
      trained: the policies.
      rows: the run's metrics; of them the evaluation of these policies at their epoch is told.
    """
    program, about = trained.program, trained.about
    config, versions = program.config, about["versions"]
    seeds = range(config.seed, config.seed + config.seeds)
    found = [row["mean_return"] for row in rows if row["epoch"] == trained.epoch and row["seed"] in seeds]
    beside = f", one of {about['side_by_side']} trained side by side" if "side_by_side" in about else ""
    reached = f", mean return {sum(found) / len(found):.1f}" if found else ""
    return "\n".join(
        [
            f"{config.family}, agent {config.agent}, preset {config.preset}, seeds from {config.seed}: {config.seeds}"
            f"{beside}",
            f"tasks, in the order of the code table: {', '.join(program.tasks.names)}",
            f"trained for {trained.epoch} epochs, {program.env_steps(trained.collected):,} env steps and "
            f"{trained.epoch * config.sac.updates:,} updates a seed{reached}",
            f"engine {about['engine']}, mujoco {versions['mujoco']}, jax {versions['jax']}, commit {about['commit']}",
            "policy.* are the networks' parameters [seeds, …], codes the table [seeds, tasks, code]",
        ]
    )


def _from_run(directory: Path, family: str | None, engine: str | None) -> Trained:
    records.read_run(directory)
    step = checkpoint.newest(directory / "checkpoints", say)
    if step is None:
        raise RunError(f"{directory} has no checkpoint yet; the same `ear train` command continues it")
    program = _program(directory, step.about, family, engine or step.about["config"]["engine"])
    like = _shapes(program)
    nothing = jax.tree.map(lambda _: None, like)
    policy = replace(nothing.learner, policy=like.learner.policy)
    state = checkpoint.restore(step, replace(nothing, learner=policy, collected=like.collected), partly=True)
    collected = int(state.collected[0])
    about = {**step.about, "collected": collected}
    return Trained(str(directory), program, state.learner.policy, step.epoch, directory, collected, about)


def _from_file(path: Path, family: str | None, engine: str | None) -> Trained:
    about, arrays = read_policy(path)
    program = _program(path, about, family, engine or "auto")  # it may have been trained on another machine
    like = {"policy": _shapes(program).learner.policy}
    difference = first_difference(layout(named_leaves(like)), layout(arrays), partly=True)
    if difference:
        raise RunError(f"{path} does not fit its configuration: {difference}")
    directory = path.with_name(path.name.removesuffix(SUFFIX) + "-results")
    policies = rebuild(like, arrays)["policy"]
    return Trained(str(path), program, policies, about["epoch"], directory, about["collected"], about)


def _program(holder: Path, about: dict[str, Any], family: str | None, engine: str) -> Program:
    config = from_dict(about["config"])
    if family is None and config.family not in FAMILIES:
        raise UsageError(f"{holder} is of a family that is not ear_jax's own; name it: --family {config.family}")
    if family is not None and family.rpartition(":")[2] != config.family.rpartition(":")[2]:
        raise UsageError(f"{holder} is of family {config.family}, not {family}")
    program = training.make_program(replace(config, family=family or config.family, engine=engine))
    check_tasks(holder, about, program.tasks)
    return program


def _shapes(program: Program) -> TrainState:
    return jax.eval_shape(jax.vmap(partial(training.init, program)), training.seed_keys(program.config))
