"""Perfect motions at a meal, for tests: they know what no policy is told, and prove that the task can be done.

A script plans paths of the tool from several sides, follows them with inverse kinematics of the arm,
takes one that stays clear of the face and is soon done, and steers the joints along with the environment's
own actions: the arm reaches, its motors are fast enough, and food and water go where they should.
"""

from __future__ import annotations

from collections.abc import Generator
from functools import cache
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from agym_jax.human.capsules import link_capsules
from agym_jax.math3d import rotation_error
from agym_jax.offline import kinematics

YAWS = np.deg2rad([0.0, 20.0, -20.0, 45.0, -45.0, 70.0, -70.0])
"""Turns of the hand about the vertical, from how it starts."""
SIDES = np.deg2rad([0.0, 30.0, -30.0, 60.0, -60.0, 90.0, -90.0])
"""From where a cup pours, besides: it is round."""
SPOTS = np.stack(
    np.meshgrid(np.arange(-0.038, 0.003, 0.004), [-0.02, -0.01, 0.0, 0.01, 0.02], np.arange(0.0, 0.031, 0.005), indexing="ij"), -1
).reshape(-1, 3)  # fmt: skip
"""Where its lip may pour, from the mouth: along the stream, across, up [m]."""
STREAM = np.array([0.2, 0.35, 0.5])  # how fast water leaves the lip [m/s]
WIDTH = np.array([-0.012, 0.0, 0.012])  # from where on it [m]
SIP, DROP = 0.026, 0.005  # radius of the mouth, less what a plan may miss it by, and of a drop [m]
PERIOD = 0.105  # of looks at the mouth [s]
ELBOWS = (0.0, 0.01, 0.03)
"""How strongly joints are drawn away from their limits, in what moves the hand nowhere."""
FOOD_IN_SPOON = np.array([0.0, 0.0125, -0.004])  # middle of the pieces [m]
RIM_HEIGHT, RIM_RADIUS, RIM_OUTSIDE = 0.125, 0.0412, 0.0472  # of the cup [m]
CLEAR = -0.003  # of the rim from the head: a cup may touch the lips [m]
POURING = ((92.0, 0.4), (97.0, 0.4), (103.0, 0.2))
"""Tilts [degrees], and the share of the water that leaves until then."""
CAREFUL = 0.85  # of the joints' greatest speed
PATIENCE = 1.0  # control steps that a joint may be behind
SPARE = 8  # control steps of the episode to be left at the end
X, Y, Z = np.eye(3)


