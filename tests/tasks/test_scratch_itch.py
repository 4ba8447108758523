# ruff: noqa: D103
"""ScratchItch by hand: reference tasks.md section 2 and humans.md section 9, without physics."""

from __future__ import annotations

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from agym_jax.human import anthropometry
from agym_jax.math3d import rotation_matrix
from agym_jax.preferences import preference_terms
from agym_jax.sense import Sensed, ToolSensed
from agym_jax.spec import Preferences
from agym_jax.tasks.scratch_itch import SCRATCH_ITCH as TASK
from agym_jax.tasks.scratch_itch import ItchState

MAN = anthropometry.dims(0.0)
UPPER, FORE = (0.279, 0.043), (0.257, 0.033)  # length, radius of a man [m], humans.md section 3
SHOULDER, ELBOW = np.array([-0.179, 0.03, 1.0315]), np.array([-0.3185, 0.03, 0.7899])
TURN = rotation_matrix(np.array([0.8, 0.36, -0.48, 0.0]), np)
LINKS = {
    "chest": np.array([0, 0.03, 0.89]), "right_upper_arm": SHOULDER, "right_forearm": ELBOW,
    "right_hand": np.array([-0.3185, -0.26, 0.79]),
}  # fmt: skip
AIR = {
    "pos_w": np.array([-0.5, 0.0, 0.8]), "quat_w": np.array([1.0, 0, 0, 0]), "vel_w": np.zeros(3),
    "gap": 0.2, "touch_force": np.zeros(3), "touch_pos_w": np.zeros((3, 3)),
    "touch_working": np.array([1.0, 1.0, 0.0]), "on_human": 0.0, "force": 0.0,
}  # fmt: skip


def changed(nothing: dict[str, Any], changes: dict[str, Any]) -> dict[str, Any]:
    assert set(changes) <= set(nothing), set(changes) - set(nothing)
    return jax.tree.map(lambda v: jnp.asarray(v, jnp.float32), nothing | changes)


def sensed(
    tool: dict[str, Any] | None = None,
    links: dict[str, Any] | None = None,
    turns: dict[str, Any] | None = None,
    **changes: Any,
) -> Sensed:
    """A man at rest with the tool in the air, but for what is given."""
    quat = {k: np.array([1.0, 0, 0, 0]) for k in LINKS}
    rot = {k: np.eye(3) for k in LINKS} | {"right_forearm": TURN}
    rest = {
        "arm_angles": np.zeros(7), "torso_pos_w": np.array([-0.35, -0.3, 0.5]),
        "human_angles": np.zeros(10), "robot_on_human": 0.0,
    }  # fmt: skip
    return Sensed(
        tools=(ToolSensed(**changed(AIR, tool or {})),),
        link_pos_w=changed(LINKS, links or {}),
        link_rot_w=changed(rot, turns or {}),
        link_quat_w=changed(quat, {}),
        motion=None,
        dims=MAN,
        **changed(rest, changes),
    )


def itch(target: Any = (0.0, -0.033, -0.1), on_forearm: float = 1.0, **changes: Any) -> ItchState:
    values = {
        "on_forearm": on_forearm, "target_limb": target, "target_pos_w": np.zeros(3),
        "last_scratch_w": np.zeros(3), "scratches": 0.0, "force_at_target": 0.0,
    } | changes  # fmt: skip
    return ItchState(**{k: jnp.asarray(v, jnp.float32) for k, v in values.items()})


TARGET_W = ELBOW + TURN @ [0.0, -0.033, -0.1]  # of ``itch()`` on ``sensed()``


def touching(
    force: float, offset: Any = (0.0, 0.0, 0.0), tool: dict[str, Any] | None = None, **changes: Any
) -> Sensed:
    """The tool presses near the target, and nowhere else."""
    forces, places = np.zeros(3), np.zeros((3, 3))
    forces[1], places[1] = force, TARGET_W + np.asarray(offset)
    touch = {"touch_force": forces, "touch_pos_w": places, "on_human": force, "force": force}
    return sensed(touch | (tool or {}), **changes)


def test_the_handle_does_not_scratch():
    """AG counts contacts of two links of the scratcher, tip and rod."""
    forces, places = np.array([0.0, 0.0, 5.0]), np.tile(TARGET_W, (3, 1))
    for working, force in ((0.0, 0.0), (1.0, 5.0)):
        tool = {"touch_force": forces, "touch_pos_w": places}
        tool["touch_working"] = np.array([1.0, 1.0, working])
        state, events = TASK.advance(itch(), touching(5.0, tool=tool))
        assert float(state.force_at_target) == float(events["scratch"]) == force
        assert float(state.scratches) == working


