"""Meshes that robots may wear in pictures; they come from other packages at run time, none are ours.

    pip install "agym_jax[meshes]"      # robosuite (Jaco, Baxter, Sawyer), example-robot-data (PR2)

``dress`` puts them on the model that people look at, hides the primitives of the links that wear some,
and leaves every body, joint, mass and contact as it is; the model that is simulated never sees them. A
robot names its sources in ``RobotSpec.meshes``. Those packages are not imported: their files are found
through their installed metadata, and ``agym_jax.rendering.mesh_models`` works out where their meshes belong.
"""

from __future__ import annotations

import importlib.metadata
from functools import cache
from pathlib import Path

import mujoco

from agym_jax.data.assets import asset_path
from agym_jax.errors import MeshError, MissingExtraError, UnknownNameError
from agym_jax.rendering.mesh_models import (
    FIRST_UNSEEN,
    Mesh,
    Paint,
    Shape,
    Still,
    readable,
    worn_by,
)
from agym_jax.spec import MeshModel, MeshPart, RobotSpec

VISUALS = ("primitives", "meshes")
HIDDEN = 5  # a geom group that ``render`` does not draw


def check_visuals(visuals: str, robot: RobotSpec) -> None:
    """Whether a robot can look like that here.

    Args:
        visuals: one of ``VISUALS``.
        robot: whose looks.

    Raises:
        UnknownNameError: there are no such looks.
        MeshError: no meshes are known for this robot, or they do not fit it.
        MissingExtraError: the package that ships them is not installed.
    """
    if visuals not in VISUALS:
        raise UnknownNameError("visuals", visuals, VISUALS)
    if visuals == "meshes":
        shapes(robot)


def dress(spec: mujoco.MjSpec, robot: RobotSpec) -> None:
    """Put the robot's meshes on its links, and hide the primitives of those that wear some.

    Args:
        spec: the robot's file, not yet attached to a scene; written.
        robot: whose file it is.

    Raises:
        MeshError: no meshes are known for this robot, or they do not fit it.
        MissingExtraError: the package that ships them is not installed.
    """
    worn = shapes(robot)
    links = {shape.link for shape in worn}
    for geom in spec.geoms:
        if geom.parent.name in links and geom.group < FIRST_UNSEEN:
            geom.group = HIDDEN
    meshes = {mesh: f"mesh_{i}" for i, mesh in enumerate(dict.fromkeys(s.mesh for s in worn))}
    paints = {paint: f"paint_{i}" for i, paint in enumerate(dict.fromkeys(s.paint for s in worn))}
    for mesh, name in meshes.items():
        spec.add_mesh(
            name=name, file=mesh.file, scale=mesh.scale, refpos=mesh.refpos, refquat=mesh.refquat,
            inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,  # asks of a mesh only that it has a surface
        )  # fmt: skip
    for paint, name in paints.items():
        spec.add_material(
            name=name, rgba=paint.rgba, specular=paint.specular, shininess=paint.shininess
        )
    for shape in worn:
        spec.body(shape.link).add_geom(
            type=mujoco.mjtGeom.mjGEOM_MESH, meshname=meshes[shape.mesh], material=paints[shape.paint],
            pos=shape.pose.pos, quat=shape.pose.quat, group=2, contype=0, conaffinity=0, mass=0.0,
        )  # fmt: skip


@cache
def shapes(robot: RobotSpec) -> tuple[Shape, ...]:
    """What a robot wears, with poses in the frames of its own links.

    Raises:
        MeshError: no meshes are known for this robot, or they do not fit it.
        MissingExtraError: the package that ships them is not installed.
    """
    if not robot.meshes:
        raise MeshError(
            f"No meshes are known for {robot.name} (RobotSpec.meshes is empty). It has primitives: looks='primitives'."
        )
    ours = Still(mujoco.MjSpec.from_file(str(asset_path(robot.model))))
    worn: list[Shape] = []
    for source in robot.meshes:
        file = _locate(robot, source)
        if isinstance(source, MeshModel):
            worn += worn_by(robot, source, file, ours)
        else:
            ours.check_link(robot, source.link, source.file)
            mesh = Mesh(readable(str(file), source))
            worn.append(Shape(source.link, source.pose, Paint(source.rgba), mesh))
    return tuple(worn)


def _locate(robot: RobotSpec, source: MeshModel | MeshPart) -> Path:
    """A source's file, where its package is installed."""
    try:
        package = importlib.metadata.distribution(source.package)
    except importlib.metadata.PackageNotFoundError as error:
        raise MissingExtraError(
            f"The meshes of {robot.name} come with {source.package}, which is not installed. "
            f'pip install "agym_jax[meshes]"; or, for its files without all that it needs to run, '
            f"pip install --no-deps {source.package}"
        ) from error
    file = Path(str(package.locate_file(source.file)))
    if not file.is_file():
        raise MeshError(
            f"{source.package} {package.version} has no file {source.file}, where the meshes of {robot.name} "
            f'were. Get a version that has it: pip install --upgrade "agym_jax[meshes]"'
        )
    return file
