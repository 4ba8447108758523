# ruff: noqa: D103
"""What can be reached, and what passes through: on real scenes, where the answer is known."""

from __future__ import annotations

import jax
import numpy as np
import pytest

import agym_jax
from agym_jax.human.body import shapes_of
from agym_jax.spec import Pose
from benchmarks import inside, physics_tables, reach


@pytest.fixture(scope="module")
def jaco() -> agym_jax.Env:
    return agym_jax.make("ReachingJaco-v0", impl="native")


def test_sawyers_narrow_hand_gets_to_every_mouth():
    found = reach.measure(reach.ReachConfig("ReachingSawyer-v0", num_targets=2))
    assert found["reachable"] == 1.0 and found["targets"] == 2
    assert set(found) - {"env", "targets", "reachable"} <= {"reachable_men", "reachable_women"}


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


def test_only_two_tasks_have_targets(capsys):
    assert reach.main(["--env-name", "FeedingJaco-v0"]) == 2
    assert "in ScratchItch and Reaching, not in Feeding" in capsys.readouterr().err


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
