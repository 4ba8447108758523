"""Pressing on the person.

In Assistive Gym a Jaco pressed its scratcher on the arm (ScratchItch, 24 cases of 2.5 s) and its empty spoon on the face
(Feeding, 16 cases of 4 s) with a constant action. Here the same actions are played from the same joint angles in C MuJoCo,
with the motors of the environment. Forces are means over control steps; Feeding's are five times what AG reports, which is
the true force (its last sub-step's impulse is divided by the outer time step). Contacts are as good as rigid in both.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

import agym_jax
from agym_jax.human import pose
from agym_jax.sim.episode import make_episode
from agym_jax.state import Episode
from benchmarks.parity.row import Row, traces

TASKS = {"ScratchItchJaco": "scratcher on the arm", "FeedingJaco": "spoon on the face"}
TOUCHES = 0.3  # [N] that count as a touch
LAST = 10  # control steps at the end of a case, 1 s


class Press(NamedTuple):
    """What cases look like, for each control step."""

    force: np.ndarray  # of the tool on the person, mean over the step [N]      (n, steps)
    depth: np.ndarray  # of the tool in the person after it, NaN apart [m]      (n, steps)


def episode_of(env: agym_jax.Env, name: str, case: int) -> Episode:
    """An episode of an unimpaired person that begins as a recorded case does."""
    kept, drawn = traces("pressing"), env.reset(jax.random.PRNGKey(0)).episode
    one, spec = jnp.float32(1.0), env.task.human
    sex = float(kept[f"{name}_case"][case, 0])
    human = dataclasses.replace(
        drawn.human, sex=jnp.float32(sex), stature=one, girth=one, strength=one, limit_scale=one,
        tremor=jnp.zeros_like(drawn.human.tremor),
    )  # fmt: skip
    body = jax.tree.map(jnp.float32, pose.typical(spec, sex, 1.0, 1.0, 1.0))
    place = dataclasses.replace(drawn.placement, arm_angles=jnp.asarray(kept[f"{name}_q"][case]))
    episode = make_episode(env.scene, spec, (human, body, place, None), np)
    if name.startswith("Feeding"):
        return episode
    angles = kept[f"{name}_arm_q"][case]
    return dataclasses.replace(episode, human_angles=angles, human_target=angles)


def press(name: str, cases: Sequence[int] | np.ndarray) -> Press:
    """Play recorded cases."""
    env, kept = agym_jax.make(f"{name}-v0", impl="native"), traces("pressing")
    aim, sense = jax.jit(env.controller.targets), jax.jit(env._sense)
    steps = kept[f"{name}_force"].shape[1]
    force, depth = np.zeros((len(cases), steps)), np.full((len(cases), steps), np.nan)
    for row, case in enumerate(cases):
        episode = episode_of(env, name, case)
        data = env.physics.reset(env.physics.make_data(), episode)
        for t in range(steps):
            targets = aim(episode, data, kept[f"{name}_action"][case])
            data, sums, motion = env.physics.step(data, episode, targets)
            tool = sense(data, sums, motion, episode).tool
            force[row, t] = tool.on_human
            if force[row, t] > TOUCHES:
                depth[row, t] = -tool.gap
    return Press(force, depth)


def recorded(name: str, cases: Sequence[int] | np.ndarray) -> Press:
    """The same cases in Assistive Gym."""
    kept = traces("pressing")
    return Press(kept[f"{name}_force"][list(cases)], kept[f"{name}_depth"][list(cases)])


def rows(every: int = 1) -> list[Row]:
    """The comparison.

    Args:
        every: leaves out all but each n-th case.
    """
    out = []
    for name, what in TASKS.items():
        levels = traces("pressing")[f"{name}_case"][:, 1]
        cases = np.arange(len(levels))[::every]
        both = recorded(name, cases), press(name, cases)
        for level in np.unique(levels.round(2)):
            of = np.isclose(levels[cases], level, atol=0.01)
            last = [float(x.force[of, -LAST:].mean()) for x in both]
            peak = [float(x.force[of].max(1).mean()) for x in both]
            action = f"{what}, largest action {level:.1f}"
            for quantity, values in (("force in the last second", last), ("peak", peak)):
                tolerance = 0.25 * values[0]
                out.append(
                    Row(f"{action}: {quantity}", "N", values[0], values[1], tolerance, "rigid-grip")
                )
        touching = [float(np.mean(x.force > 0.05)) for x in both]
        depth = [1e3 * float(np.nanmedian(x.depth)) for x in both]
        out.append(
            Row(f"{what}: share of control steps in touch", "", touching[0], touching[1], 0.1)
        )
        out.append(Row(f"{what}: depth of the contact, median", "mm", depth[0], depth[1], 1.0))
    return out
