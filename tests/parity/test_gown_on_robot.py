# ruff: noqa: D103
"""Where Assistive Gym's gown touched the robots, against the distances and frames of their shapes here."""

from __future__ import annotations

import numpy as np
import pytest

from agym_jax.matter.cloth.grid import MARGIN
from benchmarks.parity.robot_arm import contacts
from benchmarks.parity.row import traces

pytestmark = pytest.mark.parity


def test_the_recorded_gown_lies_at_the_margin_of_the_shapes_and_not_elsewhere():
    def near_margin(shift: float) -> float:
        off = contacts("Jaco", shift)[0] - MARGIN
        return float(np.mean((off > -0.005) & (off < 0.001)))

    assert near_margin(0.0) > 0.4  # others lie on the person, or fall into what they touch
    assert max(near_margin(0.05), near_margin(-0.05)) < 0.06


@pytest.mark.parametrize(
    ("robot", "all_contacts", "on_arm", "on_hand"),
    [("Jaco", 1929, 733, 280), ("PR2", 1799, 0, 165), ("Baxter", 1819, 0, 229), ("Sawyer", 2417, 0, 66)],
)  # fmt: skip
def test_the_gown_lies_on_jacos_arm_and_on_the_hands_of_the_others(
    robot: str, all_contacts: int, on_arm: int, on_hand: int
):
    distance, link = contacts(robot)
    touched = link[distance < MARGIN + 0.001]
    hand = len(traces("robot_arm")[f"{robot}_links"]) - 1  # the last link, with what is fixed to it
    found = len(distance), np.sum(touched != hand), np.sum(touched == hand)
    assert found == (all_contacts, on_arm, on_hand)
