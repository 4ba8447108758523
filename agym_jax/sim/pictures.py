"""One environment as C MuJoCo's model and data, with everything that people look at; for rendering and viewers."""

from __future__ import annotations

import jax
import mujoco
import numpy as np

from agym_jax.data.assets import asset_path
from agym_jax.rendering.raycast import Marker
from agym_jax.rendering.render import camera_of
from agym_jax.sim.scene import compose, draw_surfaces
from agym_jax.spec import Furnished, Pose, RobotSpec, Surface, Surfaced, Task
from agym_jax.state import State


def picture_model(
    task: Task, robot: RobotSpec, active: bool, state: State, visuals: str
) -> mujoco.MjModel:
    """The scene of an episode as people look at it.

    Args:
        task: of the scene.
        robot: of the scene.
        active: whether the person acts.
        state: of one environment.
        visuals: what the robot looks like: ``"primitives"`` or ``"meshes"``.

    Raises:
        UnknownNameError, MissingExtraError, MeshError: see ``AssistiveEnv.to_mujoco``.
    """
    p, place = state.episode.human, state.episode.placement
    (x, y, z), (qw, qx, qy, qz) = place.base_pos.tolist(), place.base_quat.tolist()
    base = Pose((x, y, z), (qw, qx, qy, qz))
    pose = jax.tree.map(np.asarray, state.episode.pose)
    model = compose(
        task, robot, active, float(p.sex), float(p.stature), float(p.girth), float(p.limit_scale),
        pose, base, visual=True, visuals=visuals, surfaces=_surfaces(task, state),
    )  # fmt: skip
    if isinstance(task, Furnished):
        for name, pos in task.props(state.task).items():
            model.body(f"seat/{name}/{name}").pos = np.asarray(pos)
    return model


def check_camera(camera: str | int) -> None:
    """Refuse the name of a camera that no scene has, before one is built; a robot's own have a slash in their name.

    Raises:
        UnknownCameraError: the message has the nearest.
    """
    numbered = isinstance(camera, int) or (isinstance(camera, str) and camera.lstrip("-").isdigit())
    if not numbered and not (isinstance(camera, str) and "/" in camera):
        camera_of(mujoco.MjModel.from_xml_path(str(asset_path("scene.xml"))), camera)


def write_pose(task: Task, state: State, data: mujoco.MjData, model: mujoco.MjModel) -> None:
    """Write the pose of one environment into data of ``picture_model``'s model."""
    data.qpos[:], data.qvel[:] = np.asarray(state.data.qpos), np.asarray(state.data.qvel)
    mujoco.mj_forward(model, data)
    draw_surfaces(data, _surfaces(task, state))


def markers_of(task: Task, state: State) -> list[Marker]:
    """Points that a task draws into pictures of one environment."""
    return [
        Marker(pos, radius, colour)
        for places, radius, colour in task.markers(state.task)
        for pos in np.atleast_2d(np.asarray(places))
        if np.all(np.isfinite(pos))
    ]


def _surfaces(task: Task, state: State) -> list[Surface]:
    """What a task draws besides points."""
    return task.surfaces(state.task) if isinstance(task, Surfaced) else []
