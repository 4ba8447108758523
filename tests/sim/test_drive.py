"""Motors: a velocity at once, within a torque bound, solved together with contacts."""

# ruff: noqa: D103
import copy

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

import agym_jax
from agym_jax.robots import ROBOTS
from agym_jax.sim import impulse
from agym_jax.sim.control import INCREMENT, Controller
from agym_jax.sim.motors import Aim, Motors, add_motors, stiffen_motors
from agym_jax.sim.scene import build_scene
from agym_jax.spec import Control
from agym_jax.tasks import TASKS

CONTROL = Control(time_step=0.02, frame_skip=5, rate=2.5, max_torque=1.0, action_scale=0.25)
STEP = CONTROL.time_step


def to(angles: np.ndarray, control: Control = CONTROL) -> Aim:
    """What the robot's motors are to do to reach these angles."""
    return Aim(angles, control.rate, control.max_torque)


def hinge(inertia: float, torque: float = 0.0) -> tuple[mujoco.MjModel, mujoco.MjData, Motors]:
    """One joint with a motor, and a torque that acts on it."""
    spec = mujoco.MjSpec()
    spec.option.timestep, spec.option.integrator = 0.02, mujoco.mjtIntegrator.mjINT_EULER
    body = spec.worldbody.add_body(mass=1.0, inertia=[inertia] * 3, explicitinertial=True)
    body.add_joint(name="joint", axis=[0, 0, 1])
    add_motors(spec, ["joint"], CONTROL.max_torque, STEP)
    model = spec.compile()
    stiffen_motors(model)
    data = mujoco.MjData(model)
    motors = Motors.of(model, np.array([0]), STEP)
    mujoco.mj_forward(model, data)
    return model, data, motors


@pytest.mark.parametrize("start", [-0.9, -0.3, -1e-6, 0.0, 1e-6, 0.1, 0.4, 0.625, 2.0])
@pytest.mark.parametrize("wanted", [-0.5, 0.0, 1e-3, 0.625])
def test_a_light_joint_has_the_wanted_velocity_after_one_step(start: float, wanted: float):
    model, data, motors = hinge(0.001)
    data.qvel[:] = start
    motors.prepare(model, data, to(data.qpos + wanted / CONTROL.rate))
    mujoco.mj_step(model, data)
    np.testing.assert_allclose(data.qvel, wanted, atol=2e-3)


@pytest.mark.parametrize("start", [-0.9, 0.0, 0.1, 0.5])
def test_a_heavy_joint_accelerates_under_the_whole_bound(start: float):
    model, data, motors = hinge(1.0)
    data.qvel[:] = start
    motors.prepare(model, data, to(data.qpos + 0.25))
    mujoco.mj_step(model, data)
    np.testing.assert_allclose(data.qvel - start, 0.02 * CONTROL.max_torque / 1.0, rtol=1e-3)


@pytest.mark.parametrize(("push", "yields"), [(0.9, False), (1.5, True)])
def test_a_joint_that_is_not_driven_stands_still_up_to_the_bound(push: float, yields: bool):
    model, data, motors = hinge(0.01)
    for _ in range(50):
        motors.prepare(model, data, to(data.qpos.copy()))
        data.qfrc_applied += push
        mujoco.mj_step(model, data)
    assert (abs(data.qpos[0]) > 0.1) == yields
    if not yields:
        assert abs(data.qpos[0]) < 0.01  # it creeps


@pytest.mark.parametrize("bound", [0.0, 1.0])
@pytest.mark.parametrize("start", [0.0, 1e-320, 2e-38, 1e-20, -1e-38])
def test_a_joint_that_comes_to_rest_is_no_division_by_zero(start: float, bound: float):
    _, data, motors = hinge(0.01)
    given = np.eye(1), np.zeros(1), data.qpos, np.full(1, start)
    aim = Aim(data.qpos.copy(), CONTROL.rate, bound)
    with np.errstate(all="raise", under="ignore"):
        one = motors.drive(*given, aim, np)
    two = motors.drive(*(jnp.asarray(x, jnp.float32) for x in given), aim)
    for found in (*one, *two):
        assert np.isfinite(found).all()


