"""Food and water.

The spoon and the cup are carried along the poses that Jaco gave them when it turned them in place, from the recorded
places of the particles: towards the person, away, to both sides, and towards the person at half the speed. Compared are the
angles of the turn at which half of the particles and all of them have left: food 5 cm from where it lay, water the
cylinder by which Assistive Gym counts it.
"""

from __future__ import annotations

import functools
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np

from agym_jax.math3d import child_pose, rotation_matrix
from agym_jax.matter.particles.solver import Obstacles, Particles, ParticleSpec, advance
from agym_jax.matter.shapes import Capsules, no_boxes
from agym_jax.spec import Pose, Task
from agym_jax.tasks import TASKS
from agym_jax.tasks.drinking import INSIDE, in_cup
from agym_jax.tasks.feeding import DISH
from benchmarks.parity.row import Row, traces

WAYS = (
    "towards the person",
    "away",
    "to one side",
    "to the other side",
    "slowly towards the person",
)
VESSELS: dict[str, Pose] = {"Feeding": DISH, "Drinking": INSIDE}
LAY = 0.05  # food that is farther from where it lay has left [m]
DEVIATION = "vessel-shape"


def rows() -> list[Row]:
    """When half and all of it has left, for every recorded turn that lets all leave."""
    found = []
    for name, vessel in VESSELS.items():
        task = TASKS[name]
        for run, way in enumerate(WAYS):
            key = f"{name.lower()}_tilt{run}"
            t = traces("matter")
            angle, theirs = np.rad2deg(t[f"{key}_angle"]), t[f"{key}_count"]
            if theirs.min() > 0:
                continue  # a joint's limit ended the turn
            ours = left(task, vessel, t[f"{key}_tool"], t[f"{name.lower()}_start"][run])
            what = "food" if name == "Feeding" else "water"
            for part, share in (("half", 0.5), ("the last", 0.0)):
                a, b = (_first(angle, n <= share * n[0]) for n in (theirs, ours))
                found.append(
                    Row(f"{what}, {way}: {part} has left at", "degrees", a, b, 10.0, DEVIATION)
                )
    return found


@functools.cache
def _stepper(task: Task, vessel: Pose) -> Callable[[Particles, tuple, tuple], Particles]:
    """One control step of a vessel that nobody and nothing is near, from one pose of the tool to another."""
    share = np.linspace(0.0, 1.0, task.control.frame_skip + 1, dtype=np.float32)[:, None]
    far = jnp.full((len(share), 1, 3), 1e3)
    nobody = Capsules(far, far, jnp.full(1, 0.01))

    @jax.jit
    def step(state: Particles, before: tuple, after: tuple) -> Particles:
        pos, quat = (a + share * (b - a) for a, b in zip(before, after, strict=True))
        unit = quat / jnp.linalg.norm(quat, axis=-1, keepdims=True)
        around = Obstacles(
            *child_pose(pos, unit, vessel.pos, vessel.quat), nobody, no_boxes(), jnp.float32(0.0)
        )
        return advance(_spec(task), state, around, task.control.time_step)[0]

    return step


def _spec(task: Task) -> ParticleSpec:
    return task.food if hasattr(task, "food") else task.water  # pyrefly: ignore


def _first(angle: np.ndarray, when: np.ndarray) -> float:
    """The angle at which something is so for the first time; the last one if it never is."""
    return float(angle[np.argmax(when)] if when.any() else angle[-1])


def left(task: Task, vessel: Pose, tool: np.ndarray, start: np.ndarray) -> np.ndarray:
    """How many particles are in a vessel that is carried, at each control step (T,).

    Args:
        task: Feeding or Drinking.
        vessel: its frame in the tool's.
        tool: poses, world, quaternions xyzw (T, 7).
        start: particles in the tool's frame (n, 3).
    """
    pos, quat = tool[:, :3].astype(np.float32), tool[:, [6, 3, 4, 5]].astype(np.float32)
    flips = np.cumprod(np.where((quat[1:] * quat[:-1]).sum(-1) < 0, -1.0, 1.0))
    quat[1:] *= flips[:, None]
    world = pos[0] + start @ rotation_matrix(quat[0], np).T
    state = Particles(
        jnp.asarray(world, jnp.float32), jnp.zeros(world.shape), jnp.ones(len(world), bool)
    )
    step = _stepper(task, vessel)
    counts = []
    for i in range(len(pos)):
        if i:
            state = step(state, (pos[i - 1], quat[i - 1]), (pos[i], quat[i]))
        if task.name == "Feeding":
            local = (np.asarray(state.pos_w) - pos[i]) @ rotation_matrix(quat[i], np)
            inside = np.linalg.norm(local - start, axis=-1) < LAY
        else:
            inside = in_cup(state.pos_w, jnp.asarray(pos[i]), jnp.asarray(quat[i]))
        counts.append(int(np.sum(np.asarray(inside))))
    return np.array(counts)
