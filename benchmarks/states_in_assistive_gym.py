"""States of episodes that a policy of agym_jax plays in Assistive Gym itself, for ``benchmarks.played_on``.

    python benchmarks/states_in_assistive_gym.py BedBathingPR2-v0 POLICY STATES.npz --num-episodes 10 --seed 7000

Run it as ``benchmarks/in_assistive_gym.py``, in BedBathing or ArmManipulation. The file has, of n episodes of T control steps:
``kinds``, see ``KINDS`` (4,); ``seed``, ``success``, ``sex``, ``limit_scale``, ``strength`` (n,), ``tremor`` (n, 10); ``base`` and ``chest``, poses in the world as
position [m] and quaternion wxyz (n, 7); ``body``, all angles of the person at the start [rad] (n, 41); ``obs``, as the policy sees the
start (n, n_obs); at the start and after every control step, ``q``, ``qd`` of the robot's arms (n, T + 1, n_arm), ``person_q``, ``person_qd`` of
the person's right arm (n, T + 1, 10) [rad, rad/s], and ``force``, normal forces by ``kinds`` [N] (n, T + 1, 4); ``action`` (n, T, n_arm).
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import in_assistive_gym as ag
import numpy as np

KINDS = ("tool on seat", "robot on seat", "tool on person", "robot on person")
"""What touches what; in ArmManipulation, tools are links of the robot."""
TOOLS = {"pr2": (78, 55), "sawyer": (24,), "baxter": (54, 31), "jaco": (9,)}
"""Those links."""
ARM = range(10)  # the joints of the person's right arm
FIXED = 4  # Bullet's type of a joint that does not move


class Recorder:
    """One episode.

    Args:
        env: Assistive Gym's, after its reset.
        task: of the environment.
        robot: of the environment, in lower case.
        seed: of the episode.
    """

    def __init__(self, env: Any, task: str, robot: str, seed: int) -> None:
        import pybullet

        self.bullet, self.env, self.options = pybullet, env, {"physicsClientId": env.id}
        both = task == "ArmManipulation" and len(TOOLS[robot]) == 2
        self.arms = env.robot_both_arm_joint_indices if both else env.robot_left_arm_joint_indices
        self.tool_links = TOOLS[robot] if task == "ArmManipulation" else ()
        world, joints = env.world_creation, range(pybullet.getNumJoints(env.human, **self.options))
        moves = [j for j in joints if self._info(j)[2] != FIXED]
        tremor = np.zeros(len(ARM))
        if world.human_impairment == "tremor":  # of joints that are driven; in BedBathing none
            tremor[: len(world.human_tremors)] = world.human_tremors
        self.start = {
            "seed": seed, "sex": float(env.gender == "female"), "limit_scale": world.human_limit_scale,
            "strength": world.human_strength, "tremor": tremor,
            "base": self._pose(env.robot), "chest": self._pose(env.human), "body": self._joints(env.human, moves)[0],
        }  # fmt: skip
        self.steps: list[dict[str, np.ndarray]] = []

    def _info(self, joint: int) -> Any:
        return self.bullet.getJointInfo(self.env.human, joint, **self.options)

    def _pose(self, body: int) -> np.ndarray:
        """Of a body's base, not of its centre of mass, wxyz (7,)."""
        inertial = self.bullet.getDynamicsInfo(body, -1, **self.options)[3:5]
        at = self.bullet.getBasePositionAndOrientation(body, **self.options)
        pos, quat = self.bullet.multiplyTransforms(*at, *self.bullet.invertTransform(*inertial))
        return np.concatenate([pos, np.roll(quat, 1)])

    def _joints(self, body: int, joints: Any) -> tuple[np.ndarray, np.ndarray]:
        """Angles and speeds."""
        states = self.bullet.getJointStates(body, jointIndices=list(joints), **self.options)
        return np.array([x[0] for x in states]), np.array([x[1] for x in states])

    def forces(self) -> np.ndarray:
        """Normal forces, by ``KINDS`` (4,)."""
        env, found = self.env, dict.fromkeys(KINDS, 0.0)
        bodies = [("robot", env.robot)] + ([] if self.tool_links else [("tool", env.tool)])
        for mine, body in bodies:
            for other, on in (("seat", env.bed), ("person", env.human)):
                for contact in self.bullet.getContactPoints(bodyA=body, bodyB=on, **self.options):
                    what = "tool" if contact[3] in self.tool_links else mine
                    found[f"{what} on {other}"] += contact[9]
        return np.array([found[kind] for kind in KINDS])

    def add(self) -> None:
        """Record the present state."""
        q, qd = self._joints(self.env.robot, self.arms)
        person_q, person_qd = self._joints(self.env.human, ARM)
        self.steps.append({"q": q, "qd": qd, "person_q": person_q, "person_qd": person_qd, "force": self.forces()})  # fmt: skip


def record(env: Any, act: ag.Act, task: str, robot: str, seed: int) -> dict[str, Any]:
    """Play an episode; what the file has of it.

    Args:
        env: from ``in_assistive_gym.make_env``.
        act: from ``in_assistive_gym.load_actor``.
        task: of the environment.
        robot: of the environment, in lower case.
        seed: of the episode.
    """
    obs = ag.reset(env, seed)
    translate, recorder = ag.Translator(task, robot, obs), Recorder(env, task, robot, seed)
    first, actions, info = translate(obs), [], {}
    recorder.add()
    twice = task == "ArmManipulation" and len(TOOLS[robot]) == 1  # it takes their action twice
    for _ in range(ag.EPISODE_LENGTH):
        actions.append(act(translate(obs)))
        obs, _, _, info = env.step(np.tile(actions[-1], 2) if twice else actions[-1].copy())
        recorder.add()
    steps = {name: np.array([x[name] for x in recorder.steps]) for name in recorder.steps[0]}
    ends = {"success": bool(info["task_success"]), "obs": first, "action": np.array(actions)}
    return recorder.start | steps | ends


def main() -> None:
    """Record episodes; the file is written after each."""
    flags = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    flags.add_argument("env_name")
    flags.add_argument("policy", type=Path)
    flags.add_argument("states", type=Path)
    flags.add_argument("--num-episodes", type=int, default=10)
    flags.add_argument("--seed", type=int, default=7000)
    flags.add_argument(
        "--smooth-bed", action="store_true", help="as that of benchmarks/in_assistive_gym.py"
    )
    given = flags.parse_args()
    task, robot = ag.parse(given.env_name)
    if task not in ag.BEDS:
        raise SystemExit(f"{given.env_name}: states are recorded in {' and '.join(ag.BEDS)} alone.")
    if not given.states.absolute().parent.is_dir():
        raise SystemExit(f"{given.states}: there is no such folder.")
    act, _ = ag.load_actor(given.policy)
    if given.smooth_bed:
        import smooth_bed

        smooth_bed.install()
    env, found = ag.make_env(task, robot), []
    for seed in range(given.seed, given.seed + given.num_episodes):
        found.append(record(env, act, task, robot, seed))
        columns: dict[str, Any] = {k: np.array([x[k] for x in found]) for k in found[0]}
        np.savez_compressed(given.states, kinds=KINDS, **columns)
        print(f"seed {seed}: {'success' if found[-1]['success'] else 'failure'}", flush=True)


if __name__ == "__main__":
    main()
