"""Trained policies for use: from a run's newest checkpoint, an exported file or a pretrained agent."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import jax
import numpy as np

from ear_jax import pretrained
from ear_jax.agents.networks import Params
from ear_jax.config import env_flags, from_dict
from ear_jax.envs import FAMILIES
from ear_jax.errors import RunError, UsageError
from ear_jax.limits import check
from ear_jax.pretrained import SUFFIX
from ear_jax.process.runtime import compiler_options
from ear_jax.process.terminal import say
from ear_jax.runs import checkpoint, training
from ear_jax.runs.checkpoint import Step
from ear_jax.runs.directory import check_path, check_tasks
from ear_jax.runs.documents import changed_code
from ear_jax.runs.export import read_about, read_policy, write_policy
from ear_jax.runs.history import read_step
from ear_jax.runs.leaves import first_difference, layout, named_leaves, rebuild
from ear_jax.runs.seeds import seed_range
from ear_jax.runs.training import Program


@dataclass(frozen=True)
class Trained:
    """The policies of a run, one per seed."""

    name: str  # as the user wrote it
    program: Program
    policies: Params  # each leaf [seeds, …]
    epoch: int
    directory: Path = Path()  # for the results of analyses
    collected: int = 0  # epochs of collection
    about: dict[str, Any] = field(default_factory=dict)  # as saved: configuration, tasks, versions, machine

    @property
    def env_steps(self) -> int:
        """Environment steps per seed of training and of refinements."""
        refined: dict[str, int] = self.about.get("refined", {})
        return self.program.env_steps(self.collected) + refined.get("env_steps", 0)

    @property
    def fingerprint(self) -> str:
        """A short hash of the policies' parameters."""
        digest = hashlib.sha256()
        for leaf in jax.tree.leaves(jax.device_get(self.policies)):
            digest.update(leaf.tobytes())
        return digest.hexdigest()[:16]


def for_each_seed(trained: Trained, of_seed: Callable[..., Any], seed: int, *arguments: Any) -> Any:
    """Applies a function to every seed's policy in one compiled call.

    Args:
      trained: the policies.
      of_seed: (policy, key, …) → a pytree.
      seed: seeds the keys, one per policy.
      *arguments: further arguments of `of_seed`, each leaf [seeds, …].

    Returns:
      The pytree on the host, each leaf [seeds, …].
    """
    keys = jax.random.split(jax.random.key(seed), trained.program.config.seeds)
    for_all = jax.jit(jax.vmap(of_seed), compiler_options=compiler_options())
    return jax.device_get(for_all(trained.policies, keys, *arguments))


def policy_of(trained: Trained, index: int) -> Params:
    """Returns the policy of one seed, each leaf without the axis of seeds; index 0 is the first seed."""
    return jax.tree.map(lambda leaf: leaf[index], trained.policies)


def pick(trained: Trained, policy: int) -> Trained:
    """Selects the policy of one seed, as if that seed had been trained alone.

    Args:
      trained: the policies.
      policy: its index; 0 is the first seed.

    Returns:
      That policy; `about` says how many seeds were trained together.

    Raises:
      UsageError: the index is out of range.
    """
    check_policy(trained, policy)
    config, seed = trained.program.config, trained.program.config.seed + policy
    if config.seeds == 1:
        return trained
    policies = jax.tree.map(lambda leaf: leaf[policy : policy + 1], trained.policies)
    program = replace(trained.program, config=replace(config, seed=seed, seeds=1))
    alone = {**trained.about["config"], "seed": seed, "seeds": 1}
    about = {**trained.about, "config": alone, "side_by_side": config.seeds}
    if refined := about.get("refined"):
        about["refined"] = {**refined, "mean_returns": refined["mean_returns"][policy : policy + 1]}
    return replace(trained, program=program, policies=policies, about=about)


def check_policy(trained: Trained, policy: int) -> None:
    """Raises UsageError for a policy that a run does not have."""
    seeds = trained.program.config.seeds
    if not 0 <= policy < seeds:
        policies = "1 policy, number 0" if seeds == 1 else f"{seeds} policies, numbered from 0"
        raise UsageError(f"--policy {policy} is out of range: this run has {policies}")


def load(path: Path | str, family: str | None = None, engine: str | None = None) -> Trained:
    """Reads the policies of a run's newest good checkpoint, of an exported file, or of a pretrained agent.

    Args:
      path: the run's directory, a file from `ear export`, or `pretrained:NAME`.
      family: the family, as `ear train` takes it. A family from outside ear_jax must be named here, so that a file
        alone cannot cause code to run.
      engine: the physics engine; by default that of the run, and `auto` for a file.

    Raises:
      UsageError: there is no such run or pretrained agent, or its family has to be named.
      RunError: there is no undamaged checkpoint, or the engine cannot run here.
    """
    path = Path(path)
    if str(path).startswith(pretrained.PREFIX):
        name = str(path).removeprefix(pretrained.PREFIX)
        trained = _from_file(pretrained.find(name), family, engine)
        return replace(trained, name=str(path), directory=pretrained.results(name))
    check_path(path)
    return (_from_file if path.is_file() else _from_run)(path, family, engine)


def results_of(file: Path) -> Path:
    """Returns the directory of results about an exported file."""
    return file.with_name(file.name.removesuffix(SUFFIX) + "-results")


