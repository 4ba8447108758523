# ruff: noqa: D103
"""The draw of a placement: again, where the robot would begin inside the person."""

from __future__ import annotations

import copy
import dataclasses
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import agym_jax
from agym_jax.data import banks
from agym_jax.data.banks import Placement, bank_path
from agym_jax.errors import SpecError
from agym_jax.offline import placements
from agym_jax.robots import ROBOTS
from agym_jax.sim.starts import Starts, apart, draw_start, load_starts, rarity
from agym_jax.tasks import TASKS

TASK, ROBOT = TASKS["BedBathing"], ROBOTS["Jaco"]
ROWS = 8
BANK = Placement(*(np.tile(np.arange(ROWS, dtype=np.float32)[:, None], n) for n in (3, 4, 7)))
KEYS = jax.random.split(jax.random.PRNGKey(0), 4000)
INSIDE = ((0, 335), (0, 781), (3, 1183), (4, 572), (5, 464))
"""Batches and environments in which Jaco began inside a forearm, and pushed it with 370 to 620 N at once."""


def drawn(meets: np.ndarray | None, posture: int | None = 0) -> np.ndarray:
    """Rows that are drawn with ``KEYS``."""
    place = jax.vmap(lambda key: draw_start(key, Starts(BANK, meets), posture))(KEYS)
    return np.asarray(place.arm_angles[:, 0]).astype(int)


def test_only_placements_that_meet_the_person_are_drawn_again_evenly_among_the_others():
    meets = np.zeros((3, ROWS), bool)
    meets[1, [0, 3, 6, 7]] = True
    before = drawn(None)
    np.testing.assert_array_equal(drawn(meets, 0), before)
    after = drawn(meets, 1)
    free = ~meets[1, before]
    np.testing.assert_array_equal(after[free], before[free])
    assert not meets[1, after].any()
    for row in (0, 3, 6, 7):  # whatever was drawn first
        share = np.bincount(after[before == row], minlength=ROWS) / (before == row).sum()
        np.testing.assert_allclose(share[[1, 2, 4, 5]], 0.25, atol=0.08)


def test_a_placement_that_meets_a_person_stays_where_all_do():
    np.testing.assert_array_equal(drawn(np.ones((1, ROWS), bool)), drawn(None))


def test_a_single_free_placement_is_found():
    for row in (0, ROWS - 1):
        meets = np.ones((1, ROWS), bool)
        meets[0, row] = False
        assert (drawn(meets) == row).all()


def test_a_pose_counts_as_many_times_less_as_there_are_poses_like_it():
    turn = 2 * np.pi
    angles = np.array([[0.0, 0.0], [0.4, 0.0], [turn, 0.1], [2.0, 0.0]])
    np.testing.assert_allclose(apart(angles, angles)[0], [0.0, 0.4, 0.1, 2.0], atol=1e-9)
    np.testing.assert_allclose(rarity(angles), [1 / 6, 1 / 6, 1 / 6, 1 / 2])


def test_rare_poses_are_drawn_as_often_as_common_ones_in_a_fraction_of_the_episodes():
    angles = np.zeros((ROWS, 7), np.float32)
    angles[:, 0] = [0, 0, 0, 0, 0, 0, 0, 2]  # one pose of eight is rare
    bank = dataclasses.replace(BANK, arm_angles=angles)
    mouths = np.array([[0, 0, 1], *[[0, 0, 2]] * (ROWS - 1)], float)

    def rows(**kwargs: Any) -> np.ndarray:
        starts, mouth = Starts(bank, **kwargs), jnp.array([0.0, 0.0, 2.0])
        place = jax.vmap(lambda key: draw_start(key, starts, None, mouth))(KEYS)
        return np.asarray(place.base_pos[:, 0]).astype(int)

    usual, half = rows(), rows(rare=0.5)
    assert (usual == ROWS - 1).mean() == pytest.approx(1 / 8, abs=0.02)
    assert (half == ROWS - 1).mean() == pytest.approx(0.5 / 8 + 0.5 / 2, abs=0.03)
    same = (half == usual).mean()  # the other half begins as without rare starts
    assert same == pytest.approx(0.5 + 0.5 / 8, abs=0.03)
    suited = rows(mouths=mouths, rare=1.0)  # row 0 is of another mouth
    assert (suited > 0).all()
    assert (suited == ROWS - 1).mean() == pytest.approx((1 / 2) / (1 / 2 + 6 / 14), abs=0.03)


def test_rare_starts_of_an_environment_are_drawn_from_its_bank():
    variation = agym_jax.RobotVariation(rare_starts=0.5)
    env = agym_jax.make("DrinkingBaxter-v0", impl="native", robot=variation)
    assert env._starts.rare == 0.5
    assert agym_jax.make("DrinkingBaxter-v0", impl="native")._starts.rare == 0.0
    angles = np.asarray(env._starts.bank.arm_angles)
    at_limit = angles[:, 5] < -1.54  # of the wrist's bend
    assert at_limit.mean() == pytest.approx(0.07, abs=0.005)
    assert rarity(angles)[at_limit].sum() == pytest.approx(0.26, abs=0.005)