Capsules = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Ends (k, 3) twice, radii (k,) [m]."""


class Path(NamedTuple):
    """Poses for the tool to pass."""

    pos: np.ndarray  # [m] (K, 3)
    rot: np.ndarray  # (K, 3, 3)
    share: float = 1.0  # of the water that should arrive


class Plan(NamedTuple):
    """Joint angles to pass."""

    angles: np.ndarray  # at every control step [rad] (T, 7)
    missed: float  # greatest distance from the path [m]
    turned: float  # greatest angle from the path [rad]
    share: float


class Script:
    """A plan for one episode, of an environment that steps one environment at a time."""

    def __init__(self, env: Any, state: Any):
        self.env, self.index = env, env.scene.index
        place = state.episode.placement
        self.base = np.asarray(place.base_pos), _turn_of(np.asarray(place.base_quat))
        self.start = self.joints(state)
        control = env.task.control
        self.stride = control.action_scale * (1 - np.exp(-control.rate * control.period))
        mouth = np.asarray(state.task.mouth_pos_w, float)
        if env.task.tool.name == "spoon":
            paths = [spoonful(*self._tool(), mouth, yaw) for yaw in YAWS]
        else:
            head = _head(env, state)
            spots = {
                turn: spout(mouth, turn, head) for turn in {y + s for y in YAWS for s in SIDES}
            }
            paths = [
                sip(*self._tool(), yaw, side, *spots[yaw + side])
                for yaw in YAWS for side in SIDES
            ]  # fmt: skip
        plans = [p for p in self._follow(paths) if p.missed < 0.002 and p.turned < 0.02]
        assert plans, f"no path to the mouth of {env.name}"
        soon = [p for p in plans if len(p.angles) < env.episode_length - SPARE]
        best = max(p.share for p in soon) - 0.01 if soon else 0.0
        self.plan = min([p for p in soon if p.share >= best] or plans, key=lambda p: len(p.angles))

    def joints(self, state: Any) -> np.ndarray:
        """Angles of the arm now [rad] (7,)."""
        return np.asarray(state.data.qpos)[self.index.robot_qpos]

    def actions(self, state: Any) -> Generator[np.ndarray, Any, None]:
        """Send the states in, get an action for each. A slow arm is waited for."""
        step, angles = 0, self.plan.angles
        while True:
            to_go = angles[step] - self.joints(state)
            state = yield np.clip(to_go / self.stride, -1.0, 1.0).astype(np.float32)
            behind = np.abs(angles[step] - self.joints(state)).max()
            step = min(step + (behind < PATIENCE * self.stride), len(angles) - 1)

    def _tool(self) -> tuple[np.ndarray, np.ndarray]:
        """Pose of the tool at the start, in the world."""
        pos, rot, _ = kinematics.forward(_chain(self.env), jnp.asarray(self.start))
        base, turn = self.base
        return base + turn @ np.asarray(pos), turn @ np.asarray(rot)

    def _follow(self, paths: list[Path]) -> list[Plan]:
        """Joint angles along paths, at the speed that the joints have."""
        base, turn = self.base
        pos = np.array([(p.pos - base) @ turn for p in paths])
        rot = np.array([turn.T @ p.rot for p in paths])
        arrays = (jnp.asarray(x, jnp.float32) for x in (self.start, pos, rot, ELBOWS))
        q, missed, turned = (np.asarray(x) for x in _follower(self.env)(*arrays))
        return [
            Plan(self._timed(np.vstack([self.start, q[k, i]])), missed[k, i].max(), turned[k, i].max(), p.share)
            for i, p in enumerate(paths) for k in range(len(ELBOWS))
        ]  # fmt: skip

    def _timed(self, q: np.ndarray) -> np.ndarray:
        """The same way in control steps. Joints slow down before a limit, where targets are clipped."""
        delta = np.diff(q, axis=0)
        low, high = self.env.scene.model.jnt_range[self.index.robot_joint].T
        room = np.where(delta > 0, high - q[1:], q[1:] - low)
        share = np.clip(room / self.env.task.control.action_scale, 0.02, 1.0)
        each = (np.abs(delta) / (CAREFUL * self.stride * share)).max(1)
        time = np.concatenate([[0.0], np.cumsum(each)])
        steps = [*np.arange(1.0, time[-1]), time[-1]]
        return np.stack([np.interp(steps, time, x) for x in q.T], axis=1)


def spoonful(pos: np.ndarray, rot: np.ndarray, mouth: np.ndarray, yaw: float) -> Path:
    """The spoon goes before the mouth, into it, and tips."""
    level = _turn(Z, yaw) @ rot
    out = level[:, 2] * (1, 1, 0) / np.linalg.norm(level[:2, 2])  # along the handle
    tipped = _turn(np.cross(Z, out), np.deg2rad(30.0)) @ level
    keys = [  # of the food
        (pos + rot @ FOOD_IN_SPOON, rot), (mouth + 0.07 * out, level),
        (mouth + 0.010 * out, level), (mouth + 0.008 * out, tipped),
    ]  # fmt: skip
    return Path(*_through(keys, (40, 12, 12), FOOD_IN_SPOON))


def spout(mouth: np.ndarray, turn: float, head: Capsules) -> tuple[np.ndarray, float]:
    """Where a cup's lip best pours at each tilt [m] (T, 3), and the share that should arrive.

    Args:
        mouth: [m] (3,).
        turn: of the stream about the vertical, from y.
        head: its capsules.
    """
    towards = _turn(Z, turn) @ Y
    lips = mouth + SPOTS @ np.stack([towards, np.cross(Z, towards), Z])
    # the rim from its lip, upright; then turned about the lip
    rim = _rim() @ _turn(X, np.pi / 2).T - RIM_RADIUS * towards
    arriving, spots, total = _arriving(lips, towards, mouth, head), [], 0.0
    for degrees, part in POURING:
        tilt = _turn(np.cross(Z, towards), np.deg2rad(degrees))
        share = arriving - _cost(_off(head, lips[:, None] + rim @ tilt.T).min(1))
        spots.append(lips[np.argmax(share)])
        total += part * share.max()
    return np.array(spots), float(total)


def _cost(gap: np.ndarray) -> np.ndarray:
    """What a rim that is so far from the head [m] is worth less, in shares."""
    return 20.0 * np.maximum(CLEAR - gap, 0.0)


def _arriving(
    lips: np.ndarray, towards: np.ndarray, mouth: np.ndarray, head: Capsules
) -> np.ndarray:
    """Share of drops from lips (L, 3) that are at the mouth when it is looked at, once a control step (L,).

    They fall freely, and slide down the face.
    """
    dt = 0.004
    across = np.repeat(WIDTH[:, None] * np.cross(Z, towards), len(STREAM), axis=0)
    pos = lips[:, None] + DROP * Z + across
    vel = np.broadcast_to(np.tile(STREAM, len(WIDTH))[:, None] * towards, pos.shape)
    time = np.zeros(pos.shape[:2])
    for _ in range(40):
        vel = vel - 9.81 * dt * Z
        new = pos + dt * vel
        for a, b, radius in zip(*head, strict=True):
            out = _from_axis(a, b, new)
            away = np.linalg.norm(out, axis=-1, keepdims=True)
            new = new + out / away * np.maximum(radius + DROP - away, 0.0)
        vel, pos = (new - pos) / dt, new
        time += dt * (np.linalg.norm(pos - mouth, axis=-1) < SIP)
    return np.minimum(time / PERIOD, 1.0).mean(1)


def sip(
    pos: np.ndarray, rot: np.ndarray, yaw: float, side: float, spots: np.ndarray, share: float
) -> Path:
    """The cup's rim goes before the lips, tilting, and then the cup turns over about its rim."""
    upright, towards = _turn(Z, yaw) @ rot, _turn(Z, yaw + side) @ Y
    # the lip in the tool's frame: on the rim, on the person's side
    lip = RIM_HEIGHT * Y + RIM_RADIUS * (upright.T @ towards)
    tilted = lambda tilt: _turn(np.cross(Z, towards), np.deg2rad(tilt)) @ upright  # noqa: E731
    first = spots[0]
    keys = [
        (pos + rot @ lip, rot), (first - 0.06 * towards + 0.03 * Z, tilted(50.0)), (first, tilted(60.0)),
        *((spot, tilted(degrees)) for spot, (degrees, _) in zip(spots, POURING, strict=True)),
    ]  # fmt: skip
    return Path(*_through(keys, (40, 12, 16, 8, 8), lip), share)


