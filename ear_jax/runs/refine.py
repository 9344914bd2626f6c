"""Refinement: a trained policy is improved by PPO, from whole episodes of all tasks, while its codes stay as they are.

SAC's critics do not resolve what a slightly better start or gait is worth; whole episodes do.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ear_jax.agents.networks import Params
from ear_jax.config import flat_tree
from ear_jax.errors import RunError, UsageError, counted
from ear_jax.learning.ppo import Ppo, PpoLearner, PpoState, batches
from ear_jax.process.runtime import compiler_options
from ear_jax.process.stopping import Stopped, StopRequest
from ear_jax.process.terminal import TrainingBar, phase, say
from ear_jax.runs import safetensors, training
from ear_jax.runs.leaves import first_difference, layout, named_leaves, rebuild
from ear_jax.runs.rollouts import check_rollouts
from ear_jax.runs.trained import Trained
from ear_jax.tasks import task_count

BLOCK = 10  # iterations between lines of progress and saves
WARM_UP = 10  # iterations in which only the value learns; a tenth of fewer than 100
RETURNS = "returns"  # the name, in a saved file, of those of each iteration
LAST = 0.1  # the last iteration's share of the divergence


@dataclass(frozen=True)
class Refinement:
    """Settings of a refinement."""

    iterations: int = 300
    ppo: Ppo = field(default_factory=Ppo)
    options: Mapping[str, Any] = field(default_factory=dict)  # of the family: what differs while the policy learns

    def divergence(self, number: int) -> float:
        """Returns the divergence that is wanted of an iteration, counted from 0."""
        share = 1 - (1 - LAST) * number / self.iterations
        return self.ppo.divergence * share if number >= min(WARM_UP, self.iterations // 10) else 0.0


@dataclass(frozen=True)
class Curve:
    """The learning curve of a refinement so far."""

    before: list[list[float]]  # returns of the policies that it began with, [seeds, tasks]
    iteration: int = 0
    seconds: float = 0.0
    returns: tuple[list[float], ...] = ()  # of each iteration with noise, the mean over tasks, [iterations, seeds]


def refine(
    trained: Trained, settings: Refinement, episodes: int = 20, seed: int = 0, part: Path | None = None
) -> tuple[Trained, dict[str, Any]]:
    """Refines every seed's policy.

    Args:
      trained: the run.
      settings: of the refinement.
      episodes: fresh episodes a task in which policies are compared before and after.
      seed: seeds everything.
      part: a file to save to every few iterations. If it is there, the refinement continues from it, with the same
        results as if it had never stopped.

    Returns:
      The refined policies, whose `about` tells of it, and the document that `ear refine --json` prints.

    Raises:
      UsageError: the agent finds its codes from experience, the family does not have an option, or `part` belongs to
        another refinement.
      RunError: the episodes do not fit in memory, the policy became infinite, or `part` is damaged or cannot be
        written.
      Stopped: a signal stopped it after it saved.
    """
    program, count = trained.program, trained.program.config.seeds
    if program.agent.finds_codes:
        raise UsageError(f"agent {program.config.agent!r} finds its codes from experience; ear refine needs fixed ones")
    family = training.family_with(program, settings.options)
    learner = PpoLearner(program.agent, family, program.tasks.params, settings.ppo)
    at_once = count * len(program.tasks) * max(episodes, learner.episodes)
    check_rollouts(program, at_once, family.episode_length, 2 * family.observation_size)
    key_learn, key_value, key_play = jax.random.split(jax.random.key(seed), 3)
    state = jax.vmap(learner.init)(trained.policies, jax.random.split(key_value, count))
    play = _player(trained, jax.random.split(key_play, count), episodes)
    about = {"of": trained.fingerprint, "seed": seed, "episodes": episodes, **asdict(settings)}
    if part is not None and part.exists():
        state, curve = _read(part, state, about)
        say(f"continuing {part} from iteration {curve.iteration}")
    else:
        curve = Curve(play(trained.policies).tolist())
    keep = partial(_write, part, about) if part is not None else None
    state, curve = _improve(learner, settings, state, curve, jax.random.split(key_learn, count), keep)
    after = play(state.policy)
    cost, options = _cost(learner, settings), {"options": dict(settings.options)} if settings.options else {}
    refined = replace(trained, policies=state.policy, about=_about(trained, cost, options, curve, after))
    document = {
        "run": trained.name,
        "episodes": episodes,
        **cost,
        **options,
        "seconds": round(curve.seconds, 2),
        "seeds": [_describe(trained, index, curve, after) for index in range(count)],
    }
    return refined, document


def _improve(
    learner: PpoLearner,
    settings: Refinement,
    state: PpoState,
    curve: Curve,
    keys: jax.Array,
    keep: Callable[[PpoState, Curve], None] | None,
) -> tuple[PpoState, Curve]:
    """Makes the iterations that are left; between them it saves, and stops if a signal asks for it."""
    improve = jax.jit(jax.vmap(learner.improve, (0, None, 0)), compiler_options=compiler_options())
    say(f"mean return before: {np.mean(curve.before):.1f}")
    told = curve  # at the last line of progress
    with (
        StopRequest(say, "iteration") as request,
        TrainingBar(curve.iteration, settings.iterations, "iteration") as bar,
    ):
        while curve.iteration < settings.iterations:
            began, number = time.perf_counter(), curve.iteration
            of_iteration = jax.vmap(jax.random.fold_in, (0, None))(keys, number)
            state, metrics = improve(state, jnp.float32(settings.divergence(number)), of_iteration)
            if not np.isfinite(np.asarray(metrics["divergence"])).all():
                raise RunError(f"the policy is not finite after iteration {number + 1}; try a smaller --divergence")
            returns = np.asarray(metrics["returns"]).mean(axis=-1).tolist()
            seconds = time.perf_counter() - began
            curve = Curve(curve.before, number + 1, curve.seconds + seconds, (*curve.returns, returns))
            ended = curve.iteration == settings.iterations
            signal = None if ended else request.signal
            if keep and (signal or ended or curve.iteration % BLOCK == 0):
                keep(state, curve)
            if ended or curve.iteration % BLOCK == 0:
                rate = len(keys) * (curve.iteration - told.iteration) / (curve.seconds - told.seconds)
                recent = float(np.mean(curve.returns[told.iteration :]))
                bar.update(curve.iteration, recent, *(rate * each for each in _per_iteration(learner)))
                told = curve
            if signal is not None:
                say(f"stopped at iteration {curve.iteration}" + "; the same command continues" * bool(keep))
                raise Stopped(signal)
    return state, curve


def _per_iteration(learner: PpoLearner) -> tuple[int, int]:
    """Returns the env steps and the updates of an iteration of one seed."""
    settings = learner.settings
    steps = task_count(learner.tasks) * learner.episodes * learner.family.episode_length
    return steps, settings.passes * batches(steps, settings.batch)[0]


def _player(trained: Trained, keys: jax.Array, episodes: int) -> Callable[[Params], np.ndarray]:
    """Returns a function that gives the mean returns [seeds, tasks] of policies, always from the same starts."""
    program = trained.program

    def of_seed(policy: Params, key: jax.Array) -> jax.Array:
        return training.evaluate(program, policy, key, episodes).returns.mean(axis=-1)

    of_all = jax.jit(jax.vmap(of_seed), compiler_options=compiler_options())

    def play(policies: Params) -> np.ndarray:
        with phase(f"playing {counted(episodes, 'episode')} of {counted(len(program.tasks), 'task')}"):
            return np.asarray(of_all(policies, keys))

    return play


def _write(part: Path, about: dict[str, Any], state: PpoState, curve: Curve) -> None:
    """Saves what has been reached."""
    arrays = {name: np.asarray(leaf) for name, leaf in named_leaves(state).items()}
    arrays[RETURNS] = np.array(curve.returns, np.float32).reshape(curve.iteration, -1)
    metadata = {"refinement": json.dumps(about), "course": json.dumps(asdict(replace(curve, returns=())))}
    safetensors.write(part, arrays, {**metadata, "sha256": safetensors.digest(arrays, metadata)})


def _read(part: Path, like: PpoState, about: dict[str, Any]) -> tuple[PpoState, Curve]:
    """Reads what `_write` has saved; raises UsageError if it belongs to another refinement, RunError if damaged."""
    try:
        arrays, metadata = safetensors.read(part)
        if metadata.pop("sha256", None) != safetensors.digest(arrays, metadata):
            raise RunError(f"{part} is damaged")
        if not (RETURNS in arrays and {"refinement", "course"} <= metadata.keys()):
            raise RunError(f"{part} holds no refinement of this version")
    except RunError as error:
        raise RunError(f"{error}; delete it to begin anew") from None
    returns = arrays.pop(RETURNS).tolist()
    found, wanted = (flat_tree(one) for one in (json.loads(metadata["refinement"]), json.loads(json.dumps(about))))
    changed = [f"{name} was {found.get(name)}, is {wanted[name]}" for name in wanted if found.get(name) != wanted[name]]
    if changed or first_difference(layout(named_leaves(like)), layout(arrays)):
        reason = "; ".join(changed) or "the policy has other sizes"
        raise UsageError(f"{part} is of another refinement ({reason}); give the same settings, or name another file")
    return rebuild(like, arrays), Curve(**{**json.loads(metadata["course"]), "returns": tuple(returns)})


def _cost(learner: PpoLearner, settings: Refinement) -> dict[str, int]:
    """Returns the iterations, and the env steps and updates of a seed."""
    steps, updates = _per_iteration(learner)
    number = settings.iterations
    return {"iterations": number, "env_steps": number * steps, "updates": number * updates}


def _about(
    trained: Trained, cost: dict[str, int], options: dict[str, Any], curve: Curve, after: np.ndarray
) -> dict[str, Any]:
    """Returns what a refined policy's file tells of it; the costs of earlier refinements are included."""
    earlier, before = trained.about.get("refined", {}), np.array(curve.before)
    refined = {
        **{name: value + earlier.get(name, 0) for name, value in cost.items()},
        **options,
        "from": trained.fingerprint,
        "mean_returns": [[float(one.mean()) for one in pair] for pair in zip(before, after, strict=True)],
    }
    return {**trained.about, "refined": refined}


def _describe(trained: Trained, index: int, curve: Curve, after: np.ndarray) -> dict[str, Any]:
    """Turns one seed's returns into its part of the document."""
    return {
        "seed": trained.program.config.seed + index,
        "tasks": trained.program.tasks.names,
        "before": float(np.mean(curve.before[index])),
        "after": float(after[index].mean()),
        "returns_before": curve.before[index],
        "returns_after": after[index].tolist(),
        "course": [round(returns[index], 3) for returns in curve.returns],
    }
