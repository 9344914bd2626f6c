"""Physics engines: one environment step of a MuJoCo model, written for one simulation and batched by `jax.vmap`."""

from ear_jax.physics.engine import ENGINES, choose_engine, make_engine
from ear_jax.physics.state import Engine, Motion, Physics

__all__ = ["ENGINES", "Engine", "Motion", "Physics", "choose_engine", "make_engine"]
