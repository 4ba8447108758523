"""The picture of every task-robot pair at the start of an episode: ``python -m benchmarks.gallery``.

Draws one row a task and one column a robot, each with a row of the pair's placement bank and, in
turn, a man or a woman, into ``docs/images/all_pairs.jpg``.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

import mujoco
import numpy as np
from PIL import Image, ImageDraw

from agym_jax.person import pose as person_pose
from agym_jax.placement import load_bank
from agym_jax.render import Renderer
from agym_jax.robots import ROBOTS
from agym_jax.scene import compose
from agym_jax.spec import Pose, RobotSpec, Task
from agym_jax.tasks import TASKS

OUTPUT = Path(__file__).resolve().parent.parent / "docs" / "images" / "all_pairs.jpg"
WIDTH, HEIGHT = 400, 300


def draw(task: Task, robot: RobotSpec, row: int, sex: float) -> np.ndarray:
    """One pair at the start: image (HEIGHT, WIDTH, 3), uint8.

    Args:
        task: of the pair.
        robot: of the pair.
        row: of the placement bank.
        sex: of the person, 0 or 1.
    """
    bank = load_bank(task, robot)
    (x, y, z), (w, i, j, k) = bank.base_pos[row].tolist(), bank.base_quat[row].tolist()
    base = Pose((x, y, z), (w, i, j, k))
    model = compose(task, robot, sex=sex, base=base, visual=True)
    data = mujoco.MjData(model)
    joints = [f"robot/{name}" for arm in robot.arms_for(task) for name in arm.joints]
    moving = task.person.moving(active=False)
    pose = person_pose.typical(task.person, sex)
    angles = [*bank.arm_angles[row], *person_pose.start_angles(pose, moving, 1.0, np)]
    for name, angle in zip([*joints, *(f"person/{n}" for n in moving)], angles, strict=True):
        data.qpos[model.joint(name).qposadr[0]] = angle
    mujoco.mj_forward(model, data)
    with Renderer(model, 2 * WIDTH, 2 * HEIGHT) as renderer:
        large = Image.fromarray(renderer.render(data))
    return np.asarray(large.resize((WIDTH, HEIGHT), Image.Resampling.LANCZOS))


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line: an output file, if not the one in ``docs``."""
    arguments = sys.argv[1:] if arguments is None else list(arguments)
    output = Path(arguments[0]) if arguments else OUTPUT
    sheet = Image.new("RGB", (len(ROBOTS) * WIDTH, len(TASKS) * HEIGHT))
    for i, task in enumerate(TASKS.values()):
        for j, robot in enumerate(ROBOTS.values()):
            picture = Image.fromarray(draw(task, robot, 5 + i, float((i + j) % 2)))
            ImageDraw.Draw(picture).text((8, 6), f"{task.name}{robot.name}-v0", fill=(20, 20, 20))
            sheet.paste(picture, (j * WIDTH, i * HEIGHT))
            print(f"\r{i * len(ROBOTS) + j + 1}/{len(TASKS) * len(ROBOTS)}", end="", flush=True)
    sheet.save(output, quality=84)
    print(f"\r{output}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
