"""A scripted hand that dresses a person: it knows where the arm is, and proves that the task can be done.

The robot's hand goes along the person's forearm, on past the elbow until the cuff is there, and then over the shoulder.
Inverse kinematics follow that path with the hand turned in several ways, since how it is turned matters little
to the gown; a way on which the robot stays clear of the person is taken, and the joints are steered along
it with the environment's own actions.

    python tests/support/dress_script.py DressingJaco-v0 [episodes] [first seed]
"""

from __future__ import annotations

import sys
from functools import cache
from itertools import pairwise
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from meal_script import SPARE, Script, Z, _chain, _turn_of
from scipy.spatial.transform import Rotation

import agym_jax
from agym_jax.math3d import rotation_error
from agym_jax.matter.cloth.sleeve import crossed
from agym_jax.offline import kinematics
from agym_jax.tasks.dressing import ARM_LINKS

HEIGHT = 0.15  # of the hand above the arm's axis [m]
BEFORE = 0.02  # before the tip of the hand [m]
SHARES = (0.45, 0.38, 0.30)  # how far past the elbow the hand goes [m]
SHOULDER = 0.25  # how far past the shoulder it ends [m]
SPACING = 0.01  # of the places, about [m]
PLACES = 90  # of the hand, in all
LEVEL = 0.1  # what a radian of turning counts for [m]
TURNING = 30  # places on whose way the hand turns
TURNS = np.deg2rad(
    [(x, y, z) for z in (0, 45, -45) for x in (0, 40, -40) for y in (0, -30, -60)]
)  # of the hand, about the world's axes, from how it starts
ELBOWS = (
    0.0,
    0.03,
    0.1,
)  # how strongly joints are drawn to the middle of their range, if the hand may stay
SCRATCH_ROWS = 0.05  # of joints to their limits [rad]
REACHED = 0.01  # of the path [m]
CLEAR = 0.015  # of the robot from the person: nothing is better than this [m]
LOOK = 5  # every how many control steps


class Way(NamedTuple):
    """A plan, as meal_script.Script follows it."""

    angles: np.ndarray  # at every control step [rad] (T, 7)
    missed: float  # greatest distance from the path [m]
    share: float  # how far past the elbow [m]
    gap: float = 0.0  # least distance of the robot from the person [m]


class DressScript(Script):
    """A plan for one episode, of an environment that steps one environment at a time."""

    def __init__(self, env: Any, state: Any):
        self.env, self.index = env, env.scene.index
        place = state.episode.placement
        self.base = np.asarray(place.base_pos), _turn_of(np.asarray(place.base_quat))
        self.start = self.joints(state)
        control = env.task.control
        self.stride = control.action_scale * (1 - np.exp(-control.rate * control.period))
        joints = arm_joints(env, state)
        radius = float(state.episode.human.dims.upper_arm_r)
        pos, rot = self._tool()
        ways = [
            way
            for share in SHARES
            for way in self._ways(pull(pos, *joints, radius, share), rot, share)
        ]
        close = [w for w in ways if w.missed < REACHED] or ways
        soon = [w for w in close if len(w.angles) < env.episode_length - SPARE] or close
        near = Near(env, state)
        seen = [w._replace(gap=near.least(w.angles[::LOOK])) for w in soon]
        self.plan = max(seen, key=lambda w: (_worth(w), -len(w.angles)))

    def _ways(self, places: np.ndarray, rot: np.ndarray, share: float) -> list[Way]:
        """Joint angles along a path of the hand (PLACES, 3), one for every turn of it, and for any."""
        base, turn = self.base
        done = np.minimum(np.arange(PLACES) / TURNING, 1.0)
        turns = [Rotation.from_rotvec(done[:, None] * t).as_matrix() @ rot for t in TURNS]
        turns, levels = [*turns, turns[0]], [LEVEL] * len(TURNS) + [0.0]  # the last as it comes
        q, missed = _follower(self.env)(
            jnp.asarray(self.start, jnp.float32),
            jnp.asarray((places - base) @ turn, jnp.float32),
            jnp.asarray(turn.T @ np.array(turns * len(ELBOWS)), jnp.float32),
            jnp.asarray(levels * len(ELBOWS), jnp.float32),
            jnp.repeat(jnp.asarray(ELBOWS, jnp.float32), len(turns)),
        )
        q, missed = np.asarray(q), np.asarray(missed).max(1)
        return [
            Way(self._timed(np.vstack([self.start, a])), m, share)
            for a, m in zip(q, missed, strict=True)
        ]


