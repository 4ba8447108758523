# ruff: noqa: D103
"""What can be reached, and what passes through: on real scenes, where the answer is known."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import agym_jax
from agym_jax.human.body import shapes_of
from agym_jax.offline import kinematics
from agym_jax.spec import Pose
from benchmarks import inside, physics_tables, reach


@pytest.fixture(scope="module")
def jaco() -> agym_jax.Env:
    return agym_jax.make("ReachingJaco-v0", impl="native")


def test_sawyers_narrow_hand_gets_to_every_mouth():
    found = reach.measure(reach.ReachConfig("ReachingSawyer-v0", num_targets=2))
    assert found["reachable"] == 1.0 and found["targets"] == 2
    assert set(found) - {"env", "targets", "starts", "reachable"} <= {
        "reachable_men",
        "reachable_women",
    }


def test_what_is_too_far_away_or_inside_the_person_cannot_be_reached(jaco):
    state = jaco.reset(jax.random.PRNGKey(0))
    place = state.episode.placement
    base = Pose(tuple(place.base_pos.tolist()), tuple(place.base_quat.tolist()))
    searcher = reach.Searcher(jaco, 40, np.random.default_rng(0))
    model, data = searcher.scene(0.0, base, np.asarray(state.episode.human_angles))

    def reached(point: np.ndarray) -> bool:
        points = np.tile(point, (searcher.starts, 1))
        return searcher.can_reach(model, data, base, place.arm_angles, points)

    assert reached(np.array([-0.15, -0.4, 1.0]))  # where episodes begin
    assert not reached(np.array([-0.15, -0.4, 3.0]))
    assert not reached(data.body("human/chest").xpos)


def test_only_some_tasks_have_targets(capsys):
    assert reach.main(["--env-name", "FeedingJaco-v0"]) == 2
    assert "in ScratchItch, Reaching, Drinking, not in Feeding" in capsys.readouterr().err


def test_a_cup_that_pours_lies_on_its_side_in_any_direction():
    turns = reach.tipped_cups(500, np.random.default_rng(0))
    tilt = np.arccos(turns[:, 2, 1])
    assert reach.TIPPED[0] <= tilt.min() and tilt.max() <= reach.TIPPED[1]
    for across in (turns[:, :2, 1], turns[:, :2, 0]):  # where it pours to, and how it is turned
        assert np.ptp(np.arctan2(*across.T)) > 6.0
    assert np.allclose(turns @ turns.transpose(0, 2, 1), np.eye(3), atol=1e-9)


@pytest.mark.slow
def test_a_hand_turns_a_cup_only_where_the_arm_reaches():
    env = agym_jax.make("DrinkingSawyer-v0", impl="native")
    searcher = reach.Searcher(env, 60, np.random.default_rng(0))
    poured = [reach.pour(searcher)[0] for _ in range(3)]
    assert sum(poured) >= 2  # 99 % of the mouths, with more starts
    state = env.reset(jax.random.PRNGKey(0))
    place, cup = state.episode.placement, env.scene.index.tools[0].tip
    base = Pose(tuple(place.base_pos.tolist()), tuple(place.base_quat.tolist()))
    model, data = searcher.scene(0.0, base, np.asarray(state.episode.human_angles))
    pos = np.asarray(state.data.site_xpos[cup])
    turn = np.asarray(state.data.xmat[env.scene.model.site_bodyid[cup]]).reshape(3, 3)

    def held(pos: np.ndarray, turn: np.ndarray = turn) -> bool:
        points, turns = np.tile(pos, (60, 1)), np.tile(turn, (60, 1, 1))
        return searcher.can_reach(model, data, base, place.arm_angles, points, turns)

    def now() -> np.ndarray:
        angles = [data.joint(f"robot/{j}").qpos[0] for arm in env.scene.arms for j in arm.joints]
        return kinematics.forward(searcher.chain, jnp.asarray(angles))[1]

    assert held(pos)
    tipped = np.array(Rotation.from_rotvec([0.3, 0.0, 0.0]).as_matrix()) @ turn
    assert held(pos, tipped)
    base_turn = Rotation.from_quat(base.quat, scalar_first=True).as_matrix()
    assert np.abs(base_turn @ now() - tipped).max() < 2 * reach.TURNED  # not as it was
    assert not held(pos + np.array([0.0, 0.0, 2.0]))


def test_no_link_of_the_arm_passes_through_a_limb_of_the_task(jaco):
    state = jaco.reset(jax.random.PRNGKey(0))
    solid = inside.Solid(jaco, state.episode)
    qpos = np.asarray(state.data.qpos)
    assert not list(solid.passing(qpos))
    links = {f"robot/{x}" for arm in jaco.scene.arms for x in arm.links}
    limbs = {f"human/{x}" for x in shapes_of(jaco.task.human.limbs)}
    rng, arm = np.random.default_rng(0), jaco.scene.model.jnt_range[jaco.scene.index.robot_joint]
    found, touched = {}, set()
    for angles in rng.uniform(*np.clip(arm, -np.pi, np.pi).T, (1500, len(arm))):
        qpos[jaco.scene.index.robot_qpos] = angles
        found |= {(part, limb): depth for part, limb, depth in solid.passing(qpos)}
        touched |= {frozenset(solid.names[i] for i in pair) for pair in solid.data.contact.geom}
    assert not [pair for pair in found if pair[0] in links and pair[1] in limbs]
    fingers = {f"robot/finger_{i}_collision" for i in (1, 2, 3)}
    assert any(pair & fingers and "human/head" in pair for pair in touched)  # it was where it could
    assert any(part == "robot/link_3_collision" for part, _ in found)  # which is no link of the arm
    assert min(found.values()) > inside.DEEPEST


def test_an_unknown_policy_is_refused(capsys):
    assert inside.main(["--only", "ReachingJako"]) == 2
    assert "Did you mean 'ReachingJaco-v0'" in capsys.readouterr().err


def test_the_tables_keep_itches_and_mouths_apart():
    itches, mouths = physics_tables.reach(), physics_tables.reach_mouth()
    assert "ScratchItchJaco-v0" in itches and "Reaching" not in itches
    assert "ReachingJaco-v0" in mouths and "ScratchItch" not in mouths