def test_numpy_and_jax_drive_alike():
    rng = np.random.default_rng(0)
    scene = build_scene(TASKS["ScratchItch"], ROBOTS["Jaco"])
    motors = Motors.of(scene.model, scene.index.robot_dof, STEP)
    for _ in range(20):
        bias, q, v, goal = rng.normal(size=(4, 7)).astype(np.float32)
        v *= rng.choice([0.0, 1e-6, 0.1, 1.0])
        root = rng.normal(size=(7, 7)).astype(np.float32)
        given = (root @ root.T + np.eye(7, dtype=np.float32), bias, q, v)
        aim = Aim(goal, *rng.choice([0.0, 0.5, 2.5], 3).astype(np.float32))
        one, two = motors.drive(*given, aim, np), motors.drive(*map(jnp.asarray, given), aim)
        for a, b in zip(one, two, strict=True):
            np.testing.assert_allclose(a, b, rtol=1e-3, atol=1e-3)


def play(
    model: mujoco.MjModel, motors: Motors, control: Control, guesses: bool
) -> tuple[np.ndarray, float]:
    """Angles under random actions, and the solver's mean number of iterations per physics step."""
    rng, data, angles, iterations = np.random.default_rng(0), mujoco.MjData(model), [], []
    data.M[:] = 0.0
    data.qpos[motors.qpos] = model.jnt_range[model.dof_jntid[motors.dofs]].mean(axis=1)
    for _ in range(30):
        goal = data.qpos[motors.qpos] + 0.25 * rng.uniform(-1.0, 1.0, len(motors.dofs))
        for _ in range(5):
            before = data.qacc_warmstart.copy()
            drive = motors.prepare(model, data, to(goal, control))
            if not guesses:
                data.qacc_warmstart[:] = before
            mujoco.mj_step(model, data)
            motors.remember(data, drive)
            iterations.append(data.solver_niter[0])
            angles.append(data.qpos[motors.qpos].copy())
    return np.array(angles), float(np.mean(iterations))


@pytest.mark.parametrize(("task", "robot"), [("ScratchItch", "Jaco"), ("BedBathing", "Sawyer")])
def test_the_guess_spares_iterations_and_changes_nothing(task: str, robot: str):
    scene = build_scene(TASKS[task], ROBOTS[robot])
    model, control = copy.copy(scene.model), TASKS[task].control
    model.body_pos[scene.index.robot_base] = (0.0, 0.0, 30.0)  # far from everything
    motors = Motors.of(model, scene.index.robot_dof, control.time_step)
    (angles, iterations), (same, more) = (
        play(model, motors, control, guesses) for guesses in (True, False)
    )
    np.testing.assert_allclose(angles, same, atol=1e-6)
    assert iterations < 0.75 * more


@pytest.mark.parametrize("push", [0.0, 0.4, 3.0])
def test_the_guess_for_one_joint_is_exact(push: float):
    model, data, motors = hinge(1.0)
    for _ in range(3):  # what pushes is known from the second physics step
        data.qvel[:] = 0.1
        drive = motors.prepare(model, data, to(data.qpos + 0.25))
        data.qfrc_applied += push
        mujoco.mj_step(model, data)
        found = data.qacc[0]
        motors.remember(data, drive)
    np.testing.assert_allclose(drive.guess, found, rtol=1e-3)


def test_the_inertia_is_found_in_any_layout():
    scene = build_scene(TASKS["ArmManipulation"], ROBOTS["PR2"])
    motors = Motors.of(scene.model, scene.index.robot_dof, STEP)
    data = mujoco.MjData(scene.model)
    mujoco.mj_forward(scene.model, data)
    dense = np.zeros((scene.model.nv, scene.model.nv))
    mujoco.mj_fullM(scene.model, data, dense)
    np.testing.assert_allclose(motors.inertia(data.M, np), motors.inertia(dense, np), atol=1e-12)


