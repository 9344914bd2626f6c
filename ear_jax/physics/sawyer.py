"""Meta-World's Sawyer arm, read from the installed package and reduced to a model that MJX can step."""

from __future__ import annotations

from pathlib import Path

import mujoco

from ear_jax.errors import RunError
from ear_jax.physics.models import package_directory

HAND_START = (0.0, 0.6, 0.2)  # metres: the hand's position when an episode starts
GRIPPER_DOWN = (1.0, 0.0, 1.0, 0.0)  # quaternion of the mocap body
INSTALL = "pip install 'ear-jax[reach]'"
_CLAWS = ("rightclaw_it", "leftclaw_it")  # the only geoms that inertia is computed from


def reach_model_path() -> Path:
    """Returns the path of the reaching scene in the installed `metaworld`, without importing it.

    Raises:
      RunError: it is not installed or has no such scene.
    """
    package = package_directory("metaworld")
    if package is None:
        raise RunError(f"the arm comes from the 'metaworld' package, which is not installed: {INSTALL}")
    path = package / "assets" / "sawyer_xyz" / "sawyer_reach_v3.xml"
    if not path.is_file():
        raise RunError(f"the installed 'metaworld' has no {path.name}: {INSTALL}")
    return path


def load_arm() -> mujoco.MjModel:
    """Compiles the arm alone; see `arm`."""
    return arm().compile()


def arm() -> mujoco.MjSpec:
    """Returns the arm alone: 7 hinges, 2 sliding fingers and a mocap body that the hand is welded to.

    Table, puck, walls and all geoms except the claws are removed, and so is every contact; inertias are kept. The arm
    moves as in the full scene, up to rounding, as long as it would touch nothing there: neither a wall nor the puck,
    which may lie below the hand's start. MJX supports neither the removed geoms nor the elliptic friction cone.
    """
    spec = _scene()
    for geom in list(spec.geoms):
        if geom.name not in _CLAWS:
            spec.delete(geom)
    for geom in spec.geoms:
        geom.contype = geom.conaffinity = 0
        geom.material = geom.classname.geom.material = ""  # of the class too, so that it can be written as MJCF
    for unused in (spec.meshes, spec.materials, spec.textures, spec.cameras, spec.lights):
        for element in list(unused):
            spec.delete(element)
    for name in ("obj", "tablelink", "RetainingWall"):
        spec.delete(spec.body(name))
    spec.compiler.fusestatic = True
    spec.option.cone = mujoco.mjtCone.mjCONE_PYRAMIDAL
    return spec


def draw_arm() -> mujoco.MjModel:
    """Compiles the arm for pictures: same qpos, with its geoms and the table, rotated to face a camera along y."""
    spec = _scene()
    for name in ("obj", "RetainingWall", "mocap"):
        spec.delete(spec.body(name))
    for body in spec.worldbody.bodies:
        x, y, z = body.pos
        body.pos, body.quat = (-x, -y, z), (0, 0, 0, 1)  # half a turn; no body had a rotation before
    return spec.compile()


def _scene() -> mujoco.MjSpec:
    """Returns Meta-World's scene, in which a weld holds the hand at the mocap body's position and orientation."""
    spec = mujoco.MjSpec.from_file(str(reach_model_path()))
    spec.body("mocap").quat = GRIPPER_DOWN
    (weld,) = spec.equalities
    weld.data[:3] = 0  # anchor
    weld.data[3:10] = (0, 0, 0, -1, 0, 0, 0)  # relative pose
    weld.data[10] = 5  # torque scale
    return spec
