"""The gown on the robot's arm.

The first 36 actions that the policies of Jaco and PR2 which shipped on 30 November 2026 took in Assistive Gym (seeds 7000 to 7003 of each) are played here from the same bases and joint angles
(of the section above: they depend on the seed, not on the policy), with joints up to 1 mrad off, two draws each: with a gown that hung in front of the hand (`settled_gown`), also with one that meets
the robot (`meets_robot`), and also with the person's arm as Assistive Gym's cloth finds it (`tapered_arms`). Compared is the middle of the cuff: how far it is from its place there as the
episode begins, on average over 1.1 to 3.5 s, and, sideways, after 2.5 s (means of distances and of their magnitudes). The recorded gowns are not those of these episodes, but the most similar of 80.
There, Jaco's gown lies on its arm: of 1,929 contacts that were recorded every 10 steps of an episode (seed 7001), 733 are within 41 mm of a shape of links 1 to 4, by the distances of `meets_robot`, and 280 of the hand's or the fingers'.
Of the other robots, it touches only hand and fingers: in 165 of 1,799 contacts of PR2, 229 of 1,819 of Baxter and 66 of 2,417 of Sawyer.
"""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import agym_jax
from agym_jax.matter.cloth.kernel import InArrays
from agym_jax.matter.cloth.robot_links import link_grids, read_off
from benchmarks.parity.dressing import begin
from benchmarks.parity.row import Row, traces

PLAYED = ("Jaco", "PR2")
ON_THE_WAY, THEN = slice(10, 35), 24  # control steps
DRAWS = 2  # replays of each episode
TOLERANCE = 0.04  # [m]
SETTLED: dict[str, Any] = {"settled_gown": 1.0}
SETTINGS = (
    (SETTLED, "gown as there"),
    (SETTLED | {"meets_robot": 1.0}, "and it meets the robot"),
    (SETTLED | {"meets_robot": 1.0, "tapered_arms": 1.0}, "and the arm as there"),
)


def contacts(robot: str, shift: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Distance of all of the gown's recorded contacts from a robot's shapes, by the tables [m] (n,), inf far away; and the row of the link (n,).

    Args:
        robot: its name.
        shift: by which the links are displaced along x [m].
    """
    kept = {x: traces("robot_arm")[f"{robot}_{x}"] for x in ("links", "link_pos", "link_rot", "contacts", "state")}  # fmt: skip
    grids = link_grids(robot, tuple(kept["links"].tolist()))
    pos, rot = jnp.asarray(kept["link_pos"]), jnp.asarray(kept["link_rot"])
    frames = np.asarray(grids.frames(pos.at[..., 0].add(shift), rot))[kept["state"]]
    table, found = InArrays(jnp.asarray(grids.distances)[None]), []
    for k, layout in enumerate(grids.layouts):
        off, axes = kept["contacts"] - frames[:, k, :3], frames[:, k, 3:].reshape(-1, 3, 3)
        x, y, z = jnp.asarray(np.einsum("nij,nj->in", axes, off))
        dist, _, known = read_off((x, y, z), table, layout)
        found.append(np.where(known, dist, np.inf))
    return np.min(found, 0), grids.rows[np.argmin(found, 0)]


def play(env: agym_jax.Env, case: int, key: jax.Array) -> np.ndarray:
    """How far the middle of the cuff is from where it is there, after each step of a replay, world axes [m] (n, 3)."""
    kept, starts = traces("robot_arm"), traces("dressing")
    same = (starts["robot"] == kept["robot"][case]) & (starts["seed"] == kept["seed"][case])
    state, path = begin(env, int(np.flatnonzero(same)[0]), key), []
    cuff = np.asarray(env.task.watched).ravel()  # type: ignore[attr-defined]
    for action in kept["actions"][case]:
        state = env.step(state, action)
        path.append(np.asarray(state.task.cloth.pos_w)[cuff].mean(0))
    return np.array(path) - kept["cuff"][case]


def rows() -> list[Row]:
    """The cuff on its way to the hand."""
    kept, found = traces("robot_arm"), []
    for robot in PLAYED:
        cases = np.flatnonzero(kept["robot"] == robot).tolist()
        for settings, what in SETTINGS:
            env = agym_jax.make(f"Dressing{robot}-v0", impl="native", config=settings)
            keys = [jax.random.PRNGKey(i) for i in range(DRAWS)]
            off = np.stack([play(env, case, key) for case in cases for key in keys])
            far = np.linalg.norm(off, axis=-1)
            why = "gown-start" if len(settings) == 3 else "cloth-obstacles"
            name = f"{robot}, {what}: cuff off"
            found += [
                Row(f"{name} as the episode begins", "m", 0.0, float(far[:, 0].mean()), TOLERANCE, "gown-start"),
                Row(f"{name} on the way", "m", 0.0, float(far[:, ON_THE_WAY].mean()), TOLERANCE, why),
                Row(f"{name} sideways after 2.5 s", "m", 0.0, float(np.abs(off[:, THEN, 0]).mean()), TOLERANCE, why),
            ]  # fmt: skip
    return found
