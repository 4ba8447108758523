"""Which tests run on one worker, and in which order: those that share what takes long to compile.

Without a word the tests of a file are a group. Where tests of several files share a compiled environment, they are
one group; where the parts of a file share nothing, ``@pytest.mark.xdist_group`` makes groups of them.
"""

from __future__ import annotations

import pytest

SHARED = {"batch": "compiled environment", "rollout": "compiled environment"}
"""Session fixtures that compile an environment, and the group of the tests that use one."""
SECONDS = {
    "compiled environment": 150, "tests/train/test_coop.py": 120, "tests/sim/test_c_mujoco.py": 90,
    "tests/tasks/test_dressing.py": 60, "tests/matter/test_cloth_kernel.py": 50,
    "tests/offline/test_base_search.py": 50, "tests/tasks/test_meals.py": 40,
    "tests/matter/test_containers.py": 35, "tests/train/test_ppo.py": 30,
    "tests/matter/test_cloth.py": 30, "tests/matter/test_particles.py": 30,
}  # fmt: skip
"""What the longest groups take, roughly (2 cores, cold cache): these begin first, so that workers end together."""


def group_of(item: pytest.Item) -> str:
    """The group that a test belongs to."""
    for fixture in getattr(item, "fixturenames", ()):
        if fixture in SHARED:
            return SHARED[fixture]
    mark = item.get_closest_marker("xdist_group")
    return mark.args[0] if mark else item.nodeid.split("::")[0]


def arrange(items: list[pytest.Item]) -> None:
    """Mark every test with its group, and put the longest groups first."""
    groups = [group_of(item) for item in items]
    for item, group in zip(items, groups, strict=True):
        item.add_marker(pytest.mark.xdist_group(group), append=False)
    longest = dict(zip(items, groups, strict=True))
    items.sort(key=lambda item: -SECONDS.get(longest[item], 0))
