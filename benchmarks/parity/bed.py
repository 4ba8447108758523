"""The bed and who lies on it.

Points of Assistive Gym's mattress, recorded by rays, against the nearest surface of the two shapes that arms, tools and
hands meet, where those go; the pillow's slope is what bears the girdle. Beside the person, where robots lean on the bed, are also
points of the pillow's side, against what robots and the wiper meet in BedBathing. People are those of the banks of postures,
of Assistive Gym's sizes: men and women with full joint limits against all that were recorded (20 resets, every
impairment). Widths are standard deviations.
"""

from __future__ import annotations

from functools import cache

import mujoco
import numpy as np

from agym_jax.data.assets import asset_path
from agym_jax.furniture import BED
from agym_jax.human.posture import link_positions, load_postures
from agym_jax.tasks import TASKS
from benchmarks.parity.row import Row, traces

MARGIN = 0.001  # AG's shapes keep this distance from each other, and so do ours from its mesh [m]
LINKS = {"chest": "chest", "elbow": "right_forearm", "wrist": "right_hand", "head": "head"}
RECORDED = ("chest", "shoulder", "elbow", "wrist", "head", "hips")  # columns of the traces


@cache
def _bed() -> tuple[mujoco.MjModel, mujoco.MjData]:
    """The bed with a point to measure from."""
    spec = mujoco.MjSpec.from_file(str(asset_path(BED.model)))
    probe = spec.worldbody.add_body(name="probe", mocap=True)
    probe.add_geom(name="probe", type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[1e-6, 0, 0])
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    return model, data


def heights(points: np.ndarray, geoms: tuple[str, ...]) -> np.ndarray:
    """Distances of points from shapes of the bed [m], negative inside them (n,)."""
    model, data = _bed()
    probe, ids = model.geom("probe").id, [model.geom(g).id for g in geoms]
    found = []
    for point in points:
        data.geom_xpos[probe] = point
        found.append(min(mujoco.mj_geomDistance(model, data, probe, g, 1.0, None) for g in ids))
    return np.array(found)


def surface(part: str, geoms: tuple[str, ...]) -> np.ndarray:
    """How far AG's surface, with its margin, is from ours at the recorded points [m], positive above it (n,)."""
    return heights(traces("bed")[part].astype(float), geoms) + MARGIN


def settled(task: str, sex: int) -> dict[str, np.ndarray]:
    """Where links of the bank's people lie, world [m]: link -> (n, 3)."""
    bank = load_postures(task)
    plain = (bank.stature == 1) & (bank.girth == 1) & (bank.limit_scale == 1) & (bank.sex == sex)
    people = [link_positions(bank.row(int(i))) for i in np.flatnonzero(plain)]
    return {name: np.array([p[link] for p in people]) for name, link in LINKS.items()}


def rows() -> list[Row]:
    """The surface, then people in both tasks."""
    top, side = surface("top", BED.geoms), surface("side", BED.geoms)
    pillow = surface("pillow", BED.pillow)
    beside = surface("beside", (*BED.geoms, *TASKS["BedBathing"].seat.outline))
    found = [
        Row("mattress, 95 % of the points within", "m", 0.0, float(np.percentile(abs(top), 95)), 0.005, "bed-shape"),
        Row("mattress, root mean square", "m", 0.0, float(np.sqrt(np.mean(top**2))), 0.005, "bed-shape"),
        Row("side of the mattress, root mean square", "m", 0.0, float(np.sqrt(np.mean(side**2))), 0.01, "bed-shape"),
        Row("pillow's slope, root mean square", "m", 0.0, float(np.sqrt(np.mean(pillow**2))), 0.005, "bed-shape"),
        Row("pillow and mattress beside the person, root mean square", "m", 0.0, float(np.sqrt(np.mean(beside**2))), 0.005, "bed-shape"),
    ]  # fmt: skip
    for task in ("BedBathing", "ArmManipulation"):
        for sex, who in enumerate(("men", "women")):
            ours, ag = settled(task, sex), traces("bed")[f"{task}_{('male', 'female')[sex]}"]
            for link in LINKS:
                theirs = ag[:, RECORDED.index(link)]
                found.append(
                    Row(
                        f"{task}, {who}: height of the {link}, mean", "m", float(theirs[:, 2].mean()),
                        float(ours[link][:, 2].mean()), 0.01, "settle",
                    )
                )  # fmt: skip
            for link in ("elbow", "wrist"):
                theirs = ag[:, RECORDED.index(link)]
                for axis, name in ((0, "across"), (1, "along"), (2, "height")):
                    found.append(
                        Row(
                            f"{task}, {who}: {link} {name}, width", "m", float(theirs[:, axis].std()),
                            float(ours[link][:, axis].std()), 0.02, "settle",
                        )
                    )  # fmt: skip
    return found
