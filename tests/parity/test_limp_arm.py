# ruff: noqa: D103
"""The limp arm, against arrays recorded in Assistive Gym."""

from __future__ import annotations

import numpy as np
import pytest
from parity_rows import assert_rows_hold_or_name_a_deviation

from agym_jax.human import body, muscles
from benchmarks.parity import limp_arm
from benchmarks.parity.row import traces


@pytest.fixture(scope="module")
def rows() -> dict:
    return {row.quantity: row for row in limp_arm.rows()}


def test_rows_hold_or_name_a_deviation(rows):
    assert_rows_hold_or_name_a_deviation(rows.values())


@pytest.mark.parametrize("sex", [0, 1])
def test_all_loads_are_ags_with_its_masses(sex: int):
    t, who = traces("limp_arm"), limp_arm.SEXES[sex]
    arm = limp_arm.person(sex)
    for q, torque in zip(t[f"{who}_hold_q"], t[f"{who}_hold_torque"], strict=True):
        np.testing.assert_allclose(arm.load(q), torque, atol=0.02)


@pytest.mark.parametrize("sex", [0, 1])
def test_mass_at_mid_limb_is_ours(sex: int):
    t, who = traces("limp_arm"), limp_arm.SEXES[sex]
    shoulder = body.RIGHT_ARM.index("r_shoulder_x")
    ours = limp_arm.person(sex, False).load(t[f"{who}_hold_q"][0])
    assert abs(ours[shoulder]) == pytest.approx(abs(t[f"{who}_hold_mid"][0, shoulder]), rel=0.02)


def test_man_s_arm_swings_as_ags_until_it_meets_the_bed():
    before, _, rest = limp_arm.drops(0)
    assert np.median(before) < 0.01
    assert (before < 0.02).sum() >= 9  # of twelve
    assert np.median(rest) < 0.03


@pytest.mark.parametrize("sex", [0, 1])
@pytest.mark.parametrize("at_joints", [True, False])
def test_arm_rests_where_ags_does(sex: int, at_joints: bool):
    ours, ag = limp_arm.resting(sex, at_joints)
    across = (ours - ag)[..., [0, 2]].mean(0)
    np.testing.assert_allclose(across, 0.0, atol=0.02)
    # lengthwise AG's arm creeps on: deviation bed-contact
    assert np.abs((ours - ag)[..., 1].mean(0)).max() < 0.09


def test_a_joint_beyond_its_limit_is_put_back_and_the_rest_slows_down():
    from agym_jax.human.muscles import as_bullet

    limits, h = np.array([[-1.0, 1.0], [-1.0, 1.0]]), 0.02
    before, drag = np.array([2.0, 1.0]), lambda v: v * (1.0 - h * 0.04 * (1.0 + abs(v)))
    q, v = as_bullet(np.array([1.01, 0.0]), before, np.eye(2), limits, h, np)
    np.testing.assert_allclose(q, [1.0, 0.0])  # no farther than the limit in this step
    np.testing.assert_allclose(v, drag(np.array([2.0 - 0.01 / h, 1.0])))
    # the impulse that stops one joint moves what hangs on it: the momentum of the other stays
    inertia = np.array([[2.0, 0.5], [0.5, 1.0]])
    q, v = as_bullet(np.array([1.01, 0.0]), before, inertia, limits, h, np)
    change = np.linalg.solve(inertia, np.array([1.0, 0.0]))
    change *= -0.01 / h / change[0]
    np.testing.assert_allclose(v, drag(before + change))
    np.testing.assert_allclose(q, [1.0, h * change[1]])
    # nothing at a limit: nothing stops
    _, free = as_bullet(np.zeros(2), before, inertia, limits, h, np)
    np.testing.assert_allclose(free, drag(before))


@pytest.mark.parametrize("factor", [0.5, 2.0])
@pytest.mark.parametrize("sex", [0, 1])
def test_tissue_damping_decides_centimetres_of_a_drop(sex: int, factor: float, monkeypatch):
    """The figure of the deviation: until the bed is met, the wrist is where another model's damping leaves it."""
    t, who = traces("limp_arm"), limp_arm.SEXES[sex]
    paths = []
    for damping in (muscles.TISSUE_DAMPING, factor * muscles.TISSUE_DAMPING):
        monkeypatch.setattr(muscles, "TISSUE_DAMPING", damping)
        arm = limp_arm.person(sex, False)
        paths.append([arm.released(q, steps=50)[:, limp_arm.WRIST] for q in t[f"{who}_bed_start"]])
    gaps = limp_arm.apart(*np.array(paths))
    most = [gap[: int(i)].max() for gap, i in zip(gaps, t[f"{who}_impact"], strict=True)]
    assert 0.005 < np.median(most) < 0.04