def _through(keys: list, counts: tuple[int, ...], point: np.ndarray) -> tuple:
    """Poses of the tool between key poses of a point of it: straight, and turning steadily."""
    places, turns = [], []
    for (a, a_rot), (b, b_rot), n in zip(keys[:-1], keys[1:], counts, strict=True):
        share = np.linspace(0, 1, n + 1)[1:]
        rot = Slerp([0, 1], Rotation.from_matrix([a_rot, b_rot]))(share).as_matrix()
        places.append(a + share[:, None] * (b - a) - rot @ point)
        turns.append(rot)
    return np.concatenate(places), np.concatenate(turns)


def _rim() -> np.ndarray:
    """Points around the cup's rim, from its middle, in the tool's axes [m] (24, 3)."""
    around = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    return np.stack([np.cos(around), np.zeros(24), np.sin(around)], -1) * RIM_OUTSIDE


def _from_axis(a: np.ndarray, b: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Vectors to points (..., 3) from the nearest points between a and b [m] (..., 3)."""
    share = np.clip((points - a) @ (b - a) / ((b - a) @ (b - a)), 0, 1)[..., None]
    return points - a - share * (b - a)


def _off(capsules: Capsules, points: np.ndarray) -> np.ndarray:
    """Distances of points (..., 3) from the nearest capsule [m] (...)."""
    apart = [
        np.linalg.norm(_from_axis(a, b, points), axis=-1) - r
        for a, b, r in zip(*capsules, strict=True)
    ]
    return np.min(apart, axis=0)


def _head(env: Any, state: Any) -> Capsules:
    """The head's k capsules."""
    body = dict(zip(env.scene.index.links, env.scene.index.human_body, strict=True))["head"]
    pos, rot = np.asarray(state.data.xpos)[body], _turn_of(np.asarray(state.data.xquat)[body])
    a, b, radius = link_capsules(state.episode.human.dims, ("head",), {"head": pos}, {"head": rot})
    return np.asarray(a), np.asarray(b), np.asarray(radius)


def _turn(axis: np.ndarray, angle: float) -> np.ndarray:
    """Rotation matrix (3, 3) about a unit axis."""
    return Rotation.from_rotvec(angle * axis).as_matrix()


def _turn_of(quat: np.ndarray) -> np.ndarray:
    """Rotation matrix (3, 3) of a quaternion wxyz."""
    return Rotation.from_quat(quat[[1, 2, 3, 0]]).as_matrix()


def _chain(env: Any) -> kinematics.Chain:
    index = env.scene.index
    return kinematics.chain_of(
        env.scene.model, index.robot_joint, index.tools[0].tip, index.robot_base
    )


@cache
def _follower(env: Any) -> Any:
    """Compiled inverse kinematics along N paths, each pose from the one before, elbows kept free."""
    chain = _chain(env)
    low, high = np.maximum(chain.lower, -np.pi), np.minimum(chain.upper, np.pi)
    free = chain.upper - chain.lower > 2 * np.pi - 0.2

    def nearer(q: jax.Array, pos: jax.Array, rot: jax.Array, pull: jax.Array) -> jax.Array:
        tip, tip_rot, j = kinematics.forward(chain, q)
        e = jnp.concatenate([pos - tip, 0.3 * rotation_error(tip_rot, rot)])
        j = j.at[3:].multiply(0.3)
        inverse = j.T @ jnp.linalg.inv(j @ j.T + 1e-4 * jnp.eye(6))
        # what moves the hand nowhere takes joints away from their limits
        middle = jnp.where(free, 0.0, pull * ((low + high) / 2 - q))
        delta = inverse @ e + middle - inverse @ (j @ middle)
        delta = delta * jnp.minimum(1.0, 0.3 / (jnp.max(jnp.abs(delta)) + 1e-9))
        return jnp.clip(q + delta, chain.lower, chain.upper)

    def one(q: jax.Array, pose: tuple, pull: jax.Array) -> tuple:
        q, _ = jax.lax.scan(lambda q, _: (nearer(q, *pose, pull), None), q, length=10)
        tip, tip_rot, _ = kinematics.forward(chain, q)
        turned = jnp.linalg.norm(rotation_error(tip_rot, pose[1]))
        return q, (q, jnp.linalg.norm(tip - pose[0]), turned)

    def follow(q: jax.Array, pos: jax.Array, rot: jax.Array, pull: jax.Array) -> tuple:
        return jax.lax.scan(lambda q, pose: one(q, pose, pull), q, (pos, rot))[1]

    each_path = jax.vmap(follow, (None, 0, 0, None))
    return jax.jit(jax.vmap(each_path, (None, None, None, 0)))


def play(env: Any, key: jax.Array) -> tuple[Any, Plan, dict[str, float]]:
    """A whole episode by script: its last state, the plan, and sums of the metrics."""
    state = env.reset(key)
    script = Script(env, state)
    actions, total = script.actions(state), {}
    action = next(actions)
    for _ in range(env.episode_length):
        state = env.step(state, action)
        for name, value in state.metrics.items():
            total[name] = total.get(name, 0.0) + float(value)
        action = actions.send(state)
    return state, script.plan, total
