"""A policy of agym_jax in Assistive Gym v0.1 itself, on Assistive Gym's own engine.

    python benchmarks/in_assistive_gym.py ScratchItchJaco-v0 assets/policies/ScratchItchJaco-v0.npz --num-episodes 20 --json FILE

Run it with the Python in which Assistive Gym was built (CONTRIBUTING.md says how) and its folder on the Python path; of
agym_jax it needs this file and the policy alone (with ``--smooth-bed`` also ``smooth_bed.py`` and ``assets/furniture/bed.xml``), and of other packages NumPy. Each episode is one of Assistive Gym's own,
its result follows from the seed: the joint limits at which Assistive Gym puts people's joints back, which it keeps from
the first person of a process, are each person's own here. The policy acts by the mode of its distribution and sees what it would see here: joints that turn
freely begin in [-pi, pi), quaternions are wxyz and do not jump.
"""

from __future__ import annotations

import argparse
import json
import re
import time
from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

EPISODE_LENGTH = 200
PERIOD = 0.1  # of a control step [s]
BEDS = ("BedBathing", "ArmManipulation")
QUATS = {"Feeding": (3, 20), "Drinking": (3, 20), "ArmManipulation": (3, 10)}
"""First columns of the quaternions that robots observe; (3,) in other tasks."""
ANGLES = {
    "ScratchItch": 13, "BedBathing": 7, "Feeding": 10, "Drinking": 10, "Dressing": 7,
    "ArmManipulation": 14,
}  # fmt: skip
"""First column of the joint angles that robots observe."""
FREE = {"jaco": (0, 2, 4, 6), "pr2": (4, 6), "sawyer": (), "baxter": ()}
"""Joints of an arm that turn freely."""
NORMALISED_CLIP = 10.0  # deviations
ROBOTS = ("pr2", "jaco", "baxter", "sawyer")
Act = Callable[[np.ndarray], np.ndarray]


BENDS: dict[str, Act] = {
    "tanh": np.tanh,
    "elu": lambda x: np.where(x > 0.0, x, np.expm1(np.minimum(x, 0.0))),
    "relu": lambda x: np.maximum(x, 0.0),
    "swish": lambda x: x / (1.0 + np.exp(-x)),
}


def load_actor(path: str | Path) -> tuple[Act, dict[str, Any]]:
    """The mode of a policy's action, in NumPy, and what its file tells of it.

    Args:
        path: of a policy file of agym_jax.
    """
    with np.load(path, allow_pickle=False) as file:
        arrays = {name: np.asarray(file[name]) for name in file.files}
    about = json.loads(bytes(arrays["__meta__"]).decode())
    arch = about["arch"]
    layers = sorted(n.removesuffix("/kernel") for n in arrays if n.endswith("/kernel"))
    layers.sort(key=lambda name: "hidden" not in name)
    weights = [
        (arrays[f"{name}/kernel"].astype(float), arrays[f"{name}/bias"].astype(float))
        for name in layers
    ]
    mean, std = (arrays[f"observation/{name}"].astype(float) for name in ("mean", "std"))
    bend, size = BENDS[arch["activation"]], arch["action_size"]
    squash = np.tanh if arch["distribution"] == "tanh_normal" else np.asarray

    def act(obs: np.ndarray) -> np.ndarray:
        x = np.clip((obs - mean) / std, -NORMALISED_CLIP, NORMALISED_CLIP)
        for i, (kernel, bias) in enumerate(weights):
            x = x @ kernel + bias
            if i < len(weights) - 1:
                x = bend(x)
        return np.clip(squash(x[:size]), -1.0, 1.0)

    return act, about


class Translator:
    """Assistive Gym's observations of one episode as agym_jax shows them.

    Args:
        task: of the environment.
        robot: of the environment, in lower case.
        first: what Assistive Gym shows at the start (n_obs,).
    """

    def __init__(self, task: str, robot: str, first: np.ndarray) -> None:
        arms = 2 if task == "ArmManipulation" else 1
        self.free = [ANGLES[task] + 7 * arm + joint for arm in range(arms) for joint in FREE[robot]]
        self.quats = QUATS.get(task, (3,))
        turns = 2.0 * np.pi
        self.windings = turns * np.floor((first[self.free] + np.pi) / turns)
        self.last: dict[int, np.ndarray] = {}

    def __call__(self, obs: np.ndarray) -> np.ndarray:
        """One observation (n_obs,)."""
        seen = np.array(obs, float)
        seen[self.free] -= self.windings
        for at in self.quats:
            quat = np.roll(seen[at : at + 4], 1)  # xyzw to wxyz
            if at in self.last and quat @ self.last[at] < 0.0:
                quat = -quat
            seen[at : at + 4] = self.last[at] = quat
        return seen


