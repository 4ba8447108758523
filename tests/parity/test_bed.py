# ruff: noqa: D103
"""The bed and who lies on it, against arrays recorded in Assistive Gym."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from parity_rows import assert_rows_hold_or_name_a_deviation

from agym_jax.data.assets import asset_path
from agym_jax.furniture import BED
from benchmarks.parity import bed


@pytest.fixture(scope="module")
def rows() -> dict:
    return {row.quantity: row for row in bed.rows()}


def test_rows_hold_or_name_a_deviation(rows):
    assert_rows_hold_or_name_a_deviation(rows.values())


def test_mattress_is_within_5_mm_where_arms_and_tools_go(rows):
    assert rows["mattress, 95 % of the points within"].holds
    assert rows["pillow's slope, root mean square"].holds


def test_robots_meet_the_pillow_within_5_mm(rows):
    assert rows["pillow and mattress beside the person, root mean square"].holds
    without = bed.surface("beside", BED.geoms)
    assert np.sqrt(np.mean(without**2)) == pytest.approx(0.022, abs=0.001), "what the outlines mend"


@pytest.mark.parametrize("task", ["BedBathing", "ArmManipulation"])
@pytest.mark.parametrize("who", ["men", "women"])
def test_chest_and_head_are_as_high_as_ags(rows, task: str, who: str):
    for link in ("chest", "head"):
        assert rows[f"{task}, {who}: height of the {link}, mean"].holds


def test_two_shapes_make_the_mattress_and_mjx_collides_both():
    model = mujoco.MjModel.from_xml_path(str(asset_path(BED.model)))
    kinds = {int(model.geom(g).type[0]) for g in (*BED.geoms, *BED.pillow)}
    assert (
        len(BED.geoms) == 2 and len(BED.pillow) == 1
    )  # each costs a pair with every limb and tool
    assert kinds <= {int(mujoco.mjtGeom.mjGEOM_BOX), int(mujoco.mjtGeom.mjGEOM_CAPSULE)}


def test_distance_is_that_of_the_surface():
    box = np.array([[-0.1, 0.0, 1.0]])
    far = bed.heights(box, BED.geoms)[0]
    assert far == pytest.approx(1.0 - 0.75, abs=0.01)
