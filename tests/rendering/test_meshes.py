# ruff: noqa: D103
"""Meshes of other packages, shown by one made up here: they fit, they hide what they replace, they change no physics."""

from __future__ import annotations

import dataclasses
import importlib.metadata
import tomllib
from pathlib import Path

import gymnasium
import mujoco
import numpy as np
import pytest
from fake_env import FakeEnv
from paths import ROOT

from agym_jax.adapters import gymnasium as adapter
from agym_jax.errors import AgymError, MeshError, MissingExtraError, UnknownNameError
from agym_jax.rendering import meshes
from agym_jax.rendering.mesh_models import FIRST_HIDDEN_GROUP, Material
from agym_jax.rendering.render import Renderer
from agym_jax.robots import ROBOTS
from agym_jax.sim.scene import compose
from agym_jax.spec import MeshModel, MeshPart, Pose, RobotSpec
from agym_jax.tasks import TASKS
from train import enjoy

TASK, JACO = TASKS["ScratchItch"], ROBOTS["Jaco"]
PACKAGE, VERSION = "toy-meshes", "1.2"
BASE, LINK_1, LINK_2, FINGER = (
    f"j2s7s300_link_{x}" for x in ("base", "1", "2", "finger_1")
)  # of ours
HALF = 0.04  # of the cube's side [m]
CUBE = "\n".join(
    [f"v {x} {y} {z}" for x in (-HALF, HALF) for y in (-HALF, HALF) for z in (-HALF, HALF)]
    + [f"f {a} {b} {d}\nf {a} {d} {c}" for a, b, c, d in (
        (1, 2, 3, 4), (5, 7, 6, 8), (1, 5, 2, 6), (3, 4, 7, 8), (1, 3, 5, 7), (2, 6, 4, 8))]
)  # fmt: skip

# Jaco's first joints in other frames: the foot is lifted, link 2 is turned by a quarter about its x,
# and the second cube hangs on a bracket that ours lacks.
MJCF = """
<mujoco>
  <compiler angle="radian" meshdir="shapes"/>
  <asset>
    <material name="paint" rgba="1 0.5 0 1" shininess="0.75"/>
    <mesh name="cube" file="cube.obj"/>
  </asset>
  <worldbody>
    <body name="foot" pos="1 2 3">
      <body name="j2s7s300_link_1" pos="0 0 0.15675" quat="0 0 1 0">
        <joint name="one" axis="{axis}" pos="{anchor} 0 0"/>
        <geom type="mesh" mesh="cube" material="paint" pos="0.01 0 0" contype="0" conaffinity="0" group="1"/>
        <geom type="sphere" size="0.3" contype="0" conaffinity="0" group="1"/>
        <geom type="mesh" mesh="cube"/>
        <body name="j2s7s300_link_2" pos="0 0.0016 -0.11875" quat="0 0 0 1">
          <joint name="two" axis="0 1 0" ref="0.3"/>
          <body name="bracket" pos="0 0 0.1" euler="0 0 0.5">
            <geom type="mesh" mesh="cube" rgba="0 0 1 1" pos="0.02 0 0" contype="0" conaffinity="0"/>
          </body>
        </body>
      </body>
    </body>
  </worldbody>
</mujoco>
"""
URDF = """
<robot name="toy">
  <link name="foot"/>
  <link name="j2s7s300_link_1">
    <visual>
      <origin xyz="0.01 0 0"/>
      <geometry><mesh filename="package://toy_meshes/shapes/cube.obj"/></geometry>
      <material name="loud"><color rgba="0 0.8 0 1"/></material>
    </visual>
    <collision><geometry><box size="1 1 1"/></geometry></collision>
  </link>
  <joint name="one" type="continuous">
    <parent link="foot"/> <child link="j2s7s300_link_1"/>
    <origin xyz="0 0 0.15675" rpy="0 3.14159265 0"/> <axis xyz="0 0 1"/>
  </joint>
</robot>
"""


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An installed package with two models and a mesh; its folder."""
    info, folder = tmp_path / f"toy_meshes-{VERSION}.dist-info", tmp_path / "toy_meshes"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {PACKAGE}\nVersion: {VERSION}\n")
    (folder / "shapes").mkdir(parents=True)
    (folder / "shapes" / "cube.obj").write_text(CUBE)
    (folder / "toy.xml").write_text(MJCF.format(axis="0 0 1", anchor=0))
    (folder / "toy.urdf").write_text(URDF)
    monkeypatch.syspath_prepend(tmp_path)
    return folder


def model(file: str = "toy.xml", **changes: object) -> MeshModel:
    return MeshModel(PACKAGE, f"toy_meshes/{file}", ("foot", BASE), **changes)  # ty: ignore


def part(**changes: object) -> MeshPart:
    plain = MeshPart(PACKAGE, "toy_meshes/shapes/cube.obj", FINGER, (1.0, 0.0, 1.0, 1.0))
    return dataclasses.replace(plain, **changes)  # ty: ignore


def wearing(*sources: MeshModel | MeshPart) -> RobotSpec:
    return dataclasses.replace(JACO, meshes=sources)


def shown(robot: RobotSpec, visuals: str = "meshes") -> mujoco.MjModel:
    return compose(TASK, robot, visual=True, visuals=visuals)


def seen(scene: mujoco.MjModel, link: str, mesh: bool) -> list[int]:
    """Geoms of one of the robot's links that are drawn, meshes or primitives."""
    body = scene.body(f"robot/{link}").id
    drawn = (scene.geom_bodyid == body) & (scene.geom_group < FIRST_HIDDEN_GROUP)
    return np.flatnonzero(drawn & ((scene.geom_dataid >= 0) == mesh)).tolist()


