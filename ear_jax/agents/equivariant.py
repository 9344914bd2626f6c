"""Equivariance: what an agent does turns with the robot, where the robot has symmetries.

A situation is turned and mirrored into the canonical sector of the plane, where the networks see it; what they say is
turned back. So one network learns once what symmetric tasks share (van der Pol et al. 2020, arXiv 2006.16908; by
canonicalisation: Kaba et al. 2023, arXiv 2211.06489). An LTE's first two numbers are a vector of the plane. A one-hot
turns with its task.
"""

from __future__ import annotations

import math
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np

from ear_jax.agents.agent import Agent
from ear_jax.agents.critic import seen_as
from ear_jax.agents.networks import Params, Standardiser
from ear_jax.agents.tanh_gaussian import Gaussian
from ear_jax.envs.symmetry import Symmetry, origins
from ear_jax.process.target import exact_matmul
from ear_jax.tasks import TaskParams

TIE = 1e-5  # by which an earlier value wins where two are as large


def equivariant(agent: Agent, symmetry: Symmetry, tasks: TaskParams) -> Agent:
    """Wraps an agent so that symmetric tasks have symmetric LTEs, and act alike; critics value them alike.

    What it embeds and forecasts stays as it is: that depends on no task, so there is nothing to turn by.

    Args:
      agent: whose codes are one-hots, or LTEs of two numbers or more.
      symmetry: the family's.
      tasks: params, each leaf [tasks].
    """
    directions = jnp.stack([jnp.float32(tasks[name]) for name in symmetry.direction], axis=1)
    nearest_variants = jax.vmap(lambda direction: nearest(symmetry, direction))(directions)
    canonical = np.asarray(jax.vmap(symmetry.plane.select)(nearest_variants, directions))
    to_sector = np.asarray(nearest_variants)  # [tasks, variants], one-hots
    source, exists = origins(symmetry, tasks)
    first = np.where(exists, source, len(to_sector)).min(axis=0)  # the first task that is symmetric to each
    turns = _turns(symmetry, to_sector, canonical)
    inverse = symmetry.action.inverse

    def canonical_code(code: jax.Array) -> tuple[jax.Array, jax.Array]:
        if agent.one_hot:
            return _largest(code) @ to_sector, code @ np.eye(len(first), dtype=np.float32)[first]
        variant = nearest(symmetry, code)
        return variant, turned(symmetry, variant, code)

    def codes(policy: Params) -> jax.Array:
        table = jax.vmap(lambda code: turned(symmetry, nearest(symmetry, code), code))(agent.codes(policy)[first])
        with exact_matmul():
            plane = jnp.einsum("tij,tj->ti", turns, table[:, :2])
        return jax.vmap(agent.project)(jnp.concatenate([plane, table[:, 2:]], axis=1))

    def distribution(policy: Params, code: jax.Array, obs: jax.Array) -> Gaussian:
        variant, code = canonical_code(code)
        seen = agent.distribution(policy, code, symmetry.obs.select(variant, obs))
        return Gaussian(inverse.select(variant, seen.mean), inverse.unsigned.select(variant, seen.log_std))

    def canonical_input(obs: jax.Array, action: jax.Array, task: jax.Array) -> tuple[jax.Array, ...]:
        count = 0 if agent.critic_task == "lte" else len(first)
        one_hot, code = task[:count], task[count:]
        variant = one_hot @ to_sector if count else nearest(symmetry, code)
        one_hot = one_hot @ np.eye(count, dtype=np.float32)[first] if count else one_hot
        code = turned(symmetry, variant, code) if len(code) else code
        task = jnp.concatenate([one_hot, code])
        return symmetry.obs.select(variant, obs), symmetry.action.select(variant, action), task

    def canonical_task(obs: jax.Array, task: jax.Array) -> tuple[jax.Array, jax.Array]:
        return symmetry.obs.select(jnp.asarray(to_sector)[task], obs), jnp.asarray(first)[task]

    critic = agent.critic and seen_as(agent.critic, canonical_input)
    return replace(
        agent,
        codes=agent.codes if agent.one_hot else codes,
        distribution=distribution,
        critic=critic,
        canonical=canonical_task,
    )


def nearest(symmetry: Symmetry, vector: jax.Array) -> jax.Array:
    """Returns the one-hot [variants] of the variant that brings a vector's first two numbers into the sector."""
    middle = math.pi / symmetry.variants
    each = vector[:2][symmetry.plane.order] * symmetry.plane.sign
    return _largest(jnp.sum(each * np.array([math.cos(middle), math.sin(middle)], np.float32), axis=1))


def _largest(values: jax.Array) -> jax.Array:
    """Returns the one-hot of the largest value, of the first where several are as large."""
    ranked = jax.lax.stop_gradient(values) - TIE * np.arange(len(values))
    return (ranked == jnp.max(ranked)).astype(jnp.float32)


def turned(symmetry: Symmetry, variant: jax.Array, code: jax.Array) -> jax.Array:
    """Applies the variant that a one-hot selects to an LTE's first two numbers."""
    return jnp.concatenate([symmetry.plane.select(variant, code[:2]), code[2:]])


def symmetrised(standardiser: Standardiser, symmetry: Symmetry) -> Standardiser:
    """Returns the statistics of observations together with all their variants."""
    variants = jnp.arange(symmetry.variants)
    means = jax.vmap(symmetry.obs, (0, None))(variants, standardiser.mean)
    variances = jax.vmap(symmetry.obs.unsigned, (0, None))(variants, standardiser.scale**-2)
    mean = jnp.mean(means, axis=0)
    return Standardiser(mean, jax.lax.rsqrt(jnp.mean(variances + (means - mean) ** 2, axis=0)))


def _turns(symmetry: Symmetry, to_sector: np.ndarray, canonical: np.ndarray) -> np.ndarray:
    """Returns the maps [tasks, 2, 2] of LTEs' plane vectors from the sector to where tasks have theirs.

    A direction on the sector's edge is its own mirror image, so its LTE must be, too: it is brought to the edge first.
    """
    each = np.eye(2, dtype=np.float32)[symmetry.plane.order] * symmetry.plane.sign[..., None]  # [variants, 2, 2]
    moved = np.einsum("vij,tj->tvi", each, canonical)
    fixes = (np.linalg.norm(moved - canonical[:, None], axis=-1) < 1e-4).astype(np.float32)
    to_edge = np.einsum("tv,vij->tij", fixes / fixes.sum(axis=1, keepdims=True), each)
    back = np.einsum("tv,vij->tji", to_sector, each)  # orthogonal: the transposed is the inverse
    return back @ to_edge