def test_targets_lie_on_the_skin_of_either_limb():
    keys = jax.random.split(jax.random.PRNGKey(0), 2000)
    s = jax.device_get(jax.vmap(lambda k: TASK.init(k, sensed()))(keys))
    assert abs(s.on_forearm.mean() - 0.5) < 0.045  # four standard deviations
    for fore, (length, radius) in ((0, UPPER), (1, FORE)):
        local = s.target_limb[s.on_forearm == fore]
        np.testing.assert_allclose(np.hypot(local[:, 0], local[:, 1]), radius, rtol=1e-5)
        along = -local[:, 2]
        # tasks.md: s ~ U(r, L), theta ~ U(0, 2 pi)
        assert radius <= along.min() < radius + 0.005 and length - 0.005 < along.max() <= length
        assert abs(along.mean() - (radius + length) / 2) < 0.01
        around = np.arctan2(local[:, 0], local[:, 1])
        assert np.abs(np.exp(1j * around).mean()) < 4 / np.sqrt(len(around))
    assert (s.scratches == 0).all() and (s.last_scratch_w == 0).all()


@pytest.mark.parametrize("fore", [0.0, 1.0])
def test_target_moves_with_its_limb_and_not_with_the_other(fore: float):
    start = itch(on_forearm=fore)
    turn, shift = rotation_matrix(np.array([0.6, 0.0, 0.8, 0.0]), np), np.array([0.1, -0.2, 0.3])
    limbs = ["right_upper_arm", "right_forearm"]
    mine, other = reversed(limbs) if fore else limbs
    old = LINKS[mine]
    moved = sensed(links={mine: old + shift}, turns={mine: turn})
    state, _ = TASK.advance(start, moved)
    expected = old + shift + turn @ [0.0, -0.033, -0.1]
    np.testing.assert_allclose(state.target_pos_w, expected, atol=1e-6)
    before, _ = TASK.advance(start, sensed())
    aside, _ = TASK.advance(start, sensed(links={other: np.zeros(3)}))
    np.testing.assert_array_equal(before.target_pos_w, aside.target_pos_w)


def test_target_of_init_is_where_advance_keeps_it():
    state = TASK.init(jax.random.PRNGKey(3), sensed())
    after, _ = TASK.advance(state, sensed())
    np.testing.assert_allclose(state.target_pos_w, after.target_pos_w, atol=1e-6)


@pytest.mark.parametrize(
    ("force", "offset", "counts"),
    [
        (4.0, (0, 0, 0), True),
        (4.0, (0.0245, 0, 0), True),  # 25 mm, scratch_itch.py get_total_force
        (4.0, (0.0255, 0, 0), False),
        (0.0, (0, 0, 0), False),
        (9.9, (0, 0, 0), True),  # 10 N, scratch_itch.py step
        (10.1, (0, 0, 0), False),
    ],
)
def test_what_counts_as_a_scratch(force: float, offset: tuple, counts: bool):
    state, events = TASK.advance(itch(), touching(force, offset))
    assert float(state.scratches) == counts
    np.testing.assert_allclose(events["scratch"], force if counts else 0.0, rtol=1e-6)
    inside = np.linalg.norm(offset) < 0.025
    np.testing.assert_allclose(state.force_at_target, force if inside else 0.0, rtol=1e-6)
    expected = TARGET_W + offset if counts else np.zeros(3)
    np.testing.assert_allclose(state.last_scratch_w, expected, atol=1e-6)


def test_stroke_is_measured_from_the_last_scratch_that_counted():
    # 10 mm, scratch_itch.py step: steps of 6 mm count every other time
    state, counts = itch(), []
    for i in range(5):
        state, events = TASK.advance(state, touching(2.0, (0.0, 0.0, 0.006 * (i - 2))))
        counts.append(float(events["scratch"]) > 0)
    assert counts == [True, False, True, False, True]
    assert float(state.scratches) == 3


def test_pressing_without_moving_counts_once():
    state = itch()
    for _ in range(10):
        state, _ = TASK.advance(state, touching(2.0))
    assert float(state.scratches) == 1


def test_forces_near_the_target_add_up_and_may_be_too_much_together():
    places = np.stack(
        [TARGET_W, TARGET_W + np.array([0, 0, 0.02]), TARGET_W + np.array([0, 0, 0.1])]
    )
    state, events = TASK.advance(
        itch(), sensed({"touch_force": np.array([3.0, 4.0, 50.0]), "touch_pos_w": places})
    )
    np.testing.assert_allclose(state.force_at_target, 7.0, rtol=1e-6)
    np.testing.assert_allclose(events["scratch"], 7.0, rtol=1e-6)
    _, events = TASK.advance(
        itch(), sensed({"touch_force": np.array([6.0, 6.0, 0.0]), "touch_pos_w": places})
    )
    assert float(events["scratch"]) == 0.0


def test_success_at_25_scratches():
    assert not TASK.success(itch(scratches=24.0))
    assert TASK.success(itch(scratches=25.0))
    state = itch(scratches=24.0)
    state, _ = TASK.advance(state, touching(2.0))
    assert TASK.success(state)


