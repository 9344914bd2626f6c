"""A robot in a plain scene: the positions of its limbs, and pictures rendered off screen by MuJoCo."""

from __future__ import annotations

import copy
import ctypes.util
import importlib
import math
import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import mujoco
import numpy as np

from ear_jax.errors import RunError, UsageError, first_line
from ear_jax.figures.strip import Bounds

SKY, FLOOR = (214, 228, 240), ((186, 190, 186), (206, 210, 206))  # RGB; the squares of the floor are 2 m wide
LIGHT = (0.23, 0.32, -0.92)  # direction, a unit vector: from behind and to the left of the camera
Locomotion = Literal["runs", "roams", "fixed"]  # along x; anywhere on the floor; not at all
WITHOUT_GL = "pictures of the robot need OpenGL; install libegl1 and libgl1-mesa-dri, or libosmesa6 ({})"


@dataclass(frozen=True)
class Limbs:
    """A robot in some poses as stick figures: each limb is a capsule, the two ends of its axis and its radius."""

    ends: np.ndarray  # [poses, limbs, 2, 3] metres
    radii: np.ndarray  # [limbs] metres

    @property
    def centres(self) -> np.ndarray:
        """The mean of all limb ends, [poses, 3] metres."""
        return self.ends.mean((1, 2))

    @property
    def length(self) -> float:
        """The robot's extent along x or y, whichever is larger, in metres; the median over poses."""
        return float(np.median(np.ptp(self.ends[..., :2], axis=(1, 2)).max(-1)) + 2 * self.radii.max())

    @property
    def top(self) -> float:
        """The highest point of all poses, in metres."""
        return float(self.ends[..., 2].max() + self.radii.max())


def limbs(model: mujoco.MjModel, qpos: np.ndarray) -> Limbs:
    """Computes the limbs in poses [poses, nq].

    Each shape becomes the capsule that fits its bounding box, along the longest side; a capsule stays itself.

    Raises:
      UsageError: the model has no shapes that move.
    """
    data, robot = mujoco.MjData(model), _robot(model)
    if not len(robot):
        raise UsageError("there is nothing to draw: the model has no shapes that move")
    middle, halves = np.split(model.geom_aabb[robot], 2, axis=1)  # [limbs, 3] each, along the axes of the shape
    longest = halves.argmax(1)
    radii = (halves.sum(1) - halves.max(1)) / 2
    along = np.eye(3)[longest] * (halves.max(1) - radii)[:, None]
    ends = []
    for pose in qpos:
        data.qpos[:] = pose
        mujoco.mj_kinematics(model, data)
        rotated = data.geom_xmat[robot].reshape(-1, 1, 3, 3) @ np.stack([middle - along, middle + along], 1)[..., None]
        ends.append(data.geom_xpos[robot][:, None] + rotated[..., 0])
    return Limbs(np.array(ends), radii)


def locomotion_of(model: mujoco.MjModel) -> Locomotion:
    """Returns the robot's kind of locomotion, from the joints at the root of what its actuators move."""
    moved = model.actuator_trnid[model.actuator_trntype == mujoco.mjtTrn.mjTRN_JOINT, 0]
    trees = model.body_rootid[model.jnt_bodyid]
    own = np.isin(trees, trees[moved]) if len(moved) else np.ones(model.njnt, bool)  # a target's tree is another
    at_root = own & (model.body_weldid[model.body_parentid[model.jnt_bodyid]] == 0)
    if (model.jnt_type[at_root] == mujoco.mjtJoint.mjJNT_FREE).any():
        return "roams"
    return "runs" if (model.jnt_type[at_root] == mujoco.mjtJoint.mjJNT_SLIDE).any() else "fixed"


def _robot(model: mujoco.MjModel) -> np.ndarray:
    """Returns the indices of the geoms that are visible and can move."""
    return np.flatnonzero((model.body_weldid[model.geom_bodyid] != 0) & (model.geom_group < 3))


def project(points: np.ndarray, elevation: float) -> np.ndarray:
    """Projects points [..., 3] for a view along y and down by `elevation` radians: [..., 2], metres right and up."""
    up = points[..., 1] * math.sin(elevation) + points[..., 2] * math.cos(elevation)
    return np.stack([points[..., 0], up], axis=-1)


def camera_at(lookat: Sequence[float], distance: float, elevation: float) -> mujoco.MjvCamera:
    """Returns a camera looking along y, and down by `elevation` radians, at a point [3] `distance` metres away."""
    camera = mujoco.MjvCamera()
    camera.type = mujoco.mjtCamera.mjCAMERA_FREE.value
    camera.lookat[:], camera.distance = lookat, distance
    camera.azimuth, camera.elevation = 90, -math.degrees(elevation)
    return camera


def camera_without_perspective(bounds: Bounds, elevation: float) -> mujoco.MjvCamera:
    """Returns an orthographic camera that shows the points which `project` puts within the bounds."""
    across, up = (bounds.left + bounds.right) / 2, (bounds.low + bounds.high) / 2
    camera = camera_at((across, up * math.sin(elevation), up * math.cos(elevation)), 20.0, elevation)
    camera.orthographic = 1
    return camera


