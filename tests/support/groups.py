"""Which tests run on one worker, and in which order: those that share what takes long to compile.

The tests of a file are a group, unless ``GROUPS`` says otherwise. The longest groups begin first, so that workers end
together. Done by a scheduler of our own, as pytest-xdist 3.8 overlooks ``xdist_group`` marks with pytest 9.2 and says
nothing.
"""

from __future__ import annotations

from typing import Any

import pytest

COMPILED = "compiled environment"
GROUPS = {
    "tests/test_env.py": COMPILED,
    "tests/sim/test_parity.py": COMPILED,
    "tests/sim/test_c_mujoco.py::test_the_same_key_begins_the_same_episode_as_in_mjx": COMPILED,
    "tests/sim/test_c_mujoco.py::test_every_step_of_a_pressing_robot_is_mjxs": COMPILED,
}
"""File, or file::test -> group."""
APART = {"tests/docs/test_torch_page.py::test_an_example_learns_to_reach"}
"""Tests that take minutes and share nothing: each of their cases is a group of its own."""
SHARED = {"batch": COMPILED, "rollout": COMPILED}
"""Fixtures that compile an environment -> group that their tests must be in."""
SECONDS = {
    COMPILED: 120, "tests/train/test_coop.py": 60, "tests/tasks/test_meals.py": 50,
    "tests/tasks/test_dressing.py": 35, "tests/sim/test_c_mujoco.py": 30, "tests/matter/test_cloth.py": 30,
    "tests/matter/test_containers.py": 28, "tests/train/test_learner.py": 25, "tests/train/test_seeds.py": 25,
    "tests/offline/test_base_search.py": 25, "tests/train/test_ppo.py": 24, "tests/adapters/test_brax.py": 23,
    "tests/offline/test_bed_postures.py": 22, "tests/policy/test_export.py": 22, "tests/train/test_select.py": 20,
    "tests/train/test_saving.py": 19, "tests/matter/test_cloth_kernel.py": 17, "tests/parity/test_motors.py": 17,
    "tests/train/test_curves.py": 17, "tests/parity/test_lying_arm.py": 16, "tests/human/test_limits.py": 16,
}  # fmt: skip
"""What the longest groups take, roughly (2 cores, cold cache)."""
SLOW_SECONDS = {
    "tests/train/test_devices.py": 190, "tests/sim/test_warp.py": 110,
    "tests/docs/test_torch_page.py::test_an_example_learns_to_reach": 120,
    "tests/docs/test_docs.py": 210, "tests/docs/test_brax_page.py": 120,
    "tests/adapters/test_brax.py": 20, "tests/test_wheel.py": 150,
    "tests/tasks/test_meals.py": 40, "tests/adapters/test_gymnasium.py": 35,
    "tests/train/test_coop.py": 30, "tests/train/test_seeds.py": 45, "tests/train/test_ppo.py": 15,
}  # fmt: skip
"""The same of the tests that are marked slow."""


def group_of(nodeid: str) -> str:
    """The group of a test."""
    path, _, test = nodeid.partition("::")
    name = test.partition("[")[0]
    if f"{path}::{name}" in APART:
        return nodeid
    return GROUPS.get(f"{path}::{name}") or GROUPS.get(path, path)


def arrange(items: list[pytest.Item]) -> None:
    """Put the longest groups first.

    Raises:
        pytest.UsageError: a test would compile an environment again that another group has.
    """
    for item in items:
        for group in {SHARED[x] for x in getattr(item, "fixturenames", ()) if x in SHARED}:
            if group_of(item.nodeid) != group:
                raise pytest.UsageError(f"{item.nodeid} belongs into {group!r}, see {__file__}")
    # pytest's own deselection by marks comes after this, and does not change the order
    items.sort(key=lambda item: -_seconds(item, slow="not slow" not in item.config.option.markexpr))


def _seconds(item: pytest.Item, slow: bool) -> float:
    """How long the group of a test takes, in a run of the slow tests or of the others."""
    group, _, _ = group_of(item.nodeid).partition(
        "["
    )  # all cases of a test that is apart take about as long
    return (SLOW_SECONDS if slow else SECONDS).get(group, 0)


def scheduler(config: pytest.Config, log: Any) -> Any:
    """A scheduler of pytest-xdist that hands out groups, in the order of their first tests."""
    from xdist.scheduler import LoadScopeScheduling

    class Groups(LoadScopeScheduling):
        def _split_scope(self, nodeid: str) -> str:
            return group_of(nodeid)

    config.option.loadscopereorder = False
    return Groups(config, log)