def test_mesh_poses_follow_the_kinematics(package: Path):
    scene = shown(wearing(model(), part(pose=Pose((0.0, 0.0, 0.03)))))
    data = mujoco.MjData(scene)
    data.qpos[:3] = 0.4, 1.3, -0.7  # not the pose in which they were placed
    mujoco.mj_kinematics(scene, data)

    def place(link: str, point: tuple[float, float, float]) -> np.ndarray:
        body = data.body(f"robot/{link}")
        return body.xpos + body.xmat.reshape(3, 3) @ np.array(point)

    bracket = 0.02 * np.array([np.cos(0.5), np.sin(0.5), 0.0]) + (0.0, 0.0, 0.1)
    # "ref" turns their link 2 by -0.3 about its y at zero
    c, s = np.cos(-0.3), np.sin(-0.3)
    x, y, z = c * bracket[0] + s * bracket[2], bracket[1], c * bracket[2] - s * bracket[0]
    expected = {
        LINK_1: (0.01, 0.0, 0.0),
        LINK_2: (x, -z, y),  # theirs is ours turned by -90 degrees about x
        FINGER: (0.0, 0.0, 0.03),
    }
    for link, point in expected.items():
        (geom,) = seen(scene, link, mesh=True)  # the felt one and the sphere stay behind
        np.testing.assert_allclose(data.geom_xpos[geom], place(link, point), atol=1e-6)
        size = scene.geom_aabb[geom, 3:]
        np.testing.assert_allclose(size, HALF, atol=1e-6)


def test_only_links_with_meshes_hide_their_primitives(package: Path):
    plain, dressed = shown(JACO, "primitives"), shown(wearing(model(), part()))
    for link in (LINK_1, LINK_2, FINGER):
        assert seen(plain, link, mesh=False) and not seen(dressed, link, mesh=False)
    for link in (BASE, "j2s7s300_link_3", "j2s7s300_link_finger_2"):
        assert len(seen(plain, link, mesh=False)) == len(seen(dressed, link, mesh=False)) > 0
        assert not seen(dressed, link, mesh=True)