def _worth(way: Way) -> float:
    """A centimetre too near the person is as bad as a tenth of the upper arm bare."""
    return round(way.share + 10.0 * min(way.gap, CLEAR), 3)


class Near:
    """Distances of what may touch: the robot's last links from person and wheelchair, in one episode."""

    def __init__(self, env: Any, state: Any):
        self.model = env.physics.alone.batch.get_model(0)  # with the person of the last reset
        self.data = mujoco.MjData(self.model)
        self.data.qpos[:] = np.asarray(state.data.qpos)
        self.joints = env.scene.index.robot_qpos
        pairs = np.stack([self.model.pair_geom1, self.model.pair_geom2], -1)
        names = [[self.model.geom(int(g)).name.split("/")[0] for g in pair] for pair in pairs]
        self.pairs = pairs[[("robot" in a) != ("robot" in b) for a, b in names]]

    def least(self, angles: np.ndarray) -> float:
        """Least distance over poses of the arm (T, 7), at most 0.1 [m]."""
        found, far = 0.1, 0.1
        for q in angles:
            self.data.qpos[self.joints] = q
            mujoco.mj_kinematics(self.model, self.data)
            for a, b in self.pairs:
                found = min(found, mujoco.mj_geomDistance(self.model, self.data, a, b, far, None))
        return found


@cache
def _follower(env: Any) -> Any:
    """Compiled inverse kinematics of N paths, each pose from the one before: places first, then turns."""
    chain = _chain(env)
    low, high = np.maximum(chain.lower, -np.pi), np.minimum(chain.upper, np.pi)
    free = chain.upper - chain.lower > 2 * np.pi - 0.2

    def follow(
        start: jax.Array, places: jax.Array, turns: jax.Array, level: jax.Array, elbow: jax.Array
    ) -> tuple:
        def nearer(q: jax.Array, pos: jax.Array, turned: jax.Array) -> jax.Array:
            tip, rot, j = kinematics.forward(chain, q)
            e = jnp.concatenate([pos - tip, level * rotation_error(rot, turned)])
            j = j.at[3:].multiply(level)
            room = jnp.minimum(q - chain.lower, chain.upper - q)
            weighted = j * jnp.clip(room / 0.3, 0.05, 1.0)  # joints near a limit move less
            middle = jnp.where(free, 0.0, elbow * ((low + high) / 2 - q))
            error = e - j @ middle
            delta = middle + weighted.T @ jnp.linalg.solve(
                j @ weighted.T + 1e-4 * jnp.eye(6), error
            )
            # where it starts nearer to a limit, it may stay
            return jnp.clip(
                q + delta,
                jnp.minimum(start, chain.lower + SCRATCH_ROWS),
                jnp.maximum(start, chain.upper - SCRATCH_ROWS),
            )

        def one(q: jax.Array, pose: tuple) -> tuple:
            q, _ = jax.lax.scan(lambda q, _: (nearer(q, *pose), None), q, length=12)
            return q, (q, jnp.linalg.norm(kinematics.forward(chain, q)[0] - pose[0]))

        return jax.lax.scan(one, start, (places, turns))[1]

    return jax.jit(jax.vmap(follow, (None, None, 0, 0, 0)))