def test_a_person_gets_one_of_the_bases_chosen_for_the_nearest_mouth():
    mouths = np.array([[0, 0, 1], [0, 0, 2], [0, 0, 1], [0, 0, 3], [0, 0, 1], [0, 0, 2], [0, 0, 3], [0, 0, 3]], float)  # fmt: skip
    starts = Starts(BANK, mouths=mouths)
    for height, rows in ((1.1, [0, 2, 4]), (1.9, [1, 5]), (9.0, [3, 6, 7])):
        mouth = jnp.array([0.1, 0.0, height])
        place = jax.vmap(lambda key, at=mouth: draw_start(key, starts, None, at))(KEYS)
        share = np.bincount(np.asarray(place.base_pos[:, 0]).astype(int), minlength=ROWS) / len(
            KEYS
        )
        np.testing.assert_allclose(share[rows], 1 / len(rows), atol=0.04)
        np.testing.assert_allclose(share[rows].sum(), 1.0)


# -- files -----------------------------------------------------------------------------------------


def save(folder: Path, monkeypatch: pytest.MonkeyPatch, meets: Any) -> None:
    """A user's own bank of the pair."""
    monkeypatch.setenv(banks.VARIABLE, str(folder))
    placements.save_bank(BANK, bank_path(TASK, ROBOT), {}, meets)


def test_a_bank_without_a_table_draws_as_ever(tmp_path: Path, monkeypatch):
    save(tmp_path, monkeypatch, None)
    starts = load_starts(TASK, ROBOT)
    assert starts.meets is None and len(starts.bank.base_pos) == ROWS
    assert load_starts(TASKS["Reaching"], ROBOT).meets is None


@pytest.mark.parametrize(
    "table",
    [
        np.zeros((767, ROWS), bool),
        np.zeros((768, ROWS + 1), bool),
        np.zeros(768, bool),
        np.zeros((768, ROWS)),
    ],
    ids=["postures", "placements", "axes", "type"],
)
def test_a_table_of_other_postures_or_placements_names_the_command(
    tmp_path: Path, monkeypatch, table: np.ndarray
):
    save(tmp_path, monkeypatch, table)
    wanted = r"should be bool \(768, 8\).*again with: agym-jax placements meet BedBathingJaco-v0"
    with pytest.raises(SpecError, match=wanted):
        load_starts(TASK, ROBOT)


def test_mouths_of_other_placements_name_the_command(tmp_path: Path, monkeypatch):
    task, robot = TASKS["Drinking"], ROBOTS["PR2"]
    monkeypatch.setenv(banks.VARIABLE, str(tmp_path))
    placements.save_bank(BANK, bank_path(task, robot), {}, mouths=np.zeros((ROWS - 1, 3)))
    with pytest.raises(SpecError, match=r"'mouths'.*build DrinkingPR2-v0"):
        load_starts(task, robot)
    placements.save_bank(BANK, bank_path(task, robot), {}, mouths=np.full((ROWS, 3), np.nan))
    with pytest.raises(SpecError, match="should be finite numbers"):
        load_starts(task, robot)
    placements.save_bank(BANK, bank_path(task, robot), {}, mouths=np.zeros((ROWS, 3)))
    assert load_starts(task, robot).mouths.shape == (ROWS, 3)
    placements.save_bank(BANK, bank_path(task, robot), {})  # built before there were any
    assert load_starts(task, robot).mouths is None


# -- episodes --------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def env() -> Any:
    return agym_jax.make("BedBathingJaco-v0", impl="native")


@pytest.fixture(scope="module")
def keys() -> jax.Array:
    """Of the episodes that began inside somebody, and of others."""
    inside = [jax.random.split(jax.random.PRNGKey(1000 + r), 2048)[i] for r, i in INSIDE]
    return jnp.concatenate([jnp.stack(inside), KEYS[:500]])


def test_episodes_whose_placement_was_free_are_unchanged(env: Any, keys: jax.Array):
    blind = copy.copy(env)
    blind._starts = dataclasses.replace(env._starts, meets=None)
    after, before = (jax.jit(jax.vmap(x._sample_episode))(keys) for x in (env, blind))
    others = np.any(after[0][2].arm_angles != before[0][2].arm_angles, axis=1)
    assert others[: len(INSIDE)].all() and others[len(INSIDE) :].mean() < 0.02
    for one, other in zip(jax.tree.leaves(after), jax.tree.leaves(before), strict=True):
        np.testing.assert_array_equal(one[~others], other[~others])
    people = [jax.tree.leaves((sample[:2], *rest)) for sample, *rest in (after, before)]
    for one, other in zip(*people, strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.jit
def test_nobody_is_pushed_by_a_robot_that_begins_inside_them(env: Any, keys: jax.Array):
    for key in keys[: len(INSIDE)]:
        state = env.reset(key)
        state = env.step(state, np.zeros(env.action_size, np.float32))
        assert 0.0 <= state.metrics["force/peak_on_human"] < 100.0


def test_the_base_suits_the_mouth_of_the_person():
    env = agym_jax.make("DrinkingPR2-v0", impl="native")
    near = []
    for seed in range(12):
        state = env.reset(jax.random.PRNGKey(seed))
        mouth, bank = np.asarray(state.task.mouth_pos_w), env._starts
        row = np.flatnonzero(
            (np.asarray(state.episode.placement.base_pos) == bank.bank.base_pos).all(1)
        )
        away = np.linalg.norm(bank.mouths - mouth, axis=1)
        near.append(away[row].min() - away.min())
    assert max(near) < 1e-4, near  # the nearest of all there are, apart from rounding
    assert agym_jax.make("DrinkingJaco-v0", impl="native")._starts.mouths is None
