"""Meta-World's Sawyer arm, found in the installed package, as a model that MJX can step."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import mujoco

from ear_jax.errors import RunError

HAND_START = (0.0, 0.6, 0.2)  # metres: where Meta-World leads the hand before an episode
MOCAP_TURN = (1.0, 0.0, 1.0, 0.0)  # quaternion: the gripper points down
INSTALL = "pip install 'ear-jax[reach]'"
_CLAWS = ("rightclaw_it", "leftclaw_it")  # the only shapes that inertia is computed from


def reach_model_path() -> Path:
    """Where the installed `metaworld` keeps its scene for reaching, found without importing it.

    Raises:
      RunError: it is not installed, or has no such scene.
    """
    spec = importlib.util.find_spec("metaworld")
    if spec is None or not spec.submodule_search_locations:
        raise RunError(f"the arm comes from the 'metaworld' package, which is not installed: {INSTALL}")
    path = Path(spec.submodule_search_locations[0]) / "assets" / "sawyer_xyz" / "sawyer_reach_v3.xml"
    if not path.is_file():
        raise RunError(f"this 'metaworld' has no {path.name}: {INSTALL}")
    return path


def load_arm() -> mujoco.MjModel:
    """The arm alone, led by the hand: 7 hinges, 2 fingers that slide, and a mocap body that the hand is welded to.

    Table, puck, walls and all shapes but the claws go, and with them every contact; inertias stay. So the arm moves as
    in the whole scene, to rounding, where it touches nothing there: not the puck, which may stand below where the hand
    starts, nor a wall. MJX takes neither the shapes nor the elliptic cone.
    """
    spec = _scene()
    for geom in list(spec.geoms):
        if geom.name not in _CLAWS:
            spec.delete(geom)
    for geom in spec.geoms:
        geom.contype = geom.conaffinity = 0
        geom.material = ""
    for unused in (spec.meshes, spec.materials, spec.textures, spec.cameras, spec.lights):
        for element in list(unused):
            spec.delete(element)
    for name in ("obj", "tablelink", "RetainingWall"):
        spec.delete(spec.body(name))
    spec.compiler.fusestatic = True
    spec.option.cone = mujoco.mjtCone.mjCONE_PYRAMIDAL
    return spec.compile()


def draw_arm() -> mujoco.MjModel:
    """The same arm, of the same qpos, with its shapes and the table before it, turned to face one who looks along y."""
    spec = _scene()
    for name in ("obj", "RetainingWall", "mocap"):
        spec.delete(spec.body(name))
    for body in spec.worldbody.bodies:
        x, y, z = body.pos
        body.pos, body.quat = (-x, -y, z), (0, 0, 0, 1)  # by half a turn; none was turned before
    return spec.compile()


def _scene() -> mujoco.MjSpec:
    """Meta-World's scene with its weld: the hand is held where the mocap body is, and as it is turned."""
    spec = mujoco.MjSpec.from_file(str(reach_model_path()))
    spec.body("mocap").quat = MOCAP_TURN
    (weld,) = spec.equalities
    weld.data[:3] = 0  # anchor
    weld.data[3:10] = (0, 0, 0, -1, 0, 0, 0)  # relative pose
    weld.data[10] = 5  # of the torque
    return spec
