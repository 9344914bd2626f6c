"""The solver without waits: its arithmetic against NumPy and plain loops, its steps against MJX's own."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from ear_jax.errors import RunError
from ear_jax.physics import Physics, make_engine
from ear_jax.physics.fixed_solver import LARGEST, _solve, masked_loop, solve_small, solver_of_mjx
from ear_jax.physics.models import load_model
from tests.physics.test_physics import random_states

BALL = """
<mujoco>
  <option timestep="0.01"/>
  <worldbody>
    <geom type="plane" size="5 5 0.1"/>
    <body pos="0 0 0.3">
      <joint name="x" type="slide" axis="1 0 0"/>
      <joint name="z" type="slide" axis="0 0 1"/>
      <joint name="y" type="hinge" axis="0 1 0" damping="0.1"/>
      <geom type="sphere" size="0.1"/>
    </body>
  </worldbody>
  <actuator><motor joint="y" gear="5"/></actuator>
</mujoco>
"""


def systems(size: int, count: int = 20):
    rng = np.random.default_rng(size)
    roots = rng.standard_normal((count, size, size))
    return roots @ roots.transpose(0, 2, 1) + np.eye(size), rng.standard_normal((count, size))


@pytest.mark.parametrize("size", [1, 3, 9])
def test_small_systems_are_solved_as_numpy_solves_them(size):
    matrices, vectors = systems(size)
    expected = np.linalg.solve(matrices, vectors[..., None])[..., 0]
    found = jax.jit(jax.vmap(solve_small))(jnp.float32(matrices), jnp.float32(vectors))
    np.testing.assert_allclose(found, expected, atol=2e-6 * np.abs(expected).max())


def test_only_the_lower_triangle_is_read_and_large_systems_go_to_the_library():
    matrices, vectors = systems(3, 1)
    above = np.triu(np.full((3, 3), np.nan), 1)
    np.testing.assert_array_equal(
        solve_small(jnp.float32(matrices[0] + above), jnp.float32(vectors[0])),
        solve_small(jnp.float32(matrices[0]), jnp.float32(vectors[0])),
    )
    matrices, vectors = systems(LARGEST + 1, 1)
    found = _solve((jnp.float32(matrices[0]), False), jnp.float32(vectors[0]))
    np.testing.assert_allclose(found, np.linalg.solve(matrices[0], vectors[0]), rtol=1e-3, atol=1e-5)


@pytest.mark.parametrize("unroll", [False, True])
def test_a_loop_of_fixed_length_ends_each_of_a_batch_where_it_would_end(unroll):
    def going(state):
        return state["value"] > 1.0

    def halve(state):
        return {"value": state["value"] / 2, "count": state["count"] + 1}

    values = jnp.array([0.5, 2.0, 8.0, 1000.0])
    fixed = jax.vmap(lambda value: masked_loop(going, halve, {"value": value, "count": 0}, 6, unroll))(values)
    np.testing.assert_array_equal(fixed["count"], [0, 1, 3, 6])
    np.testing.assert_array_equal(fixed["value"], [0.5, 1.0, 1.0, 1000 / 64])


def test_mjx_is_as_it_was_outside_of_tracing():
    from mujoco.mjx._src import forward, smooth, solver

    loop = solver._while_loop_scan

    def fail():
        with solver_of_mjx(4):
            assert solver.jax is not jax
            assert smooth.jax.scipy.linalg.cho_solve is _solve
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        fail()
    assert solver.jax is smooth.jax is forward.jax is jax
    assert solver._while_loop_scan is loop
    with solver_of_mjx(None):
        assert solver.jax is jax


def test_another_solver_than_the_one_that_is_known_is_refused(monkeypatch):
    from mujoco.mjx._src import solver

    monkeypatch.setattr(solver, "solve", lambda model, data: data)
    known = r"engine mjx-fixed does not know the solver of mujoco-mjx .*; use --engine mjx"
    with pytest.raises(RunError, match=known), solver_of_mjx(4):
        pass
    assert solver.jax is jax


def trajectory(engine, physics, actions):
    """Returns qpos after each of a number of steps, [steps, states, nq]."""

    def step(physics, action):
        after = jax.vmap(engine.step)(physics, action).after
        return after, after.qpos

    return jax.jit(lambda physics: jax.lax.scan(step, physics, actions)[1])(physics)


def test_a_ball_falls_bounces_and_rolls_as_in_mujoco():
    """Starts above the ground and in it, for 40 steps; measured: 4e-7."""
    model, rng = mujoco.MjModel.from_xml_string(BALL), np.random.default_rng(0)
    qpos, qvel = (rng.uniform(-0.25, 0.25, (8, 3)).astype(np.float32) for _ in range(2))
    actions = rng.uniform(-1, 1, (40, 8, 1)).astype(np.float32)
    engine = make_engine("mjx-fixed", model, 1, (), (3, 3))
    found = trajectory(engine, Physics(qpos, qvel, np.zeros((8, 3), np.float32)), actions)
    expected = np.zeros(found.shape)
    for ball in range(8):
        data = mujoco.MjData(model)
        data.qpos[:], data.qvel[:] = qpos[ball], qvel[ball]
        for step in range(40):
            data.ctrl[:] = actions[step, ball]
            mujoco.mj_step(model, data)
            expected[step, ball] = data.qpos
    assert expected[:, :, 1].min() < -0.19, "some touch the ground"
    np.testing.assert_allclose(found, expected, atol=1e-5)


@pytest.mark.slow
def test_the_cheetah_runs_as_on_mjx():
    """From 64 states as training meets them, for 20 steps of MuJoCo; measured: 1.2e-5 and less."""
    model = load_model("half_cheetah.xml")
    *start, _ = random_states(model, 64)
    actions = np.random.default_rng(1).uniform(-1, 1, (20, 64, model.nu)).astype(np.float32)
    one, other = (
        trajectory(make_engine(name, model, 1, (), (4, 8)), Physics(*start), actions) for name in ("mjx", "mjx-fixed")
    )
    gaps = np.abs(one - other).max(axis=(1, 2))
    assert gaps[0] < 1e-5
    assert gaps.max() < 1e-4
