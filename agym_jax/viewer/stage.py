"""The environments that are watched, one or several side by side, and how they go on."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Any

import jax
import numpy as np

from agym_jax.data.banks import load_bank
from agym_jax.human.pose import start_angles, typical
from agym_jax.human.regions import NAMES
from agym_jax.sim.pictures import picture_model
from agym_jax.sim.scene import compose
from agym_jax.spec import Pose
from agym_jax.state import State, moved
from agym_jax.viewer.drive import Driver, ToolReach
from agym_jax.viewer.forces import ContactForces
from agym_jax.viewer.moments import Drawn, Moment
from agym_jax.viewer.people import Wishes, described
from agym_jax.viewer.picture import Place
from agym_jax.viewer.shapes import drawn_geoms

GAP = 0.8  # between environments side by side [m]


@dataclass
class History:
    """What an episode has been so far, means over its environments: a row each control step.

    Attributes:
        times: [s].
        metrics: name -> values.
        rewards: sums of the reward's terms.
    """

    times: list[float] = field(default_factory=list)
    metrics: dict[str, list[float]] = field(default_factory=dict)
    rewards: list[float] = field(default_factory=list)

    def add(self, time: float, metrics: dict[str, Any], reward: Any) -> None:
        """A control step."""
        self.times.append(time)
        self.rewards.append(float(np.mean(reward)))
        for name, value in metrics.items():
            self.metrics.setdefault(name, []).append(float(np.mean(value)))


class Stage:
    """Episodes of one environment or of several.

    Args:
        env: made with ``impl="native"``.
        driver: of all who act.
        count: environments side by side.
        visuals: what the robot looks like.

    Attributes:
        states: of all environments (count, ...).
        wishes: of whom the people of the next episode shall be.
        forces: of contacts, of a single environment.
    """

    def __init__(self, env: Any, driver: Driver, count: int = 1, visuals: str = "primitives"):
        self.env, self.driver, self.count, self.visuals = env, driver, count, visuals
        self.wishes, self.forces, self.history = Wishes(), ContactForces(), History()
        self.states: Any = None
        self.seed = 0
        self._drawn: Drawn | None = None
        physics = env.physics
        if count == 1:
            physics.watcher = self.forces
        size = 1 if count == 1 else physics.rows[1]
        self._slots = [
            (physics.alone if count == 1 else physics.slot(count), slice(i, min(i + size, count)))
            for i in range(0, count, size)
        ]
        self._pool = ThreadPoolExecutor(len(self._slots))

    # -- episodes ---------------------------------------------------------------------------------

    def begin(self, seed: int) -> None:
        """Begin the episodes of a seed and those after it, as ``agym-jax enjoy`` plays them."""
        self.seed, self.history = seed, History()
        pairs = [jax.random.split(jax.random.PRNGKey(seed + i)) for i in range(self.count)]
        keys, acting = np.swapaxes(np.array(pairs), 0, 1)
        self.driver.begin(seed, acting)
        self.env.native_rows.revise = self.wishes.of(self.env.task.human)
        rows = self.env.native_rows
        self.states = State(info={}, **self._together(lambda s, p: rows.reset(s, keys[p])))
        self.forces.forces = None
        self.arm = ToolReach(self.env, self.model(0))
        if self._drawn is None:
            self._drawn = Drawn(self.env, self.state(0).task)

    def step(self) -> None:
        """One control step of all."""
        action = self.driver.action(self.states, self.arm)
        rows, states = self.env.native_rows, self.states
        after = self._together(lambda s, p: rows.step(s, states, p, action[p]))
        self.states = moved(states, after)
        time = (len(self.history.times) + 1) * self.env.dt
        self.history.add(time, self.states.metrics, self.states.reward)

    @property
    def over(self) -> bool:
        """Whether the episodes have ended."""
        return self.states is not None and bool(np.any(np.asarray(self.states.done) > 0))

    def _together(self, run: Callable[[Any, slice], dict[str, Any]]) -> dict[str, Any]:
        """Fields of the states of all slots, each on a thread."""

        def locked(slot: Any, part: slice) -> dict[str, Any]:
            with slot.lock:
                return run(slot, part)

        found = list(self._pool.map(locked, *zip(*self._slots, strict=True)))
        return jax.tree.map(lambda *x: np.concatenate(x), *found)

    def state(self, i: int) -> Any:
        """Of one environment."""
        return jax.tree.map(lambda x: np.asarray(x)[i], self.states)

    # -- what is seen of them ---------------------------------------------------------------------

    def model(self, i: int) -> Any:
        """MuJoCo's model of an environment, with everything that people look at."""
        env = self.env
        return picture_model(env.task, env.robot, env.active, self.state(i), self.visuals)

    def places(self) -> list[Place]:
        """Where all stand in the picture."""
        columns = int(np.ceil(np.sqrt(self.count)))
        models = [self.model(i) for i in range(self.count)]
        wide, deep = self._room(models) if self.count > 1 else (0.0, 0.0)
        made = []
        for i, model in enumerate(models):
            row, column = divmod(i, columns)
            shift = np.array([column * wide, -row * deep, 0.0])
            label = described(self.state(i).episode.human) if self.count > 1 else ""
            made.append(Place(model, shift, label))
        return made

    def _room(self, models: list[Any]) -> tuple[float, float]:
        """What one environment takes at most, along x and y [m]."""
        spans = []
        for model, qpos in zip(models, np.asarray(self.states.data.qpos), strict=True):
            place = Place(model, np.zeros(3))
            place.pose(qpos)
            shown = drawn_geoms(model, True) + drawn_geoms(model, False)
            spans.append(np.ptp(place.data.geom_xpos[shown, :2], axis=0))
        wide, deep = np.max(spans, axis=0) + GAP
        return float(wide), float(deep)

    @property
    def drawn(self) -> Drawn:
        """What the task draws.

        Raises:
            RuntimeError: nothing has begun.
        """
        if self._drawn is None:
            raise RuntimeError("No episode has begun.")
        return self._drawn

    def moment(self) -> Moment:
        """All environments as they are now."""
        return self.drawn.moment(self.states)

    def status(self) -> str:
        """A few lines of Markdown about the episode."""
        metrics, steps = self.states.metrics, len(self.history.times)
        lines = [
            f"**Step {steps} of {self.env.episode_length}** ({steps * self.env.dt:.1f} s), seed {self.seed}",
            f"Return {sum(self.history.rewards):.2f}",
        ]
        success = np.asarray(metrics["success"]) > 0.5
        if self.count == 1:
            lines[-1] += ", **success**" if success[0] else ", no success yet"
            force = float(np.asarray(metrics["force/on_human"])[0])
            where = self._pressed()
            lines.append(f"Force on the person {force:.1f} N{where}")
            lines.append(described(self.state(0).episode.human))
        else:
            lines[-1] += f" (mean), success of {int(success.sum())} of {self.count}"
            forces = np.asarray(metrics["force/on_human"])
            lines.append(
                f"Force on a person {forces.mean():.1f} N (mean), {forces.max():.1f} N (most)"
            )
        return "\n\n".join(lines)

    def _pressed(self) -> str:
        """The region of the body with the largest force."""
        peak = np.asarray(self.states.regions.peak)[0]
        i = int(np.argmax(peak))
        share = float(np.asarray(self.states.metrics["force/of_comfort"])[0])
        return (
            f"; {NAMES[i]}, peak {peak[i]:.1f} N, {share:.0%} of its comfort limit"
            if peak[i] > 0.05
            else ""
        )


def preview(env: Any, visuals: str = "primitives") -> tuple[Place, Moment]:
    """A typical person before the robot at rest: what can be shown before anything is compiled."""
    task, index, bank = env.task, env.scene.index, load_bank(env.task, env.robot)
    (x, y, z), (qw, qx, qy, qz) = bank.base_pos[0].tolist(), bank.base_quat[0].tolist()
    base = Pose((x, y, z), (qw, qx, qy, qz))
    model = compose(task, env.robot, env.active, base=base, visual=True, visuals=visuals)
    qpos = np.array(model.qpos0)
    qpos[index.robot_qpos] = bank.arm_angles[0]
    pose = typical(task.human, 0.0)
    qpos[index.human_qpos] = start_angles(pose, env.scene.moving, 1.0, np)
    return Place(model, np.zeros(3)), Moment(qpos[None])
