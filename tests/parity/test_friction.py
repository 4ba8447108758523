# ruff: noqa: D103
"""Friction is Assistive Gym's, in every model. C MuJoCo."""

from __future__ import annotations

import numpy as np
import pytest
from parity_rows import assert_rows_hold_or_name_a_deviation

from benchmarks.parity import friction


@pytest.fixture(scope="module")
def rows() -> dict[str, friction.Row]:
    return {row.quantity: row for row in friction.rows()}


def test_rows_hold_or_name_a_deviation(rows: dict[str, friction.Row]):
    assert_rows_hold_or_name_a_deviation(rows.values())


def test_every_kind_of_pair_is_compared(rows: dict[str, friction.Row]):
    kinds = {name.removeprefix("coefficient, ") for name in rows if name.startswith("coefficient")}
    beds = ("wheelchair", "mattress in BedBathing", "mattress in ArmManipulation")
    assert kinds == {"tool on person", "robot on person", "person on himself"} | {
        f"{what} on {seat}" for what in ("tool", "robot", "person") for seat in beds
    } | {
        f"{what} on {other}" for what in ("tool", "robot") for other in ("robot", "nightstand")
    } | {"person on nightstand"}
    assert rows["coefficient, tool on mattress in BedBathing"].ag == pytest.approx(2.5)
    assert all(rows[f"coefficient, {kind}"].holds for kind in kinds)


def test_sliding_tool_is_held_back_by_the_coefficient():
    slid = friction.sliding(0.25)
    np.testing.assert_allclose(slid.max(), 0.25, rtol=0.01)
    np.testing.assert_allclose(slid.min(), 0.25 / np.sqrt(2), rtol=0.01)  # MuJoCo's pyramid
    assert friction.sliding(0.125).max() == pytest.approx(0.125, rel=0.01)
