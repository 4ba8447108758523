# ruff: noqa: D103
"""How the gown hangs when an episode of Dressing begins."""

from __future__ import annotations

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from dress_scene import seen

from agym_jax.errors import SpecError
from agym_jax.matter.cloth.garment import GarmentError
from agym_jax.matter.cloth.hang import swung
from agym_jax.matter.cloth.sleeve import crossed
from agym_jax.matter.cloth.starts import load_starts
from agym_jax.tasks.dressing import BELOW_HAND, DRESSING, START, Config, arm_of

TASK = DRESSING


def test_it_begins_hanging_before_the_hand_and_dressing_nobody():
    state = TASK.init(jax.random.PRNGKey(0), seen())
    assert not state.on_arm.forearm and not state.on_arm.upper_arm
    assert -0.42 < float(state.dressed) < -0.05 and state.progress == 0 and not TASK.success(state)
    held = state.cloth.pos_w[TASK.spec.garment.anchors].mean(0)
    np.testing.assert_allclose(held, np.array(START) - [0, 0, BELOW_HAND], atol=1e-5)
    cuff = state.cloth.pos_w[TASK.watched].reshape(6, 3).mean(0)
    assert 0.1 < np.linalg.norm(cuff - arm_of(seen()).hand_end_w) < 0.4  # AG: 0.08 to 0.15


def test_it_begins_with_the_hand_in_the_mouth_of_the_gown():
    gown, arm = TASK.spec.garment, arm_of(seen())
    for key, off in enumerate(
        ([0, 0, 0], [0.05, 0.05, 0.05], [-0.05, 0.05, -0.05], [0.05, -0.05, 0.0])
    ):
        held = jnp.array(START) + jnp.array(off)
        state = TASK.init(jax.random.PRNGKey(key), seen(np.tile(held, (11, 1))))
        corners = state.cloth.pos_w[gown.triangles]
        assert not crossed(arm.hand_end_w, arm.elbow_w, corners).any()
        np.testing.assert_allclose(
            state.cloth.pos_w[gown.anchors].mean(0), held - jnp.array([0, 0, BELOW_HAND]), atol=1e-5
        )
        assert (
            0.15 < covered(np.asarray(arm.hand_end_w), np.asarray(corners)) < 0.65
        )  # AG: 0.28 to 0.52


def covered(point: np.ndarray, corners: np.ndarray) -> float:
    """Share of all directions in which triangles (t, 3, 3) lie, their sides counted against each other."""
    a, b, c = np.moveaxis(corners - point, 1, 0)
    u, v, w = (np.linalg.norm(x, axis=1) for x in (a, b, c))
    dot = lambda x, y: (x * y).sum(1)  # noqa: E731
    part = np.arctan2(
        dot(a, np.cross(b, c)), u * v * w + dot(a, b) * w + dot(b, c) * u + dot(c, a) * v
    )
    return abs(part.sum()) / (2 * np.pi)


def test_a_gown_is_swung_to_before_the_hand():
    held = jnp.array([0.0, 0.0, 1.0])
    hanging = jnp.array([[0.0, 0.0, 1.0], [0.0, -0.1, 0.8], [0.0, -0.1, 0.6]])
    far = jnp.array([0.0, 0.3, 0.8])
    np.testing.assert_allclose(swung(hanging, held, far, jnp.array([0.0, 0.1])), hanging, atol=1e-6)
    moved = swung(hanging, held, jnp.array([0.5, -0.1, 0.8]), jnp.array([0.04, 0.1])) - hanging
    np.testing.assert_allclose(moved[:, 0], [0.0, 0.04, 0.04], atol=1e-6)
    np.testing.assert_allclose(moved[:, 1], [0.0, -0.2, -0.2], atol=1e-6)


def test_a_share_of_the_episodes_begins_with_a_settled_gown():
    """It hangs as recorded: against the hand, its cuff a few centimetres before the tip, and hardly moves."""
    some, s = replace(TASK, config=Config(settled_gown=0.25)), seen()
    keys, tip = jax.random.split(jax.random.PRNGKey(0), 400), np.asarray(arm_of(s).hand_end_w)
    cuff = jax.jit(jax.vmap(lambda key: some.init(key, s).cloth.pos_w[TASK.watched].mean((0, 1))))
    before = tip[1] - np.asarray(cuff(keys))[:, 1]
    assert 0.19 < (before < 0.13).mean() < 0.31 and (before > 0.2).mean() > 0.69
    assert before.min() > 0.0
    with pytest.raises(SpecError, match=r"settled_gown is a share .* got -1"):
        Config(settled_gown=-1)
    with pytest.raises(SpecError, match=r"packaged gown, garments/gown.npz; got 0.25 with shirt"):
        _ = replace(some, garment="shirt.toml").starts


def test_a_settled_gown_hangs_still_in_front_of_the_hand():
    advance = jax.jit(TASK.advance)
    found = []
    for share in (1.0, 0.0):
        first = replace(TASK, config=Config(settled_gown=share)).init(jax.random.PRNGKey(0), seen())
        state = first
        for _ in range(10):
            state, _ = advance(state, seen())
        moved = (state.cloth.pos_w - first.cloth.pos_w)[TASK.watched].mean((0, 1))
        found.append((np.linalg.norm(moved), abs(state.dressed - first.dressed)))
        assert not state.on_arm.forearm
    settled, swung_back = found
    assert settled[0] < 0.08 and settled[1] < 0.06
    assert swung_back[0] > 0.15 and swung_back[1] > 0.1


def test_the_recorded_gown_of_the_nearest_hand_is_taken_and_lies_against_the_hand():
    starts, gripper = load_starts(TASK.spec.count), jnp.array([0.5, -0.3, 1.2])
    for row in (0, 7):
        hand = starts.hand[row]
        same = starts.nearest(gripper, gripper + hand) - gripper
        np.testing.assert_allclose(same, starts.vertices[row], atol=1e-6)
        moved = starts.nearest(gripper, gripper + hand + jnp.array([0.0, 0.002, 0.0])) - gripper
        low = starts.vertices[row][:, 2] < hand[2]
        by = np.asarray(moved - same)
        np.testing.assert_allclose(by[low], np.tile([0.0, 0.002, 0.0], (low.sum(), 1)), atol=1e-6)
        assert by[~low, 1].min() >= 0.0 and by[~low, 1].max() <= 0.002 + 1e-6
    with pytest.raises(GarmentError, match=r"vertices"):
        load_starts(12)
