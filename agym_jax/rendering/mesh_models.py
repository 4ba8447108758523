"""Poses of the meshes of another package's model on the links of a robot of this package.

Poses follow from the kinematics of both models with all joints at zero, so that frames may differ,
fixed links may be fused, and only names are shared. A link whose joint axis differs, or that moves where the
robot's link does not, is refused.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import mujoco
import numpy as np

from agym_jax.errors import MeshError, did_you_mean
from agym_jax.spec import MeshModel, MeshPart, Pose, Rgba, RobotSpec

READABLE = (".stl", ".obj", ".msh")  # what MuJoCo reads
FIRST_HIDDEN_GROUP = 3  # ``Renderer`` draws the geom groups below
MAX_GAP, MAX_TURN = 0.002, np.radians(0.5)  # between joints of both models [m], [rad]
GREY = (0.5, 0.5, 0.5, 1.0)  # MuJoCo's default colour of a geom, which the material replaces

Numbers = tuple[float, ...]


@dataclass(frozen=True)
class Mesh:
    """A mesh file, and how MuJoCo reads it."""

    file: str  # absolute
    scale: Numbers = (1.0, 1.0, 1.0)
    refpos: Numbers = (0.0, 0.0, 0.0)
    refquat: Numbers = (1.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Material:
    """Colour and reflectance of a surface."""

    rgba: Rgba
    specular: float = 0.5
    shininess: float = 0.5


@dataclass(frozen=True)
class MeshShape:
    """A mesh with its material on one of the robot's links."""

    link: str
    pose: Pose  # in the link's frame
    material: Material
    mesh: Mesh


def readable(file: str, source: MeshModel | MeshPart) -> str:
    """The file; raises MeshError if it does not exist or MuJoCo cannot read its format."""
    if Path(file).suffix.lower() not in READABLE:
        raise MeshError(f"{source.package}: MuJoCo cannot read {file}, only {', '.join(READABLE)}.")
    if not Path(file).is_file():
        raise MeshError(f"{source.package}: {source.file} names a mesh that is not there, {file}.")
    return file


class PosedModel:
    """A model with all joints at zero, or at given angles: poses of its links, joints and geoms."""

    def __init__(self, spec: mujoco.MjSpec, angles: Mapping[str, float] | None = None):
        spec.compiler.boundmass = spec.compiler.boundinertia = 1e-6
        spec.compiler.balanceinertia = True
        self.model = spec.compile()
        self.data = mujoco.MjData(self.model)
        scalar = self.model.jnt_type >= int(mujoco.mjtJoint.mjJNT_SLIDE)
        self.data.qpos[self.model.jnt_qposadr[scalar]] = 0.0
        for name, angle in (angles or {}).items():
            self.data.qpos[self.model.joint(name).qposadr] = angle
        mujoco.mj_kinematics(self.model, self.data)
        self.links = {self.model.body(i).name: i for i in range(1, self.model.nbody)}

    def check_link(self, robot: RobotSpec, link: str, file: str) -> None:
        """Raise MeshError if the robot, whose model this is, has no such link."""
        if link not in self.links:
            near = did_you_mean(link, self.links)
            raise MeshError(f"{robot.name} has no link {link!r}, which {file} needs. {near}")

    def link(self, name: str) -> np.ndarray:
        """A link's pose in the world, (4, 4)."""
        i = self.links[name]
        return _matrix(self.data.xpos[i], self.data.xmat[i])

    def geom(self, i: int) -> np.ndarray:
        """A geom's pose in the world, (4, 4)."""
        return _matrix(self.data.geom_xpos[i], self.data.geom_xmat[i])

    def joints(self, link: str) -> Iterator[int]:
        """Ids of the joints between a link and its parent."""
        first = self.model.body_jntadr[self.links[link]]
        yield from range(first, first + self.model.body_jntnum[self.links[link]])


def _matrix(pos: np.ndarray, turn: np.ndarray) -> np.ndarray:
    out = np.eye(4)
    out[:3, :3], out[:3, 3] = np.reshape(turn, (3, 3)), pos
    return out


def _pose(matrix: np.ndarray) -> Pose:
    quat = np.zeros(4)
    mujoco.mju_mat2Quat(quat, matrix[:3, :3].flatten())
    x, y, z = matrix[:3, 3].tolist()
    w, i, j, k = quat.tolist()
    return Pose((x, y, z), (w, i, j, k))


def shapes_of(robot: RobotSpec, source: MeshModel, file: Path, ours: PosedModel) -> list[MeshShape]:
    """Meshes of another package's model, on the links of the robot."""
    spec = _parse(source, file)
    seen = [geom for geom in spec.geoms if _is_visual(geom)]
    visuals = [_material_and_mesh(spec, geom, file, source) for geom in seen]
    for geom in list(spec.geoms):
        if geom not in seen:
            spec.delete(geom)
        else:  # a sphere in its place, so that no mesh has to be read to compute its pose
            geom.type, geom.meshname, geom.size = mujoco.mjtGeom.mjGEOM_SPHERE, "", (1, 0, 0)
    for mesh in list(spec.meshes):
        spec.delete(mesh)
    try:
        theirs = PosedModel(spec, source.angles)
    except (ValueError, KeyError) as error:
        raise MeshError(f"{source.package}: {source.file} cannot be used: {error}") from error
    there, here = source.root
    ours.check_link(robot, here, source.file)
    if there not in theirs.links:
        near = did_you_mean(there, theirs.links)
        raise MeshError(f"{source.package}: {source.file} has no link {there!r}. {near}")
    onto = ours.link(here) @ np.linalg.inv(theirs.link(there))
    _check_joints(robot, source, ours, theirs, onto)
    alias = {name: name for name in ours.links} | {there: here}
    shapes = []
    for geom, (material, mesh) in zip(seen, visuals, strict=True):
        link = _target_link(source, theirs, theirs.model.geom_bodyid[geom.id], alias, robot)
        pose = _pose(np.linalg.inv(ours.link(link)) @ onto @ theirs.geom(geom.id))
        shapes.append(MeshShape(link, pose, material, mesh))
    return shapes