def test_colour_comes_from_material_geom_or_robot(package: Path):
    orange, blue, red = (1.0, 0.5, 0.0, 1.0), (0.0, 0.0, 1.0, 1.0), (0.9, 0.1, 0.1, 1.0)

    def paints(source: MeshModel) -> dict[str, Material]:
        return {shape.link: shape.material for shape in meshes.mesh_shapes(wearing(source))}

    assert paints(model()) == {
        LINK_1: Material(orange, 0.5, 0.75),
        LINK_2: Material(blue),
    }
    assert paints(model(colours={orange: red}))[LINK_1] == Material(red, 0.5, 0.75)
    assert paints(model("toy.urdf", colours={(0.0, 0.8, 0.0, 1.0): red})) == {LINK_1: Material(red)}


def test_urdf_and_mjcf_give_the_same_poses(package: Path):
    one, other = (meshes.mesh_shapes(wearing(model(f)))[0] for f in ("toy.xml", "toy.urdf"))
    assert one.mesh == other.mesh and Path(one.mesh.file) == package / "shapes" / "cube.obj"
    np.testing.assert_allclose(one.pose.pos, other.pose.pos, atol=1e-6)
    assert abs(np.dot(one.pose.quat, other.pose.quat)) == pytest.approx(1.0)


def test_meshes_change_visual_geoms_only(package: Path):
    plain, dressed = shown(JACO, "primitives"), shown(wearing(model(), part()))
    assert dressed.nmesh == 1 and plain.nmesh == 0
    for count in ("nq", "nv", "nu", "nbody", "njnt", "nsite", "npair", "nsensor", "neq"):
        assert getattr(plain, count) == getattr(dressed, count)
    for i in range(plain.nbody):
        assert plain.body(i).name == dressed.body(i).name
    for i in range(plain.njnt):
        assert plain.joint(i).name == dressed.joint(i).name
    for field in ("body_pos", "body_quat", "body_mass", "body_inertia", "body_ipos", "qpos0", "jnt_axis"):  # fmt: skip
        np.testing.assert_array_equal(getattr(plain, field), getattr(dressed, field))
    felt = dressed.geom_dataid >= 0
    assert not dressed.geom_contype[felt].any() and not dressed.geom_conaffinity[felt].any()


def test_simulated_model_is_unchanged_byte_for_byte(package: Path):
    def stored(robot: RobotSpec, visuals: str) -> bytes:
        scene = compose(TASK, robot, visuals=visuals)
        buffer = np.empty(mujoco.mj_sizeModel(scene), np.uint8)
        mujoco.mj_saveModel(scene, None, buffer)
        return buffer.tobytes()

    assert stored(JACO, "primitives") == stored(wearing(model(), part()), "meshes")


@pytest.mark.parametrize("name", ROBOTS)
def test_missing_package_is_named_with_the_install_command(
    name: str, monkeypatch: pytest.MonkeyPatch
):
    def absent(package: str) -> None:
        raise importlib.metadata.PackageNotFoundError(package)

    monkeypatch.setattr(importlib.metadata, "distribution", absent)
    meshes.mesh_shapes.cache_clear()
    package = ROBOTS[name].meshes[0].package
    said = rf'{name} come with {package}, .*pip install "agym_jax\[meshes\]".*--no-deps {package}'
    for ask in (
        lambda: meshes.check_visuals("meshes", ROBOTS[name]),
        lambda: shown(ROBOTS[name]),
        lambda: gymnasium.make(f"Reaching{name}-v0", visuals="meshes"),
    ):
        with pytest.raises(MissingExtraError, match=said):
            ask()


def test_meshes_extra_lists_the_packages():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extra = {line.split(">")[0] for line in project["optional-dependencies"]["meshes"]}
    assert {source.package for robot in ROBOTS.values() for source in robot.meshes} == extra


