# ruff: noqa: D103
"""A held arm that a robot pushes, against Assistive Gym's. C MuJoCo, the recorded actions."""

from __future__ import annotations

import numpy as np
import pytest
from parity_rows import assert_rows_hold_or_name_a_deviation

from benchmarks.parity import pushed_arm

pytestmark = pytest.mark.jit


@pytest.fixture(scope="module")
def mine() -> pushed_arm.Paths:
    return pushed_arm.ours("ag")


@pytest.mark.slow
def test_rows_hold_or_name_a_deviation():
    assert_rows_hold_or_name_a_deviation(pushed_arm.rows())


def test_recorded_pushes_are_about_contact_and_can_be_repeated():
    ag = pushed_arm.recorded()
    assert (ag.force.max(1) > 4.0).all()
    for again in pushed_arm.itself():  # 1 mrad off at the start
        assert np.median(pushed_arm.apart(again, ag, 40)[0]) < 0.02


@pytest.mark.slow
def test_the_robot_goes_where_it_goes_in_assistive_gym(mine: pushed_arm.Paths):
    joints = {t: pushed_arm.apart(mine, pushed_arm.recorded(), t)[0] for t in (5, 10, 20)}
    assert np.median(joints[5]) < 0.02
    assert np.median(joints[10]) < pushed_arm.JOINTS_APART
    # with an arm that yields like a damper, and no fingers, it was 0.27
    assert np.median(joints[20]) < 0.12


@pytest.mark.slow
def test_the_arm_gives_way_as_in_assistive_gym(mine: pushed_arm.Paths):
    ag = pushed_arm.recorded()
    assert np.median(pushed_arm.apart(mine, ag, 20)[1]) < pushed_arm.WRIST_APART
    # with an arm that yields like a damper, and no fingers, it was 7 cm
    np.testing.assert_allclose(mine.force.mean(), ag.force.mean(), rtol=0.25)