class Memory:
    """Observations of one episode with the averages that a policy with memory sees, see ``agym_jax.memory``.

    Args:
        times: time constants of the averages [s]; none for a policy without memory.
    """

    def __init__(self, times: Sequence[float]) -> None:
        self.shares = PERIOD / np.reshape(np.asarray(times, float), (-1, 1))
        self.averages: Any = None

    def __call__(self, obs: np.ndarray) -> np.ndarray:
        """One observation (n_obs,); returns it with its averages (n_obs * (1 + number of averages),)."""
        if self.averages is None:
            self.averages = np.tile(obs, (len(self.shares), 1))
        self.averages = self.averages + self.shares * (obs - self.averages)
        return np.concatenate([obs, self.averages.reshape(-1)])


def make_env(task: str, robot: str) -> Any:
    """Assistive Gym's environment, its person passive."""
    module = re.sub(r"(?<!^)(?=[A-Z])", "_", task).lower()
    loaded = __import__(f"assistive_gym.envs.{module}", fromlist=[task])
    return getattr(loaded, f"{task}Env")(robot_type=robot, human_control=False)


def reset(env: Any, seed: int) -> np.ndarray:
    """An episode that follows from the seed alone; Assistive Gym seeds parts of itself elsewhere, and keeps limits."""
    random = np.random.RandomState(seed)
    world = env.world_creation
    for part in (env, world, env.util, world.human_creation):
        part.np_random = random
    env.human_joint_lower_limits = env.human_joint_upper_limits = None  # not the last person's
    return np.asarray(env.reset(), float)


def roll(env: Any, length: float) -> None:
    """Set the rolling and spinning friction of the bed's material [m]; Assistive Gym's is 5 in BedBathing, 0.3 in ArmManipulation."""
    import pybullet

    frictions = {"rollingFriction": length, "spinningFriction": length}
    pybullet.changeDynamics(env.bed, -1, **frictions, physicsClientId=env.id)


class HeldTool:
    """The tool in the hand, where Assistive Gym's fixed constraint yields.

    Args:
        env: after its reset.
    """

    def __init__(self, env: Any) -> None:
        import pybullet

        self.bullet, self.tool, self.options = pybullet, env.tool, {"physicsClientId": env.id}
        ids = [pybullet.getConstraintUniqueId(i, **self.options) for i in range(pybullet.getNumConstraints(**self.options))]  # fmt: skip
        ends = [pybullet.getConstraintInfo(x, **self.options)[:3] for x in ids]
        self.hand = next((body, link) for body, link, child in ends if child == env.tool)
        self.first = self._orientation()

    def _orientation(self) -> np.ndarray:
        """In the link that holds it, xyzw (4,)."""
        hand = self.bullet.getLinkState(*self.hand, computeForwardKinematics=True, **self.options)
        tool = self.bullet.getBasePositionAndOrientation(self.tool, **self.options)
        inverse = self.bullet.invertTransform(*hand[:2])
        return np.asarray(self.bullet.multiplyTransforms(*inverse, *tool)[1])

    def turn(self) -> float:
        """By how much it has turned since the beginning [rad]."""
        return 2.0 * float(np.arccos(min(1.0, abs(self._orientation() @ self.first))))


def start_of(env: Any, obs: np.ndarray) -> dict[str, Any]:
    """How an episode of ScratchItch begins, for ``benchmarks.same_starts``: what the robot sees, the person, the itch.

    Args:
        env: after its reset.
        obs: as ``Translator`` shows it (30,).
    """
    world = env.world_creation
    tremor = world.human_tremors if world.human_impairment == "tremor" else np.zeros(10)
    return {
        "obs": obs, "sex": float(env.gender == "female"), "strength": world.human_strength,
        "limit_scale": world.human_limit_scale, "tremor": np.asarray(tremor, float),
        "on_forearm": float(env.limb == 7), "itch": np.asarray(env.target_on_arm, float),
    }  # fmt: skip


def run_episode(
    env: Any,
    act: Act,
    task: str,
    robot: str,
    seed: int,
    bed_rolling: float | None = None,
    memory: Sequence[float] = (),
) -> SimpleNamespace:
    """One episode.

    Args:
        env: from ``make_env``.
        act: from ``load_actor``.
        task: of the environment.
        robot: of the environment, in lower case.
        seed: of the episode.
        bed_rolling: see ``roll``, from the start of the episode on; None leaves it alone.
        memory: of the policy [s].

    Returns:
        ``success``, ``total`` reward, the mean and greatest ``forces`` on the person [N]; in ScratchItch the ``start`` and by
        how much the tool has ``turned`` in the hand at most [rad].
    """
    obs = reset(env, seed)
    if bed_rolling is not None:
        roll(env, bed_rolling)
    translate, forces, total, info = Translator(task, robot, obs), [], 0.0, {}
    remember, start, tool, turned = Memory(memory), None, None, 0.0
    if task == "ScratchItch":
        start, tool = start_of(env, translate(obs)), HeldTool(env)
    twice = task == "ArmManipulation" and robot in ("jaco", "sawyer")  # it takes their action twice
    for _ in range(EPISODE_LENGTH):
        action = act(remember(translate(obs)))
        obs, reward, _, info = env.step(np.tile(action, 2) if twice else action)
        total += float(reward)
        forces.append(float(info["total_force_on_human"]))
        if tool:
            turned = max(turned, tool.turn())
    return SimpleNamespace(
        success=bool(info["task_success"]), total=total, forces=(np.mean(forces), np.max(forces)),
        start=start, turned=turned,
    )  # fmt: skip


