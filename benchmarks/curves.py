"""Learning curves of the recorded trainings as one picture: ``python -m benchmarks.curves``.

Reads ``benchmarks/results/curves.jsonl`` (one line a training: ``env_steps``, ``return`` and ``success`` of
the episodes that ended since the line before) and draws ``docs/images/learning_curves.png``.
"""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path
from typing import Any

from agym_jax.registry import active_id, static_id
from benchmarks.markdown import RESULTS

OUTPUT = RESULTS.parent.parent / "docs" / "images" / "learning_curves.png"
COLUMNS = 4


def newest(path: Path = RESULTS / "curves.jsonl") -> dict[str, dict[str, Any]]:
    """The last recorded curve of every environment."""
    lines = [json.loads(row) for row in path.read_text().splitlines() if row.strip()]
    return {line["env"]: line for line in lines}


def draw(curves: dict[str, dict[str, Any]], output: Path) -> None:
    """One panel a task: success over millions of steps, a line a robot; dashed where the person learns too."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    robots = ("PR2", "Jaco", "Baxter", "Sawyer")
    tasks = sorted({_task(name, robots) for name in curves})
    rows = math.ceil(len(tasks) / COLUMNS)
    figure, panels = plt.subplots(rows, COLUMNS, figsize=(3.4 * COLUMNS, 2.8 * rows), squeeze=False)
    for panel in panels.flat[len(tasks) :]:
        panel.set_axis_off()
    for panel, task in zip(panels.flat, tasks, strict=False):
        for number, robot in enumerate(robots):
            name = f"{task}{robot}-v0"
            for env_name, look in ((name, "-"), (active_id(name), "--")):
                if line := curves.get(env_name):
                    steps = [x / 1e6 for x in line["env_steps"]]
                    shares = [100 * x for x in line["success"]]
                    label = robot if look == "-" else "_"
                    panel.plot(steps, shares, look, color=f"C{number}", label=label, linewidth=1.4)
        panel.set(title=task, xlabel="million steps", ylim=(0, 101))
        panel.grid(alpha=0.25)
    for first in panels[:, 0]:
        first.set_ylabel("success while training [%]")
    panels[0][0].legend(frameon=False, fontsize=8)
    figure.tight_layout()
    figure.savefig(output, dpi=110)
    plt.close(figure)


def _task(name: str, robots: tuple[str, ...]) -> str:
    who = static_id(name).removesuffix("-v0")
    return next(who.removesuffix(robot) for robot in robots if who.endswith(robot))


def main() -> int:
    """The command line."""
    draw(newest(), OUTPUT)
    print(OUTPUT)
    return 0


if __name__ == "__main__":
    sys.exit(main())