@pytest.mark.parametrize(
    "ask",
    [
        lambda: meshes.check_visuals("meshs", JACO),
        lambda: compose(TASK, JACO, visual=True, visuals="meshs"),
        lambda: gymnasium.make("ReachingJaco-v0", visuals="meshs"),
    ],
)
def test_unknown_visuals_name_the_nearest_match(ask):
    with pytest.raises(UnknownNameError, match="Did you mean 'meshes'"):
        ask()


def test_robot_without_meshes_is_refused():
    with pytest.raises(MeshError, match=r"No meshes are known for Jaco.*primitives"):
        shown(wearing())


@pytest.mark.parametrize(
    ("axis", "anchor", "said"),
    [
        ("0 0 1", 0.003, "3.0 mm and 0.0 degrees"),
        ("0 0.0175 1", 0.0, "0.0 mm and 1.0 degrees"),
        ("0 0 -1", 0.0, "180.0 degrees"),
    ],
)
def test_displaced_joints_are_refused(package: Path, axis: str, anchor: float, said: str):
    (package / "toy.xml").write_text(MJCF.format(axis=axis, anchor=anchor))
    with pytest.raises(MeshError, match=f"does not fit Jaco: its link '{LINK_1}' .*{said}"):
        shown(wearing(model()))


def test_joints_within_tolerance_are_accepted(package: Path):
    (package / "toy.xml").write_text(MJCF.format(axis="0 0.005 1", anchor=0.001))
    assert shown(wearing(model())).nmesh == 1


def test_missing_joints_and_other_joint_types_are_refused(package: Path):
    joint = '<joint name="two" axis="0 1 0" ref="0.3"/>'
    for other, said in (("", "0 joints, ours 1"), (joint.replace("/>", ' type="slide"/>'), "type")):
        text = MJCF.format(axis="0 0 1", anchor=0).replace(joint, other)
        (package / "toy.xml").write_text(text)
        with pytest.raises(MeshError, match=f"'{LINK_2}' .*{said}"):
            shown(wearing(model()))


def test_extra_joints_are_refused_unless_fixed(package: Path):
    text = MJCF.format(axis="0 0 1", anchor=0).replace(f'"{LINK_2}"', '"renamed"')
    (package / "toy.xml").write_text(text)
    with pytest.raises(MeshError, match="'bracket' moves by two, which Jaco lacks"):
        shown(wearing(model()))
    held = meshes.mesh_shapes(wearing(model(angles={"two": 0.0})))
    assert {shape.link for shape in held} == {LINK_1}


def test_meshes_fixed_to_no_link_are_refused(package: Path):
    lost = '<worldbody><geom type="mesh" mesh="cube" contype="0" conaffinity="0"/>'
    text = MJCF.format(axis="0 0 1", anchor=0).replace("<worldbody>", lost)
    (package / "toy.xml").write_text(text)
    with pytest.raises(MeshError, match="'world' is fixed to no link of Jaco"):
        shown(wearing(model()))


def test_joint_angles_of_the_source_model_are_applied(package: Path):
    def place(angle: float) -> float:
        source = model("toy.urdf", angles={"one": angle})
        return meshes.mesh_shapes(wearing(source))[0].pose.pos[1]

    assert place(0.0) == pytest.approx(0.0, abs=1e-6)
    assert place(0.5) == pytest.approx(0.01 * np.sin(0.5), abs=1e-6)


@pytest.mark.parametrize(
    ("source", "said"),
    [
        (model("gone.xml"), f"{PACKAGE} {VERSION} has no file toy_meshes/gone.xml.*pip install"),
        (part(file="toy_meshes/toy.xml"), r"cannot read .*toy.xml, only .stl, .obj, .msh"),
        (part(link="j2s7s300_link_8"), "no link 'j2s7s300_link_8'.*Did you mean"),
        (dataclasses.replace(model(), root=("fot", BASE)), "no link 'fot'. Did you mean 'foot'"),
        (model(angles={"three": 0.1}), "cannot be used"),
    ],
)
def test_invalid_sources_are_refused_with_the_reason(package: Path, source, said: str):
    with pytest.raises(MeshError, match=said):
        shown(wearing(source))


