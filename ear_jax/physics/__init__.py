"""Physics engines: one environment step of a MuJoCo model, written for one simulation and batched by `jax.vmap`."""

from ear_jax.physics.engine import ENGINES, Engine, Motion, Physics, choose_engine, make_engine

__all__ = ["ENGINES", "Engine", "Motion", "Physics", "choose_engine", "make_engine"]
