"""Where the meshes of another package's model belong on a robot of ours.

Poses follow from the kinematics of both models with all joints at zero, so that frames may differ,
fixed links may be fused, and only names are shared. A link that turns about another axis than ours,
or where ours does not turn, is refused.
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
FIRST_UNSEEN = 3  # geom group: ``render`` draws those below
MAX_GAP, MAX_TURN = 0.002, np.radians(0.5)  # between joints of both models [m], [rad]
GREY = (0.5, 0.5, 0.5, 1.0)  # a geom's colour in MuJoCo that leaves it to the material

Numbers = tuple[float, ...]


@dataclass(frozen=True)
class Mesh:
    """A mesh file and how MuJoCo is to read it."""

    file: str  # absolute
    scale: Numbers = (1.0, 1.0, 1.0)
    refpos: Numbers = (0.0, 0.0, 0.0)
    refquat: Numbers = (1.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Paint:
    """What a surface looks like."""

    rgba: Rgba
    specular: float = 0.5
    shininess: float = 0.5


@dataclass(frozen=True)
class Shape:
    """A painted mesh on one of the robot's links."""

    link: str
    pose: Pose  # in the link's frame
    paint: Paint
    mesh: Mesh


def readable(file: str, source: MeshModel | MeshPart) -> str:
    """The file, or an error if MuJoCo cannot read such meshes, or if it is not there."""
    if Path(file).suffix.lower() not in READABLE:
        raise MeshError(f"{source.package}: MuJoCo cannot read {file}, only {', '.join(READABLE)}.")
    if not Path(file).is_file():
        raise MeshError(f"{source.package}: {source.file} names a mesh that is not there, {file}.")
    return file


class Still:
    """A model with all joints at zero, or at given angles: where its links, joints and geoms are."""

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
        """Raise MeshError if the robot, whose model this is, has no such link to wear a file's meshes."""
        if link not in self.links:
            near = did_you_mean(link, self.links)
            raise MeshError(f"{robot.name} has no link {link!r} to wear {file}. {near}")

    def link(self, name: str) -> np.ndarray:
        """A link's pose in the world, (4, 4)."""
        i = self.links[name]
        return _matrix(self.data.xpos[i], self.data.xmat[i])

    def geom(self, i: int) -> np.ndarray:
        """A geom's pose in the world, (4, 4)."""
        return _matrix(self.data.geom_xpos[i], self.data.geom_xmat[i])

    def joints(self, link: str) -> Iterator[int]:
        """Numbers of the joints that move a link against its parent."""
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


def worn_by(robot: RobotSpec, source: MeshModel, file: Path, ours: Still) -> list[Shape]:
    """What the links of another package's model wear, on ours."""
    spec = _parse(source, file)
    seen = [geom for geom in spec.geoms if _is_visual(geom)]
    visuals = [_look(spec, geom, file, source) for geom in seen]
    for geom in list(spec.geoms):
        if geom not in seen:
            spec.delete(geom)
        else:  # a dot in its place: no mesh has to be read to know where it is
            geom.type, geom.meshname, geom.size = mujoco.mjtGeom.mjGEOM_SPHERE, "", (1, 0, 0)
    for mesh in list(spec.meshes):
        spec.delete(mesh)
    try:
        theirs = Still(spec, source.angles)
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
    worn = []
    for geom, (paint, mesh) in zip(seen, visuals, strict=True):
        link = _wearer(source, theirs, theirs.model.geom_bodyid[geom.id], alias, robot)
        pose = _pose(np.linalg.inv(ours.link(link)) @ onto @ theirs.geom(geom.id))
        worn.append(Shape(link, pose, paint, mesh))
    return worn


def _wearer(
    source: MeshModel, theirs: Still, body: int, alias: dict[str, str], robot: RobotSpec
) -> str:
    """Our link nearest to a body of another model on its way to the root, without a joint between them."""
    model, start = theirs.model, theirs.model.body(body).name
    where = f"{source.package}: {source.file} does not fit {robot.name}: its link {start!r}"
    while body:
        name = model.body(body).name
        if name in alias:
            return alias[name]
        moved = [model.joint(i).name for i in theirs.joints(name)]
        if not set(moved) <= set(source.angles):
            raise MeshError(
                f"{where} moves by {', '.join(moved)}, which {robot.name} lacks; MeshModel.angles can hold it still."
            )
        body = model.body_parentid[body]
    raise MeshError(f"{where} hangs on no link of {robot.name}.")


def _parse(source: MeshModel, file: Path) -> mujoco.MjSpec:
    try:
        if file.suffix != ".urdf":
            return mujoco.MjSpec.from_file(str(file))
        return mujoco.MjSpec.from_string(_urdf(source, file))
    except (ValueError, ElementTree.ParseError) as error:
        raise MeshError(f"{source.package}: MuJoCo cannot read {file}: {error}") from error


def _urdf(source: MeshModel, file: Path) -> str:
    """A URDF that MuJoCo reads with its visual shapes, and with paths for ``package://``."""
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
    """Whether a geom is a mesh that is seen and not felt: primitives that are seen mark frames."""
    seen = geom.type == mujoco.mjtGeom.mjGEOM_MESH and geom.group < FIRST_UNSEEN
    return bool(seen and not geom.contype and not geom.conaffinity)


def _look(
    spec: mujoco.MjSpec, geom: mujoco.MjsGeom, file: Path, source: MeshModel
) -> tuple[Paint, Mesh]:
    """A geom's paint and mesh."""
    rgba = _colour(geom.rgba)
    specular, shininess = Paint.specular, Paint.shininess
    material = spec.material(geom.material) if geom.material else None
    if material is not None:
        rgba = rgba if rgba != GREY else _colour(material.rgba)
        specular, shininess = float(material.specular), float(material.shininess)
    mesh = spec.mesh(geom.meshname)
    path = readable(str(file.parent / spec.meshdir / mesh.file), source)
    placed = (tuple(x.tolist()) for x in (mesh.scale, mesh.refpos, mesh.refquat))
    return Paint(source.colours.get(rgba, rgba), specular, shininess), Mesh(path, *placed)


def _colour(rgba: np.ndarray) -> Rgba:
    """As written in a file: MuJoCo keeps it in float32."""
    r, g, b, a = rgba.astype(float).round(4).tolist()
    return r, g, b, a


def _check_joints(
    robot: RobotSpec, source: MeshModel, ours: Still, theirs: Still, onto: np.ndarray
) -> None:
    """Whether every link that both models have moves about the same axis in both.

    Args:
        robot: ours.
        source: the other one.
        ours: our model.
        theirs: the other one.
        onto: from its world to ours, (4, 4).
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
