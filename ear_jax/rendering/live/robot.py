"""The page's description of one trained robot: its model, its programs, its shapes and its coloured sphere."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from ear_jax.agents import Agent
from ear_jax.agents.networks import Params
from ear_jax.agents.tanh_gaussian import squash
from ear_jax.embeddings.map import check_sphere, training_ltes
from ear_jax.envs import Family
from ear_jax.physics import Motion
from ear_jax.rendering.live.ground import Ground, colour_sphere
from ear_jax.rendering.live.model import portable
from ear_jax.rendering.live.programs import Constants, translate
from ear_jax.rendering.live.shapes import between, shapes
from ear_jax.rendering.scene import limbs, locomotion_of
from ear_jax.runs.trained import Trained, policy_of

STARTS = 16  # random starts in the page
WINDOW = 1.0  # seconds over which the page averages what it shows


def describe(trained: Trained, policy: int, places: int, seed: int) -> tuple[dict[str, Any], str]:
    """Describes a robot for the page.

    Args:
      trained: the run.
      policy: index of the policy; 0 is the first seed's.
      places: LTEs rolled out for the colours of the sphere.
      seed: seeds all starts.

    Returns:
      The description, as JSON, and the constants of its programs, packed.

    Raises:
      UsageError: the agent has no LTEs on a sphere in three dimensions, or the page cannot compute the family.
    """
    check_sphere(trained, 3)
    program, family = trained.program, trained.program.family
    agent, params, constants = program.agent, policy_of(trained, policy), Constants()
    programs = translate_all(family, agent, params, constants)
    model = portable(family)
    codes = np.asarray(agent.codes(params))
    ground = colour_sphere(trained, params, places, seed)
    return {
        "name": family.name,
        "title": f"{family.name}: one policy, every task embedding",
        "quantities": [_quantity(family, ground, *pair) for pair in _asked(trained)],
        "ground": {
            "size": ground.size,
            "fell": ground.packed(ground.fell, 0, 1),
            "falls": bool(ground.fell.max() > 0.1),
        },
        "tasks": [
            {**task, "goal": family.goal(one), "asks": _asked(trained).index(family.asks(one))}
            for task, one in zip(training_ltes(program.tasks, codes), program.tasks.tasks, strict=True)
        ],
        "model": model,
        "starts": starts(family, seed),
        "bodies": [family.model.body(name).id for name in family.bodies],
        "substeps": family.substeps,
        "history": family.history,
        "outcomes": sorted(_shapes(family)[3]),
        "window": WINDOW,
        "programs": programs,
        "view": view(family),
    }, constants.packed()


def translate_all(family: Family, agent: Agent, params: Params, constants: Constants) -> dict[str, Any]:
    """Translates a family and a policy into the page's programs.

    A state is qpos, qvel, warmstart and, where the model has them, positions of mocap bodies and activations.
    """
    physics, motion, obs, outcome = _shapes(family)
    action, code = jnp.zeros(family.action_size), jnp.zeros(agent.code_size)

    def act(obs: jax.Array, code: jax.Array) -> jax.Array:
        return squash(agent.distribution(params, code, obs), jnp.zeros(family.action_size))

    def actuate(physics: Any, action: jax.Array) -> tuple[jax.Array, Any]:
        state, control = family.actuate(physics, action)
        return control, state

    return {
        "act": translate(act, constants, jnp.tile(obs, family.history), code),
        "observe": translate(family.observe, constants, physics),
        "actuate": translate(actuate, constants, physics, action),
        "outcome": translate(family.outcome, constants, motion),
        "achieved": translate(family.achieved, constants, outcome, outcome),
        "terminated": translate(family.terminated, constants, physics),
    }


def starts(family: Family, seed: int) -> list[list[list[float]]]:
    """Draws random starts, each with its leaves as in a state."""
    drawn = jax.vmap(family.initial)(jax.random.split(jax.random.key(seed), STARTS))
    leaves = [np.asarray(leaf).reshape(STARTS, -1).astype(float).round(7).tolist() for leaf in jax.tree.leaves(drawn)]
    return [list(start) for start in zip(*leaves, strict=True)]


def view(family: Family) -> dict[str, Any]:
    """Returns what the page needs to draw the robot: its shapes, its size and its first pose."""
    portrait, model = family.portrait(), family.model
    qpos = np.asarray(family.initial(jax.random.key(0)).qpos)
    robot, data = limbs(portrait, qpos[None]), mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_kinematics(model, data)
    turn, shift = between(portrait, model)
    return {
        "locomotion": locomotion_of(model),
        "length": round(robot.length, 3),
        "top": round(robot.top, 3),
        "centre": np.round(turn @ robot.centres[0] + shift, 3).tolist(),
        "forward": np.round(turn[:2, 1], 4).tolist(),  # a camera looks along y in the portrait
        "shapes": shapes(portrait, model),
        "first": {"xpos": data.xpos.round(4).ravel().tolist(), "xmat": data.xmat.round(4).ravel().tolist()},
    }


def _asked(trained: Trained) -> list[tuple[str, str]]:
    """Lists the outcomes that the training tasks ask for with their units, the commanded one first."""
    family = trained.program.family
    asked = [(family.commanded, family.unit), *map(family.asks, trained.program.tasks.tasks)]
    return list(dict.fromkeys(asked))


def _quantity(family: Family, ground: Ground, name: str, unit: str) -> dict[str, Any]:
    period = family.period if name == family.commanded else None
    shades, low, high = ground.scale(name, period)
    return {
        "name": name,
        "unit": unit,
        "period": period,
        "scale": [low, high],
        "shades": shades,
        "ground": ground.packed(ground.values[name], low, high),
    }


def _shapes(family: Family) -> tuple[Any, Motion, jax.Array, dict[str, jax.Array]]:
    """Returns a state, a motion, an observation and an outcome of the right shapes, all zeros."""
    physics = jax.eval_shape(family.initial, jax.random.key(0))
    control = jax.ShapeDtypeStruct((family.model.nu,), jnp.float32)
    positions = jax.ShapeDtypeStruct((len(family.bodies), 3), jnp.float32)
    motion = Motion(physics, control, physics, positions)  # type: ignore[arg-type]
    obs, outcome = jax.eval_shape(family.observe, physics), jax.eval_shape(family.outcome, motion)
    return jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), (physics, motion, obs, outcome))
