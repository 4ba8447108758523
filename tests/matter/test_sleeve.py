# ruff: noqa: D103
"""The sleeve test by hand: reference tasks.md section 6."""

from __future__ import annotations

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

from agym_jax.matter.cloth.garment import load
from agym_jax.matter.cloth.sleeve import (
    SleeveArm,
    SleeveState,
    crossed,
    dressing_distance,
    progress,
    sleeve_state,
    surrounds,
    watched_vertices,
)  # fmt: skip

# AG's man: humans.md section 5
MAN = SleeveArm(*(jnp.array(x) for x in ([0.179, 0.03, 1.0315], [0.4538, 0.03, 0.9831], [0.4538, -0.26, 0.9831])),
          radius=jnp.float32(0.043))  # fmt: skip
NO, YES = jnp.bool_(False), jnp.bool_(True)


def loop(centre, along, radius=0.06):
    """Two interleaved triangles across a direction (2, 3, 3)."""
    along = np.asarray(along, float) / np.linalg.norm(along)
    side = np.cross(along, [0.3, 0.5, 0.81])
    side /= np.linalg.norm(side)
    angle = 2 * np.pi * np.array([[0, 8, 16], [21, 4, 12]]) / 26
    other = np.cross(along, side)
    ring = np.cos(angle)[..., None] * side + np.sin(angle)[..., None] * other
    return jnp.asarray(np.asarray(centre) + radius * ring, jnp.float32)


def on_forearm(share: float, radius: float = 0.06):
    hand, elbow = np.asarray(MAN.hand_end_w), np.asarray(MAN.elbow_w)
    return loop(hand + share * (elbow - hand), elbow - hand, radius)


def on_upper(share: float):
    elbow, shoulder = np.asarray(MAN.elbow_w), np.asarray(MAN.shoulder_w)
    return loop(elbow + share * (shoulder - elbow), shoulder - elbow)


def test_arm_lengths_match_assistive_gym():
    np.testing.assert_allclose(MAN.forearm_length, 0.419, atol=5e-4)
    np.testing.assert_allclose(MAN.upper_length, 0.279, atol=5e-4)
    np.testing.assert_allclose(MAN.hand_end_w, [0.4538, -0.346, 0.9831], atol=1e-4)


@pytest.mark.parametrize(
    ("start", "end", "hit"),
    [((0.2, 0.2, -1), (0.2, 0.2, 1), True), ((0.2, 0.2, 1), (0.2, 0.2, -1), True),
     ((0.2, 0.2, -2), (0.2, 0.2, -1), False), ((0.9, 0.9, -1), (0.9, 0.9, 1), False),
     ((-0.1, 0.2, -1), (-0.1, 0.2, 1), False)],
)  # fmt: skip
def test_crossed_detects_segments_through_triangles(start, end, hit):
    triangle = jnp.array([[[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]])
    assert bool(crossed(jnp.array(start, float), jnp.array(end, float), triangle)[0]) == hit


def test_watched_vertices_span_the_cuff():
    gown = load()
    ids = watched_vertices(gown)
    assert ids.shape == (2, 3) and len(set(ids.ravel().tolist())) == 6
    assert set(ids.ravel().tolist()) <= set(gown.cuff.tolist())
    for triangle in gown.vertices[ids]:  # each spans the cuff
        centre = gown.vertices[gown.cuff].mean(0)
        assert np.linalg.norm(triangle.mean(0) - centre) < 0.3 * np.linalg.norm(
            triangle[0] - centre
        )


def test_sleeve_state_names_the_segment():
    fore, upper = sleeve_state(on_forearm(0.5), MAN), sleeve_state(on_upper(0.5), MAN)
    assert fore.forearm and not fore.upper_arm
    assert upper.upper_arm and not upper.forearm
    before = sleeve_state(on_forearm(-0.3), MAN)
    beside = sleeve_state(on_forearm(0.5) + jnp.array([0.2, 0.0, 0.0]), MAN)
    for nothing in (before, beside):
        assert not nothing.forearm and not nothing.upper_arm


def test_surrounds_needs_points_on_both_sides():
    points = on_forearm(0.5)
    assert surrounds(points, MAN.hand_end_w, MAN.elbow_end_w)
    assert not surrounds(points + jnp.array([0.0, 0.0, 0.061]), MAN.hand_end_w, MAN.elbow_end_w)


def test_sleeve_state_is_remembered_for_half_a_second():
    off, was = sleeve_state(on_forearm(-0.3), MAN), SleeveState(YES, NO)
    for look in range(8):
        was = off.after(was)
        assert bool(was.forearm) == (look < 5) and not was.upper_arm
    again = sleeve_state(on_forearm(0.5), MAN).after(was)
    assert again.forearm and again.steps_off == 0


def test_present_segment_replaces_the_remembered_one():
    # back from the upper arm: AG would go on paying for the upper arm, the more the farther back
    back = sleeve_state(on_forearm(0.5), MAN).after(SleeveState(NO, YES))
    assert back.forearm and not back.upper_arm


def test_dressing_distance_equals_assistive_gyms_r_dress():
    nothing, fore, both = SleeveState(NO, NO), SleeveState(YES, NO), SleeveState(YES, YES)
    way = MAN.forearm_length - 0.043  # from the tip of the hand to the elbow
    np.testing.assert_allclose(dressing_distance(on_forearm(0.5), MAN, fore), 0.5 * way, rtol=1e-3)
    np.testing.assert_allclose(
        dressing_distance(on_forearm(0.5), MAN, nothing), -0.5 * way, rtol=1e-3
    )
    np.testing.assert_allclose(dressing_distance(on_forearm(1.5), MAN, fore), -1.5 * way, rtol=1e-3)
    at = dressing_distance(on_upper(0.5), MAN, both)
    np.testing.assert_allclose(at, MAN.forearm_length + 0.5 * MAN.upper_length, rtol=1e-3)
    beyond = dressing_distance(on_upper(1.2), MAN, both)
    np.testing.assert_allclose(beyond, MAN.forearm_length, rtol=1e-3)


def test_success_needs_the_upper_arm_for_the_woman():
    woman = replace(
        MAN, wrist_w=MAN.elbow_w + jnp.array([0.0, -0.261, 0.0]), radius=jnp.float32(0.0355)
    )
    assert woman.forearm_length < 0.4 < MAN.forearm_length


def test_progress_is_relative_to_the_arm_and_zero_off_it():
    fore = MAN.forearm_length - 0.043
    whole = fore + MAN.upper_length
    np.testing.assert_allclose(progress(on_forearm(0.5), MAN), 0.5 * fore / whole, atol=2e-3)
    np.testing.assert_allclose(
        progress(on_upper(0.5), MAN), 1 - 0.5 * MAN.upper_length / whole, atol=2e-3
    )
    assert progress(on_forearm(-0.3), MAN) == 0
