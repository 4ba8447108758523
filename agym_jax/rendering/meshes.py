"""Visual meshes of robots, from other packages at run time; this package contains none.

    pip install "agym_jax[meshes]"      # robosuite (Jaco, Baxter, Sawyer), example-robot-data (PR2)

``add_meshes`` adds them to the visual model, hides the primitives of the links that get meshes,
and leaves every body, joint, mass and contact unchanged; the simulated model never contains them. A
robot names its sources in ``RobotSpec.meshes``. Those packages are not imported: their files are found
through their installed metadata, and ``agym_jax.rendering.mesh_models`` computes the poses of their meshes.
"""

from __future__ import annotations

import importlib.metadata
from functools import cache
from pathlib import Path

import mujoco

from agym_jax.data.assets import asset_path
from agym_jax.errors import MeshError, MissingExtraError, UnknownNameError
from agym_jax.rendering.mesh_models import (
    FIRST_HIDDEN_GROUP,
    Material,
    Mesh,
    MeshShape,
    PosedModel,
    readable,
    shapes_of,
)
from agym_jax.spec import MeshModel, MeshPart, RobotSpec

VISUALS = ("primitives", "meshes")
HIDDEN = 5  # a geom group that ``Renderer`` does not draw


def check_visuals(visuals: str, robot: RobotSpec) -> None:
    """Check that a robot's visuals are available.

    Args:
        visuals: one of ``VISUALS``.
        robot: the robot to be drawn.

    Raises:
        UnknownNameError: no such visuals.
        MeshError: no meshes are known for this robot, or they do not fit it.
        MissingExtraError: the package that ships them is not installed.
    """
    if visuals not in VISUALS:
        raise UnknownNameError("visuals", visuals, VISUALS)
    if visuals == "meshes":
        mesh_shapes(robot)


def add_meshes(spec: mujoco.MjSpec, robot: RobotSpec) -> None:
    """Add the robot's meshes to its links, and hide the primitives of links with meshes.

    Args:
        spec: the robot's file, not yet attached to a scene; written.
        robot: the robot of that file.

    Raises:
        MeshError: no meshes are known for this robot, or they do not fit it.
        MissingExtraError: the package that ships them is not installed.
    """
    added = mesh_shapes(robot)
    links = {shape.link for shape in added}
    for geom in spec.geoms:
        if geom.parent.name in links and geom.group < FIRST_HIDDEN_GROUP:
            geom.group = HIDDEN
    meshes = {mesh: f"mesh_{i}" for i, mesh in enumerate(dict.fromkeys(s.mesh for s in added))}
    materials = {
        material: f"material_{i}"
        for i, material in enumerate(dict.fromkeys(s.material for s in added))
    }
    for mesh, name in meshes.items():
        spec.add_mesh(
            name=name, file=mesh.file, scale=mesh.scale, refpos=mesh.refpos, refquat=mesh.refquat,
            inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,  # works for meshes that are not closed
        )  # fmt: skip
    for material, name in materials.items():
        spec.add_material(
            name=name, rgba=material.rgba, specular=material.specular, shininess=material.shininess
        )
    for shape in added:
        spec.body(shape.link).add_geom(
            type=mujoco.mjtGeom.mjGEOM_MESH, meshname=meshes[shape.mesh], material=materials[shape.material],
            pos=shape.pose.pos, quat=shape.pose.quat, group=2, contype=0, conaffinity=0, mass=0.0,
        )  # fmt: skip


@cache
def mesh_shapes(robot: RobotSpec) -> tuple[MeshShape, ...]:
    """Meshes of a robot, with poses in the frames of its links.

    Raises:
        MeshError: no meshes are known for this robot, or they do not fit it.
        MissingExtraError: the package that ships them is not installed.
    """
    if not robot.meshes:
        raise MeshError(
            f"No meshes are known for {robot.name} (RobotSpec.meshes is empty). Use visuals='primitives'."
        )
    ours = PosedModel(mujoco.MjSpec.from_file(str(asset_path(robot.model))))
    added: list[MeshShape] = []
    for source in robot.meshes:
        file = _locate(robot, source)
        if isinstance(source, MeshModel):
            added += shapes_of(robot, source, file, ours)
        else:
            ours.check_link(robot, source.link, source.file)
            mesh = Mesh(readable(str(file), source))
            added.append(MeshShape(source.link, source.pose, Material(source.rgba), mesh))
    return tuple(added)


def _locate(robot: RobotSpec, source: MeshModel | MeshPart) -> Path:
    """File of a source, in its installed package."""
    try:
        package = importlib.metadata.distribution(source.package)
    except importlib.metadata.PackageNotFoundError as error:
        raise MissingExtraError(
            f"The meshes of {robot.name} come with {source.package}, which is not installed. "
            f'pip install "agym_jax[meshes]"; or, for its files without its dependencies, '
            f"pip install --no-deps {source.package}"
        ) from error
    file = Path(str(package.locate_file(source.file)))
    if not file.is_file():
        raise MeshError(
            f"{source.package} {package.version} has no file {source.file}, where the meshes of {robot.name} "
            f'were. Get a version that has it: pip install --upgrade "agym_jax[meshes]"'
        )
    return file