class Canvas:
    """Renders a robot off screen in a plain scene. A context manager, so that OpenGL is released in order."""

    def __init__(self, model: mujoco.MjModel, width: int, height: int):
        """Opens OpenGL for pictures of `width` × `height` pixels; raises RunError if there is none."""
        self._model = _in_plain_scene(model, width, height)
        self._data = mujoco.MjData(model)
        self._rectangle = mujoco.MjrRect(0, 0, width, height)
        self._scene = mujoco.MjvScene(self._model, maxgeom=10_000)
        try:
            self._gl = _open_gl(width, height)
            self._gl.make_current()
            self._context = mujoco.MjrContext(self._model, mujoco.mjtFontScale.mjFONTSCALE_100.value)
        except Exception as error:  # ImportError, AttributeError or OpenGL's own, depending on the part that is missing
            variable = f"MUJOCO_GL={os.environ['MUJOCO_GL']}: " if os.environ.get("MUJOCO_GL") else ""
            raise RunError(WITHOUT_GL.format(variable + first_line(error))) from None
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN.value, self._context)

    def __enter__(self) -> Canvas:
        return self

    def __exit__(self, *_: object) -> None:
        self._context.free()
        self._gl.free()

    def draw(
        self, poses: np.ndarray, camera: mujoco.MjvCamera, field_of_view: float, tints: np.ndarray | None = None
    ) -> np.ndarray:
        """Renders one picture [height, width, 3] of the robot in all poses [poses, nq] at once.

        Args:
          poses: the poses.
          camera: the camera.
          field_of_view: from top to bottom, in degrees, or in metres for an orthographic camera.
          tints: [poses, 4]: a colour, and the share (0 to 1) of it that is mixed into the robot's own.
        """
        model, data, scene = self._model, self._data, self._scene
        option, pert = mujoco.MjvOption(), mujoco.MjvPerturb()
        everything, moving = mujoco.mjtCatBit.mjCAT_ALL.value, mujoco.mjtCatBit.mjCAT_DYNAMIC.value
        model.vis.global_.fovy, model.vis.global_.orthographic = field_of_view, camera.orthographic
        drawn = 0
        for index, pose in enumerate(poses):
            data.qpos[:] = pose
            mujoco.mj_forward(model, data)
            if index == 0:
                mujoco.mjv_updateScene(model, data, option, pert, camera, everything, scene)
            else:
                mujoco.mjv_addGeoms(model, data, option, pert, moving, scene)
            if tints is not None:
                _tint(scene.geoms[drawn : scene.ngeom], tints[index])
            drawn = scene.ngeom
        for light in scene.lights[: scene.nlight]:
            if not light.headlight:
                light.pos[:] = camera.lookat + np.array([0, 0, 5])  # shadows are drawn only near a light
        self._gl.make_current()
        mujoco.mjr_render(self._rectangle, scene, self._context)
        picture = np.empty((self._rectangle.height, self._rectangle.width, 3), np.uint8)
        mujoco.mjr_readPixels(picture, None, self._rectangle, self._context)
        return picture[::-1]


def _tint(geoms: Sequence[Any], tint: np.ndarray) -> None:
    for geom in geoms:
        if geom.category == mujoco.mjtCatBit.mjCAT_DYNAMIC:
            geom.rgba[:3] = (1 - tint[3]) * geom.rgba[:3] + tint[3] * tint[:3]


def _open_gl(width: int, height: int) -> Any:
    """Opens OpenGL by MUJOCO_GL, else EGL or OSMesa, which need no screen; MuJoCo's own choice outside Linux."""
    if os.environ.get("MUJOCO_GL") or sys.platform != "linux":
        return mujoco.GLContext(width, height)
    library = next((name for name in ("EGL", "OSMesa") if ctypes.util.find_library(name)), None)
    if library is None:
        raise ImportError("neither EGL nor OSMesa is installed")
    return importlib.import_module(f"mujoco.{library.lower()}").GLContext(width, height)


def _in_plain_scene(model: mujoco.MjModel, width: int, height: int) -> mujoco.MjModel:
    """Copies a model with a pale sky, an endless matt floor of two greys and soft light instead of its own."""
    model = copy.copy(model)
    floor = model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE
    material = [index for index in model.geom_matid[floor] if index >= 0]
    for texture in range(model.ntex):
        size = model.tex_height[texture] * model.tex_width[texture] * model.tex_nchannel[texture]
        pixels = model.tex_data[model.tex_adr[texture] :][:size].reshape(-1, model.tex_nchannel[texture])
        if model.tex_type[texture] == mujoco.mjtTexture.mjTEXTURE_SKYBOX:
            pixels[:, :3] = SKY
        elif texture in model.mat_texid[material]:
            bright = pixels[:, :3].mean(1) > pixels[:, :3].mean()
            pixels[:, :3] = np.where(bright[:, None], FLOOR[1], FLOOR[0])
    model.geom_rgba[floor], model.geom_size[floor, :2] = 1, 0  # a plane of size 0 is drawn as infinite
    model.mat_rgba[material], model.mat_texuniform[material], model.mat_texrepeat[material] = 1, 1, 0.5
    model.mat_reflectance[:], model.mat_specular[:] = 0, 0
    model.light_ambient[:], model.light_diffuse[:], model.light_dir[:] = 0, 0.5, LIGHT
    visual = model.vis
    visual.headlight.ambient[:], visual.headlight.diffuse[:] = 0.45, 0.35
    visual.rgba.haze[:] = (*(np.array(SKY) / 255), 1)
    visual.global_.offwidth, visual.global_.offheight = width, height
    # Shadows reach 16 m from the point looked at, the length of a strip, at a resolution of 8 mm.
    visual.map.shadowclip, visual.quality.shadowsize = 16 / model.stat.extent, 4096
    return model