def test_a_target_beyond_a_limit_is_dropped_as_in_assistive_gym():
    scene = build_scene(TASKS["ScratchItch"], ROBOTS["Jaco"])
    controller = Controller.of(scene, TASKS["ScratchItch"], False)
    low, high = controller.robot_range.T
    rng = np.random.default_rng(0)
    for room in (0.0, 0.03, 0.07, 0.12, 0.24, 1.0):
        action = rng.uniform(-1, 1, 7).astype(np.float32)
        q = np.where(action > 0, high - room, low + room).astype(np.float32)
        goal, step = q.astype(float), INCREMENT * action.astype(float)
        for _ in range(5):  # AG v0.1 env.py take_step
            step[(goal + step < low) | (goal + step > high)] = 0.0
            goal += step
        mine = controller.robot_goal(jnp.asarray(q), jnp.asarray(action))
        np.testing.assert_allclose(mine, goal, atol=1e-5, err_msg=f"{room}")


@pytest.fixture(scope="module")
def pressing() -> agym_jax.Env:
    return agym_jax.make("ReachingJaco-v0", impl="native")


def _account(env: agym_jax.Env) -> list[impulse.Balance]:
    rng, steps = np.random.default_rng(3), []
    with impulse.watch(env.physics) as account:
        for episode in range(2):
            state = env.reset(jax.random.PRNGKey(episode))
            for i in range(60):
                if i % 10 == 0:
                    action = rng.choice([-1.0, 1.0], env.action_size).astype(np.float32)
                state = env.step(state, action)
        steps = account.steps
    return steps


def test_forces_have_a_cause(pressing: agym_jax.Env):
    steps = _account(pressing)
    assert sum(x.force > 1.0 for x in steps) > 3  # it was about contact
    assert max(x.error for x in steps) < 0.35
    assert max(x.force / x.possible for x in steps) < 1.15
    assert max(abs(x.motors).max() for x in steps) <= 1.0 + 1e-6


def paddle(damping: float = 0.0) -> mujoco.MjModel:
    """A light paddle that falls onto the floor, with hardly any motor."""
    spec = mujoco.MjSpec()
    spec.option.timestep, spec.option.disableflags = 0.02, mujoco.mjtDisableBit.mjDSBL_EULERDAMP
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[1, 1, 1], solref=[0.04, 1.0])
    body = spec.worldbody.add_body(pos=[0, 0, 0.2])
    body.add_joint(name="joint", axis=[0, 1, 0], damping=[damping, 0, 0])
    body.add_geom(
        type=mujoco.mjtGeom.mjGEOM_CAPSULE, fromto=[0.1, 0, 0, 0.3, 0, 0], size=[0.02, 0, 0],
        mass=0.3, solref=[0.04, 1.0],
    )  # fmt: skip
    add_motors(spec, ["joint"], 1e-3, STEP)
    return spec.compile()


@pytest.mark.parametrize("hidden", [0.0, 5.0])
def test_a_torque_that_nobody_has_is_found(hidden: float):
    model = paddle()
    data, motors = mujoco.MjData(model), Motors.of(model, np.array([0]), STEP)
    account = impulse.Account(motors, 1e-3)
    data.qfrc_applied[:] = hidden
    for _ in range(50):  # falls, and lies on the floor
        account.before(data, np.zeros(1))
        mujoco.mj_step(model, data)
        account.after(model, data)
        account.finish()
    error, last = max(x.error for x in account.steps), account.steps[-1]
    assert last.force > 1.0
    np.testing.assert_allclose(error, hidden, atol=1e-6)
    assert last.force > 2.0 * last.possible if hidden else last.force < 1.01 * last.possible


def test_contacts_know_of_a_joints_damping():
    """MuJoCo's implicit integrator solves them without it, and what hits the floor sinks in."""
    depth = {}
    for way in ("armature", "integrator"):
        model = paddle(damping=3.0)
        if way == "integrator":
            model.opt.integrator, model.dof_armature[:] = (
                mujoco.mjtIntegrator.mjINT_IMPLICITFAST,
                0.0,
            )
        data = mujoco.MjData(model)
        data.qvel[:] = 3.0
        data.qpos[:] = 0.6
        data.qfrc_applied[:] = 10.0
        deepest = 0.0
        for _ in range(50):
            mujoco.mj_step(model, data)
            deepest = min([deepest, *data.contact.dist])
        depth[way] = -deepest
    assert depth["armature"] < 0.7 * depth["integrator"], depth