def _target_link(
    source: MeshModel, theirs: PosedModel, body: int, alias: dict[str, str], robot: RobotSpec
) -> str:
    """The robot's link to which a body of another model is fixed: the nearest one towards the root."""
    model, start = theirs.model, theirs.model.body(body).name
    where = f"{source.package}: {source.file} does not fit {robot.name}: its link {start!r}"
    while body:
        name = model.body(body).name
        if name in alias:
            return alias[name]
        moved = [model.joint(i).name for i in theirs.joints(name)]
        if not set(moved) <= set(source.angles):
            raise MeshError(
                f"{where} moves by {', '.join(moved)}, which {robot.name} lacks; fix it with MeshModel.angles."
            )
        body = model.body_parentid[body]
    raise MeshError(f"{where} is fixed to no link of {robot.name}.")


def _parse(source: MeshModel, file: Path) -> mujoco.MjSpec:
    try:
        if file.suffix != ".urdf":
            return mujoco.MjSpec.from_file(str(file))
        return mujoco.MjSpec.from_string(_urdf(source, file))
    except (ValueError, ElementTree.ParseError) as error:
        raise MeshError(f"{source.package}: MuJoCo cannot read {file}: {error}") from error


def _urdf(source: MeshModel, file: Path) -> str:
    """URDF text that MuJoCo reads with its visual shapes, ``package://`` replaced by paths."""
    root = ElementTree.parse(file).getroot()
    options = {"strippath": "false", "discardvisual": "false", "fusestatic": "false"}
    ElementTree.SubElement(ElementTree.SubElement(root, "mujoco"), "compiler", options)
    for mesh in root.iter("mesh"):
        package, _, rest = mesh.attrib["filename"].removeprefix("package://").partition("/")
        folder = next((p for p in file.parents if p.name == package), None)
        if folder is None:
            raise MeshError(f"{source.package}: {file} lies in no folder {package!r}.")
        mesh.attrib["filename"] = str(folder / rest)
    return ElementTree.tostring(root, encoding="unicode")


def _is_visual(geom: mujoco.MjsGeom) -> bool:
    """Whether a geom is a visual mesh. Visual primitives only mark frames."""
    visible = geom.type == mujoco.mjtGeom.mjGEOM_MESH and geom.group < FIRST_HIDDEN_GROUP
    return bool(visible and not geom.contype and not geom.conaffinity)


def _material_and_mesh(
    spec: mujoco.MjSpec, geom: mujoco.MjsGeom, file: Path, source: MeshModel
) -> tuple[Material, Mesh]:
    """Material and mesh of a geom."""
    rgba = _colour(geom.rgba)
    specular, shininess = Material.specular, Material.shininess
    material = spec.material(geom.material) if geom.material else None
    if material is not None:
        rgba = rgba if rgba != GREY else _colour(material.rgba)
        specular, shininess = float(material.specular), float(material.shininess)
    mesh = spec.mesh(geom.meshname)
    path = readable(str(file.parent / spec.meshdir / mesh.file), source)
    placed = (tuple(x.tolist()) for x in (mesh.scale, mesh.refpos, mesh.refquat))
    return Material(source.colours.get(rgba, rgba), specular, shininess), Mesh(path, *placed)


def _colour(rgba: np.ndarray) -> Rgba:
    """Colour as written in a file: MuJoCo keeps it in float32."""
    r, g, b, a = rgba.astype(float).round(4).tolist()
    return r, g, b, a


def _check_joints(
    robot: RobotSpec, source: MeshModel, ours: PosedModel, theirs: PosedModel, onto: np.ndarray
) -> None:
    """Check that every link of both models moves about the same axis in both.

    Args:
        robot: the robot.
        source: of the other model.
        ours: model of the robot.
        theirs: the other model.
        onto: transformation from its world to the robot's, (4, 4).
    """
    for link in (name for name in ours.links if name in theirs.links and name not in source.root):
        here, there = list(ours.joints(link)), list(theirs.joints(link))
        if not here:
            continue  # welded in ours
        where = f"{source.package}: {source.file} does not fit {robot.name}: its link {link!r}"
        if len(here) != len(there):
            raise MeshError(f"{where} has {len(there)} joints, ours {len(here)}.")
        for i, j in zip(here, there, strict=True):
            anchor = (onto @ np.append(theirs.data.xanchor[j], 1.0))[:3]
            gap = float(np.linalg.norm(anchor - ours.data.xanchor[i]))
            axes = ours.data.xaxis[i], onto[:3, :3] @ theirs.data.xaxis[j]
            turn = float(np.arctan2(np.linalg.norm(np.cross(*axes)), np.dot(*axes)))
            if (
                ours.model.jnt_type[i] != theirs.model.jnt_type[j]
                or gap > MAX_GAP
                or turn > MAX_TURN
            ):
                raise MeshError(
                    f"{where} turns about an axis {1e3 * gap:.1f} mm and {np.degrees(turn):.1f} degrees from ours, "
                    f"more than {1e3 * MAX_GAP:.0f} mm or {np.degrees(MAX_TURN):.1f} degrees, or is of another type."
                )