def arm_joints(env: Any, state: Any) -> np.ndarray:
    """Shoulder, elbow and wrist of the arm to be dressed, world [m] (3, 3)."""
    bodies = dict(zip(env.scene.index.links, env.scene.index.human_body, strict=True))
    return np.array([np.asarray(state.data.xpos)[bodies[link]] for link in ARM_LINKS])


def pull(
    pos: np.ndarray, shoulder: np.ndarray, elbow: np.ndarray, wrist: np.ndarray, radius: float, share: float
) -> np.ndarray:  # fmt: skip
    """Places of the hand (PLACES, 3): before the person's, over the forearm and on, over the shoulder."""
    fore, up = _unit(elbow - wrist), HEIGHT * Z
    tip = wrist - 2 * radius * fore
    keys = [
        pos,
        tip - BEFORE * fore + up,
        elbow + share * fore + up,
        shoulder + SHOULDER * fore + up,
    ]
    places = [
        a + s * (b - a)
        for a, b in pairwise(keys)
        for s in np.linspace(0, 1, 1 + round(np.linalg.norm(b - a) / SPACING))[1:]
    ]
    return _of_same_length(np.array(places))


def _of_same_length(places: np.ndarray) -> np.ndarray:
    """The same way in as many poses for everybody: compiled once (PLACES, 3)."""
    at = np.linspace(0, len(places) - 1, PLACES)
    return np.stack([np.interp(at, np.arange(len(places)), x) for x in places.T], -1)


def _unit(a: np.ndarray) -> np.ndarray:
    return a / np.linalg.norm(a)


def play(env: Any, key: jax.Array, watch: Any = None) -> tuple[Any, Any, dict[str, float]]:
    """A whole episode by script: its last state, the plan, and sums of the metrics."""
    state = env.reset(key)
    script = DressScript(env, state)
    actions, total = script.actions(state), {}
    action = next(actions)
    for _ in range(env.episode_length):
        state = env.step(state, action)
        for name, value in state.metrics.items():
            total[name] = total.get(name, 0.0) + float(value)
        if watch is not None:
            watch(state)
        action = actions.send(state)
    return state, script.plan, total


def main(name: str, episodes: int, first: int) -> None:
    """Print how many people are dressed, and how gently."""
    env = agym_jax.make(name, impl="native")
    triangles = env.task.gown.triangles
    pierced = jax.jit(lambda a, b, cloth: crossed(a, b, cloth[triangles]).sum())
    won = []
    for seed in range(first, first + episodes):
        force, through, slid = [], [], []

        def watch(
            state: Any, force: list = force, through: list = through, slid: list = slid
        ) -> None:
            shoulder, elbow, wrist = arm_joints(env, state)
            force.append(float(state.task.force.sum()))
            slid.append(float(jnp.linalg.norm(state.task.slid)))
            ends = (shoulder, elbow), (elbow, wrist)
            through.append(sum(int(pierced(a, b, state.task.cloth.pos_w)) for a, b in ends))

        state, plan, total = play(env, jax.random.PRNGKey(seed), watch)
        won.append(float(state.metrics["success"]))
        print(
            f"{seed}: {'dressed' if won[-1] else 'NOT    '} best {float(state.task.best):.3f} m, progress "
            f"{float(state.task.progress):.2f}, plan {len(plan.angles)} steps, share {plan.share}, gap {plan.gap:.3f}, "
            f"sex {float(state.episode.human.sex):.0f}, robot on person {total['force/robot_on_human'] / 200:.2f} N, "
            f"gown at most {max(force):.2f}, mean {np.mean(force):.2f} N, slid {max(slid):.3f} m, through at most {max(through)}, at the end "
            f"{through[-1]}, nan {total['nan']:.0f}",
            flush=True,
        )
    print(f"{name}: {100 * np.mean(won):.0f} % of {episodes}")


if __name__ == "__main__":
    main(sys.argv[1], *(int(x) for x in (sys.argv[2:] + ["10", "0"][len(sys.argv) - 2 :])))