def write_starts(path: Path, first_seed: int, found: Sequence[SimpleNamespace]) -> None:
    """Write how episodes of ScratchItch began and ended, for ``benchmarks.same_starts``."""
    ends = [{"success": x.success, "turned": x.turned, **x.start} for x in found]
    columns: dict[str, Any] = {name: np.array([row[name] for row in ends]) for name in ends[0]}
    np.savez_compressed(path, **columns, seed=first_seed + np.arange(len(ends)))


def parse(name: str) -> tuple[str, str]:
    """Task and robot of an id such as ``ScratchItchJaco-v0``."""
    found = re.fullmatch(rf"({'|'.join(ANGLES)})({'|'.join(ROBOTS)})-v0", name, re.IGNORECASE)
    if not found:
        raise SystemExit(
            f"{name!r} is not an id of Assistive Gym: a task ({', '.join(ANGLES)}), a robot "
            f"({', '.join(ROBOTS)}) and -v0, such as ScratchItchJaco-v0."
        )
    return next(t for t in ANGLES if t.lower() == found[1].lower()), found[2].lower()


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the episodes, with a line for each."""
    flags = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    flags.add_argument("env_name")
    flags.add_argument("policy", type=Path)
    flags.add_argument("--num-episodes", type=int, default=20)
    flags.add_argument(
        "--seed", type=int, default=0, help="of the first episode; the next has the next"
    )
    flags.add_argument(
        "--bed-rolling",
        type=float,
        help="rolling friction of the bed's material after the reset [m]",
    )
    flags.add_argument(
        "--smooth-bed",
        action="store_true",
        help="our bed's shapes instead of the mesh's pieces, see benchmarks/smooth_bed.py",
    )
    flags.add_argument("--json", type=Path, help="file that a line with the result is appended to")
    flags.add_argument(
        "--starts", type=Path, help="NumPy file for the starts of ScratchItch's episodes, see benchmarks.same_starts"
    )  # fmt: skip
    given = flags.parse_args(arguments)
    task, robot = parse(given.env_name)
    if given.bed_rolling is not None and task not in BEDS:
        raise SystemExit(f"--bed-rolling: there is no bed in {task}, only in {' and '.join(BEDS)}.")
    if given.smooth_bed and task not in BEDS:
        raise SystemExit(f"--smooth-bed: there is no bed in {task}, only in {' and '.join(BEDS)}.")
    if given.starts is not None and task != "ScratchItch":
        raise SystemExit(f"--starts: written for ScratchItch, not for {task}.")
    act, about = load_actor(given.policy)
    if given.smooth_bed:
        import smooth_bed

        smooth_bed.install()
    env, found = make_env(task, robot), []
    memory = about.get("changes", {}).get("memory", [])
    for seed in range(given.seed, given.seed + given.num_episodes):
        began = time.time()
        found.append(run_episode(env, act, task, robot, seed, given.bed_rolling, memory))
        won, last = sum(x.success for x in found), found[-1]
        print(
            f"seed {seed}: {'success' if last.success else 'failure'}, return {last.total:.1f}, force up to "
            f"{last.forces[1]:.1f} N, {time.time() - began:.0f} s; {won} of {len(found)}",
            flush=True,
        )
    if given.starts:
        write_starts(given.starts, given.seed, found)
    if given.json:
        line = {
            "kind": "in-assistive-gym", "env": given.env_name, "commit": about.get("commit"),
            "device": {"kind": "CPU"},
            "episodes": len(found), "successes": sum(x.success for x in found), "first_seed": given.seed,
            "return": float(np.mean([x.total for x in found])),
            "force": float(np.mean([x.forces[0] for x in found])),
            "time": datetime.now(UTC).isoformat(timespec="seconds"),
        }  # fmt: skip
        changed = {"bed_rolling": given.bed_rolling, "smooth_bed": given.smooth_bed or None, "memory": memory or None}  # fmt: skip
        if changes := {name: x for name, x in changed.items() if x is not None}:
            line["changes"] = changes
        with given.json.open("a") as file:
            file.write(json.dumps(line) + "\n")


if __name__ == "__main__":
    main()
