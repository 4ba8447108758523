"""A scripted hand that dresses a person: it knows where the arm is, and proves that the task can be done.

The robot's hand goes before the tip of the person's, along the forearm, round the elbow and up the arm.
Inverse kinematics follow that path; the joints are steered with the environment's own actions.

    python tests/dress_script.py DressingJaco-v0 [episodes]
"""

from __future__ import annotations

import sys
from functools import cache
from itertools import pairwise
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from meal_script import SPARE, Path, Plan, Script, Z, _chain, _turn_of

import agym_jax
from agym_jax import kinematics
from agym_jax.tasks.dressing import ARM_LINKS

HEIGHT = 0.11  # of the hand above the arm's axis [m]
BEFORE = 0.12  # before the tip of the hand [m]
SHARES = (0.9, 0.7, 0.5, 0.3)  # of the upper arm that the opening is pulled up
SPACING = 0.01  # of the places, about [m]
PLACES = 90  # of the hand, in all
LEVELS = (0.1, 0.0)  # what a radian of turning counts for [m]


class DressScript(Script):
    """A plan for one episode, of an environment that steps one world at a time."""

    def __init__(self, env: Any, state: Any):
        self.env, self.index = env, env.scene.index
        place = state.episode.placement
        self.base = np.asarray(place.base_pos), _turn_of(np.asarray(place.base_quat))
        self.start = self.joints(state)
        control = env.task.control
        self.stride = control.action_scale * (1 - np.exp(-control.rate * control.period))
        bodies = dict(zip(self.index.links, self.index.person_body, strict=True))
        joints = [np.asarray(state.data.xpos)[bodies[link]] for link in ARM_LINKS]
        radius = float(state.episode.person.dims.upper_arm_r)
        paths = [pull(self._tool()[0], *joints, radius, share, i) for i, share in enumerate(SHARES)]
        plans = [self._follow_places(p, level) for level in LEVELS for p in paths]
        close = [p for p in plans if p.missed < 0.01] or plans
        soon = [p for p in close if len(p.angles) < env.episode_length - SPARE] or close
        self.plan = min(soon, key=lambda p: p.rank)

    def _follow_places(self, path: Path, level: float) -> Plan:
        """Joint angles along a path of the hand, whose direction matters little."""
        base, turn = self.base
        q, missed = _place_follower(self.env, level)(
            jnp.asarray(self.start, jnp.float32), jnp.asarray((path.pos - base) @ turn, jnp.float32)
        )
        angles = self._timed(np.vstack([self.start, np.asarray(q)]))
        return Plan(angles, float(missed.max()), 0.0, path.rank)


@cache
def _place_follower(env: Any, level: float) -> Any:
    """Compiled inverse kinematics of places, each from the one before; the hand turns little if it can."""
    chain = _chain(env)

    def follow(start: jax.Array, places: jax.Array) -> tuple[jax.Array, jax.Array]:
        turned = kinematics.forward(chain, start)[1]

        def nearer(q: jax.Array, pos: jax.Array) -> jax.Array:
            tip, rot, j = kinematics.forward(chain, q)
            e = jnp.concatenate([pos - tip, level * kinematics.rotation_error(rot, turned)])
            j = j.at[3:].multiply(level)
            room = jnp.minimum(q - chain.lower, chain.upper - q)
            weighted = j * jnp.clip(room / 0.3, 0.05, 1.0)  # joints near a limit move less
            delta = weighted.T @ jnp.linalg.solve(j @ weighted.T + 1e-4 * jnp.eye(6), e)
            return jnp.clip(q + delta, chain.lower, chain.upper)

        def one(q: jax.Array, pos: jax.Array) -> tuple:
            q, _ = jax.lax.scan(lambda q, _: (nearer(q, pos), None), q, length=12)
            return q, (q, jnp.linalg.norm(kinematics.forward(chain, q)[0] - pos))

        return jax.lax.scan(one, start, places)[1]

    return jax.jit(follow)


def pull(
    pos: np.ndarray, shoulder: np.ndarray, elbow: np.ndarray, wrist: np.ndarray, radius: float,
    share: float, rank: int,
) -> Path:  # fmt: skip
    """Places of the hand: before the person's, over the forearm, over the upper arm."""
    fore, upper, up = _unit(elbow - wrist), shoulder - elbow, HEIGHT * Z
    tip = wrist - 2 * radius * fore
    keys = [pos, tip - BEFORE * fore + up, elbow + up, elbow + share * upper + up]
    places = [
        a + s * (b - a)
        for a, b in pairwise(keys)
        for s in np.linspace(0, 1, 1 + round(np.linalg.norm(b - a) / SPACING))[1:]
    ]
    return Path(_of_same_length(np.array(places)), np.tile(np.eye(3), (PLACES, 1, 1)), rank)


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


def main(name: str, episodes: int) -> None:
    """Print how many people are dressed."""
    env = agym_jax.make(name, impl="native")
    won = []
    for seed in range(episodes):
        state, plan, total = play(env, jax.random.PRNGKey(seed))
        won.append(float(state.metrics["success"]))
        person = state.episode.person
        print(
            f"{seed}: {'dressed' if won[-1] else 'NOT    '} best {float(state.task.best):.3f} m, progress "
            f"{float(state.task.progress):.2f}, plan {len(plan.angles)} steps, misses {plan.missed:.3f}, sex "
            f"{float(person.sex):.0f}, robot on person {total['force/robot_on_person'] / 200:.2f} N, "
            f"gown {float(state.task.force.sum()):.2f} N, nan {total['nan']:.0f}",
            flush=True,
        )
    print(f"{name}: {100 * np.mean(won):.0f} % of {episodes}")


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]) if len(sys.argv) > 2 else 10)