def save(file: Path, trained: Trained, rows: list[dict[str, Any]]) -> str:
    """Writes policies to a file for `load` and returns its card; see `describe` and `write_policy`."""
    about = {name: value for name, value in trained.about.items() if name != "leaves"}
    arrays = "policy.* are the networks' parameters [seeds, …], codes the table [seeds, tasks, code]"
    card = f"{describe(trained, rows)}\n{arrays}"
    codes = jax.vmap(trained.program.agent.codes)(trained.policies)
    write_policy(file, _without_codes(trained.policies), codes, about, card)
    return card


def describe(trained: Trained, rows: list[dict[str, Any]]) -> str:
    """Returns the card of an exported file: a description of its policies for people.

    Args:
      trained: the policies.
      rows: the run's metrics; the mean return of these policies at their epoch is taken from them.
    """
    program, about = trained.program, trained.about
    config, versions = program.config, about["versions"]
    seeds = range(config.seed, config.seed + config.seeds)
    returns = [row["mean_return"] for row in rows if row["epoch"] == trained.epoch and row["seed"] in seeds]
    refined = about.get("refined")
    together = f", one of {about['side_by_side']} trained together" if "side_by_side" in about else ""
    mean_return = f", mean return {sum(returns) / len(returns):.1f}" if returns else ""
    return "\n".join(
        [
            f"{config.family}, agent {config.agent}, preset {config.preset}, {seed_range(config)}{together}",
            f"tasks, in the order of the code table: {', '.join(program.tasks.names)}",
            f"trained for {trained.epoch} epochs, {program.env_steps(trained.collected):,} env steps and "
            f"{trained.epoch * config.sac.updates:,} updates per seed{mean_return}",
            *([_describe_refinement(refined)] if refined else []),
            f"ear_jax {versions.get('ear_jax', 'of an unknown version')}, "
            f"engine {about['engine']}, mujoco {versions.get('mujoco')}, jax {versions.get('jax')}, "
            f"commit {about.get('commit')}",
        ]
    )


def _describe_refinement(refined: dict[str, Any]) -> str:
    before, after = (sum(of_seeds) / len(of_seeds) for of_seeds in zip(*refined["mean_returns"], strict=True))
    return (
        f"refined by PPO{env_flags(refined.get('options', {}))}: {refined['env_steps']:,} env steps and "
        f"{refined['updates']:,} gradient steps per seed, mean return {before:.1f} before, {after:.1f} after"
    )


def _from_run(directory: Path, family: str | None, engine: str | None) -> Trained:
    step = read_step(directory, say)
    try:
        return _from_step(step, directory, family, engine)
    except RunError:
        if step.path.exists():
            raise
    return _from_run(directory, family, engine)  # a process that trains has removed it meanwhile, after a newer one


def _from_step(step: Step, directory: Path, family: str | None, engine: str | None) -> Trained:
    program = _program(directory, step.about, family, engine or step.about["config"]["engine"])
    like = _of_each_seed(program, partial(training.init, program))
    empty = jax.tree.map(lambda _: None, like)
    learner = replace(empty.learner, policy=like.learner.policy)
    state = checkpoint.restore(step, replace(empty, learner=learner, collected=like.collected), partly=True)
    collected = int(state.collected[0])
    about = {**step.about, "collected": collected}
    policies = _finite(state.learner.policy, step.path)
    return Trained(str(directory), program, policies, step.epoch, directory, collected, about)


def _from_file(path: Path, family: str | None, engine: str | None) -> Trained:
    about, header = read_about(path)
    program = _program(path, about, family, engine or "auto")  # not the saved engine: it may come from another machine
    policies = _of_each_seed(program, program.agent.init_policy)
    like = {"policy": _without_codes(policies)}
    if program.agent.finds_codes:
        like["codes"] = policies["codes"]
    difference = first_difference(layout(named_leaves(like)), layout(header.entries), partly=True)
    if difference:
        raise RunError(f"{path} does not fit its configuration: {difference}")
    found = rebuild(like, read_policy(path, header))
    policies = _finite({**found.pop("policy"), **found}, path)
    return Trained(str(path), program, policies, about["epoch"], results_of(path), about["collected"], about)


def _finite(policies: Params, holder: Path) -> Params:
    """Returns policies; raises RunError if any number of them is not finite."""
    if not all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(jax.device_get(policies))):
        raise RunError(f"{holder} holds a policy that is not finite: its training diverged")
    return policies


def _without_codes(policies: Params) -> Params:
    """Returns policies without the code table that some agents find: a file has it beside the policy."""
    return {name: leaf for name, leaf in policies.items() if name != "codes"}


def _program(holder: Path, about: dict[str, Any], family: str | None, engine: str) -> Program:
    try:
        config = from_dict(about["config"])
        check(config)
    except UsageError as error:
        raise RunError(f"{holder} has settings that cannot be used: {error}") from None
    if family is None and config.family not in FAMILIES:
        asked = f"--family {config.family}, in Python family={config.family!r}"
        raise UsageError(f"{holder} uses a family from outside ear_jax; to run its code, add {asked}")
    if family is not None and family.rpartition(":")[2] != config.family.rpartition(":")[2]:
        raise UsageError(f"{holder} was trained on family {config.family}, not {family}")
    program = training.make_program(replace(config, family=family or config.family, engine=engine))
    check_tasks(holder, about, program.tasks)
    if changed := changed_code(holder, about, program):
        say(f"warning: {changed}, so its policies may do otherwise here")
    return program


def _of_each_seed(program: Program, init: Callable[[jax.Array], Any]) -> Any:
    """Returns the shapes of what `init` makes of every seed's key, each leaf [seeds, …]; nothing is allocated."""
    return jax.eval_shape(lambda: jax.vmap(init)(training.seed_keys(program.config)))