def test_missing_or_unreadable_mesh_file_is_named(package: Path):
    text = MJCF.format(axis="0 0 1", anchor=0)
    for file, said in (("gone.obj", "not there.*gone.obj"), ("cube.dae", "cannot read .*cube.dae")):
        (package / "toy.xml").write_text(text.replace("cube.obj", file))
        with pytest.raises(MeshError, match=said):
            shown(wearing(model()))
    (package / "toy.xml").write_text("<mujoco><worldbody>")
    with pytest.raises(MeshError, match=f"{PACKAGE}: MuJoCo cannot read .*toy.xml"):
        shown(wearing(model()))


def test_raycast_draws_meshes(package: Path):
    cube = part(link="j2s7s300_link_7", pose=Pose((0.0, 0.0, -0.1)))
    scene = shown(wearing(dataclasses.replace(cube, rgba=(1.0, 0.0, 1.0, 1.0))))
    data = mujoco.MjData(scene)
    mujoco.mj_forward(scene, data)
    (geom,) = seen(scene, "j2s7s300_link_7", mesh=True)
    scene.cam_pos[:], scene.cam_bodyid[:] = data.geom_xpos[geom] + (0.0, -0.5, 0.0), 0
    scene.cam_quat[:] = np.sqrt(0.5), np.sqrt(0.5), 0.0, 0.0  # looks along +y
    mujoco.mj_forward(scene, data)
    with Renderer(scene, 60, 60, "front", backend="raycast") as renderer:
        picture = renderer.render(data).astype(int)
    magenta = (picture[..., 0] > 2 * picture[..., 1]) & (picture[..., 2] > 2 * picture[..., 1])
    rows, columns = np.nonzero(magenta)
    assert len(rows) > 30 and abs(rows.mean() - 29.5) < 5 and abs(columns.mean() - 29.5) < 5


@pytest.mark.jit
def test_gymnasium_renders_meshes(package: Path, monkeypatch: pytest.MonkeyPatch, raycast: None):
    everywhere = tuple(part(link=f"j2s7s300_link_{i}", rgba=(1, 0, 1, 1)) for i in range(1, 8))
    monkeypatch.setitem(ROBOTS, "Jaco", wearing(*everywhere))
    monkeypatch.setattr(adapter, "_programs", adapter._programs.__wrapped__)
    pictures = {}
    for visuals in meshes.VISUALS:
        env = gymnasium.make(
            "ReachingJaco-v0", impl="native", render_mode="rgb_array", width=64, height=48, visuals=visuals
        )  # fmt: skip
        env.reset(seed=3)
        pictures[visuals] = np.asarray(env.render()).astype(int)
        env.close()
    magenta = {k: (p[..., 0] > 2 * p[..., 1]) & (p[..., 2] > 2 * p[..., 1]) for k, p in pictures.items()}  # fmt: skip
    assert magenta["meshes"].sum() > 10 > magenta["primitives"].sum()


def test_enjoy_checks_visuals_before_compiling(tmp_path: Path, capsys, monkeypatch):
    class Dressed(FakeEnv):
        robot = JACO
        asked: str | None = None

        def to_mujoco(self, state, visuals="primitives"):
            self.asked = visuals
            return super().to_mujoco(state)

    env = Dressed(episode_length=2)
    words = f"--policy zero --clip {tmp_path}/a.gif --width 16 --height 16 --backend raycast"
    assert enjoy.main([*words.split(), "--visuals", "meshs"], lambda *_: env) == 2
    assert "Did you mean 'meshes'" in capsys.readouterr().err and env.asked is None
    monkeypatch.setattr(enjoy, "check_visuals", lambda *_: None)
    assert enjoy.main([*words.split(), "--visuals", "meshes"], lambda *_: env) == 0
    assert env.asked == "meshes"


def test_mesh_errors_are_agym_errors():
    assert issubclass(MeshError, AgymError) and issubclass(MissingExtraError, ImportError)