def test_reward_is_assistive_gyms():
    """R = -|target - tip| - 0.01 |a|^2 + 0.01 F_target + 2 r_scratch + r_pref."""
    tip = TARGET_W + np.array([0.03, 0.0, 0.04])  # 50 mm away
    tool = {"pos_w": tip, "vel_w": np.array([0.0, 0.3, 0.4]), "on_human": 8.0}
    seen = touching(6.0, tool=tool, robot_on_human=5.0)
    action = jnp.array([0.5, -0.5, 0.5, -0.5, 0.0, 0.0, 1.0])
    state, events = TASK.advance(itch(), seen)
    terms = TASK.rewards(state, events, seen, action)
    expected = {
        "distance": -1.0 * 0.05,
        "action": -0.01 * 2.0,
        "tool_force": 0.01 * 6.0,
        "scratch": 2.0 * 6.0,
        "preference_velocity": -0.25 * 0.5,  # config.ini human_preferences
        "preference_force_nontarget": -0.01 * (8.0 + 5.0 - 6.0),
        "preference_high_forces": 0.0,
    }
    assert set(terms) == set(expected)
    for name, value in expected.items():
        np.testing.assert_allclose(terms[name], value, rtol=1e-5, atol=1e-6, err_msg=name)


@pytest.mark.parametrize(("force", "high"), [(9.9, 0.0), (10.0, -0.5), (30.0, -1.5)])
def test_preferences(force: float, high: float):
    # humans.md section 9: 0.05 x the force at the target from 10 N on
    terms = preference_terms(Preferences(), *(jnp.float32(x) for x in (0.2, force + 3.0, force)))
    np.testing.assert_allclose(terms["preference_velocity"], -0.05, rtol=1e-5)
    np.testing.assert_allclose(terms["preference_force_nontarget"], -0.03, rtol=1e-4)
    np.testing.assert_allclose(terms["preference_high_forces"], high, rtol=1e-5)


def test_observations_are_differences_along_world_axes():
    rng = np.random.default_rng(0)
    shift = np.array([0.3, -1.0, 2.0])
    links = {k: rng.normal(size=3) for k in LINKS}
    tip, torso = rng.normal(size=(2, 3))

    def seen(by: np.ndarray) -> Sensed:
        tool = {"pos_w": tip + by, "force": 3.0, "on_human": 2.0}
        moved = {k: v + by for k, v in links.items()}
        return sensed(tool, moved, torso_pos_w=torso + by, robot_on_human=0.5)

    def visuals(by: np.ndarray) -> Any:
        state, _ = TASK.advance(itch(), seen(by))
        state = dataclasses.replace(state, force_at_target=jnp.float32(1.5))
        return state, TASK.observe(state, seen(by))

    state, (robot, human) = visuals(np.zeros(3))
    chest, elbow, wrist = (links[k] for k in ("chest", "right_forearm", "right_hand"))
    for found, expected in (
        (robot.tool_pos_torso, tip - torso),
        (robot.tool_pos_target, tip - state.target_pos_w),
        (robot.assisted_arm.shoulder_pos_torso, links["right_upper_arm"] - torso),
        (robot.assisted_arm.wrist_pos_torso, wrist - torso),
        (human.assisted_arm.elbow_pos_human, elbow - chest),
        (human.target_pos_human, state.target_pos_w - chest),
        (robot.tool_force, 3.0),
        (human.force_on_human, 2.5),
        (human.force_at_target, 1.5),
    ):
        np.testing.assert_allclose(found, expected, atol=1e-6)
    # moving everything together changes nothing
    same = lambda a, b: np.testing.assert_allclose(a, b, atol=1e-5)  # noqa: E731
    jax.tree.map(same, (robot, human), visuals(shift)[1])


@pytest.mark.parametrize(
    ("robot", "x"), [("Jaco", -0.5), ("PR2", -0.55), ("Baxter", -0.55), ("Sawyer", -0.55)]
)
def test_start_positions_fill_the_references_box(robot: str, x: float):
    # tasks.md section 2: (-0.5 or -0.55, 0, 0.8) + U(-0.05, 0.05)^3
    keys = jax.random.split(jax.random.PRNGKey(0), 2000)
    p = np.asarray(jax.vmap(lambda k: TASK.start(k, robot))(keys))
    assert p.shape == (2000, 1, 3)  # one hand
    share = (p[:, 0] - [x, 0.0, 0.8]) / 0.05
    assert (np.abs(share) <= 1 + 1e-5).all()
    assert (share.max(0) > 0.99).all() and (share.min(0) < -0.99).all()


def test_marker_is_the_target():
    state, _ = TASK.advance(itch(), sensed())
    ((pos, radius, colour),) = TASK.markers(state)
    np.testing.assert_array_equal(pos, state.target_pos_w)
    assert radius == 0.01 and len(colour) == 4


def test_value_functions_see_the_last_scratch_from_the_itch_their_number_and_the_force():
    state, _ = TASK.advance(itch(), touching(50.0))  # too hard to count
    np.testing.assert_allclose(TASK.privileged_obs(state), [0.0, 0.0, 0.0, 0.0, 50.0], rtol=1e-6)
    state, _ = TASK.advance(state, touching(3.0, (0.0, 0.01, 0.002)))
    seen = np.asarray(TASK.privileged_obs(state))
    assert seen.shape == (TASK.privileged_obs_size,)
    np.testing.assert_allclose(seen, [0.0, 0.01, 0.002, 1.0, 3.0], atol=1e-6)
