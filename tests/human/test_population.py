# ruff: noqa: D103
"""Who is drawn: reference humans.md sections 1 and 6."""

from __future__ import annotations

import jax
import numpy as np
import pytest

from agym_jax.errors import ArgumentError, UnknownNameError
from agym_jax.human.population import (
    IMPAIRMENTS,
    Human,
    Population,
    checked_population,
    sample_human,
)

N = 4096
AMPLITUDE = np.deg2rad(10.0)
# four standard deviations of a share of N draws: a fair draw fails once in 16 000 keys, and the
# key is fixed
HALF, QUARTER = 4 * np.sqrt(0.25 / N), 4 * np.sqrt(0.1875 / N)


def crowd(humans: Population, seed: int = 0, impairments: tuple[str, ...] = IMPAIRMENTS) -> Human:
    keys = jax.random.split(jax.random.PRNGKey(seed), N)
    return jax.device_get(
        jax.vmap(lambda k: sample_human(k, humans, 10, AMPLITUDE, impairments))(keys)
    )


@pytest.fixture(scope="module")
def everyone() -> Human:
    return crowd(Population())


def test_half_are_women_of_the_median_size(everyone: Human):
    assert set(np.unique(everyone.sex)) == {0.0, 1.0}
    assert abs(everyone.sex.mean() - 0.5) < HALF
    assert (everyone.stature == 1.0).all() and (everyone.girth == 1.0).all()


def test_each_impairment_has_a_quarter(everyone: Human):
    trembles = (everyone.tremor != 0).any(-1)
    kinds = [everyone.limit_scale < 1, everyone.strength < 1, trembles]
    for kind in kinds:
        assert abs(kind.mean() - 0.25) < QUARTER
    assert np.max(np.sum(kinds, axis=0)) == 1  # never two at once
    assert abs((np.sum(kinds, axis=0) == 0).mean() - 0.25) < QUARTER


def test_severity_is_uniform_over_the_references_ranges(everyone: Human):
    for values, low, high in (
        (everyone.limit_scale[everyone.limit_scale < 1], 0.5, 1.0),
        (everyone.strength[everyone.strength < 1], 0.25, 1.0),
        (everyone.tremor[(everyone.tremor != 0).any(-1)].ravel(), -AMPLITUDE, AMPLITUDE),
    ):
        assert low <= values.min() and values.max() <= high
        share = (values - low) / (high - low)
        assert share.min() < 0.02 and share.max() > 0.98
        # mean and variance of a uniform draw: 1/2 and 1/12, to four standard deviations
        assert abs(share.mean() - 0.5) < 4 * np.sqrt(1 / 12 / len(share))
        assert abs(share.var() - 1 / 12) < 4 * np.sqrt(1 / 180 / len(share))


def test_joints_tremble_independently(everyone: Human):
    tremor = everyone.tremor[(everyone.tremor != 0).any(-1)]
    off_diagonal = np.corrcoef(tremor.T)[np.triu_indices(10, 1)]
    assert np.abs(off_diagonal).max() < 5 / np.sqrt(len(tremor))


def test_same_key_same_person_other_key_another(everyone: Human):
    again, other = crowd(Population()), crowd(Population(), seed=1)
    jax.tree.map(np.testing.assert_array_equal, everyone, again)
    assert not np.array_equal(everyone.sex, other.sex)
    assert not np.array_equal(everyone.strength, other.strength)


def test_continuous_sizes_fill_their_ranges():
    humans = Population(sizes="continuous", stature=(0.95, 1.05))
    p = crowd(humans)
    for values, (low, high) in (
        (p.sex, humans.blend), (p.stature, (0.95, 1.05)), (p.girth, humans.girth)
    ):  # fmt: skip
        assert low <= values.min() < low + 0.02 * (high - low)
        assert high >= values.max() > high - 0.02 * (high - low)
    assert len(np.unique(p.sex)) > N / 2


def test_people_of_both_kinds_are_drawn_as_those_of_each_kind():
    ag, continuous, both = (crowd(Population(sizes=x)) for x in ("ag", "continuous", "both"))
    average = (both.stature == 1) & (both.girth == 1)
    assert abs(average.mean() - 1 / 2) < 4 * np.sqrt(1 / 4 / N)
    for name in ("sex", "stature", "girth"):
        expected = np.where(average, getattr(ag, name), getattr(continuous, name))
        np.testing.assert_array_equal(getattr(both, name), expected)
    for other in (
        both.strength < 1,
        both.limit_scale < 1,
    ):  # independent of the rest, which stays as it was
        assert abs(np.corrcoef(average, other)[0, 1]) < 5 / np.sqrt(N)
    for name in ("strength", "limit_scale", "tremor"):
        np.testing.assert_array_equal(getattr(both, name), getattr(ag, name))


def test_nobody_is_asked_to_tremble_with_a_limp_arm():
    trembling = Population(impairments=("none", "tremor"))
    assert checked_population(trembling, 0.1) is trembling
    with pytest.raises(ArgumentError, match="Nobody trembles in this task"):
        checked_population(trembling, 0.0)
    assert checked_population(None, 0.0) == Population()  # the task's own are without


def test_population_may_narrow_the_tasks_impairments():
    p = crowd(Population(impairments=("weakness",)))
    assert (p.strength < 1).all() and (p.limit_scale == 1).all() and (p.tremor == 0).all()
    # humans.md section 6, no_tremor: thirds
    p = crowd(Population(), impairments=("none", "limits", "weakness"))
    assert (p.tremor == 0).all()
    assert abs((p.strength < 1).mean() - 1 / 3) < 4 * np.sqrt(2 / 9 / N)


def test_masses_are_where_the_body_is_or_at_the_joints():
    assert (crowd(Population()).at_joints == 0).all()
    assert (crowd(Population(masses="ag")).at_joints == 1).all()


def test_both_masses_are_drawn_alike_and_nothing_else_changes():
    usual, both = crowd(Population()), crowd(Population(masses="both"))
    kinds, shares = np.unique(both.at_joints, return_counts=True)
    np.testing.assert_array_equal(kinds, [0.0, 1.0])
    assert abs(shares[1] / N - 1 / 2) < 4 * np.sqrt(1 / 4 / N)
    for name in ("sex", "strength", "limit_scale", "tremor"):
        np.testing.assert_array_equal(getattr(both, name), getattr(usual, name))
    # independent of who the person is, and the same for the same key
    for other in (both.sex, both.strength < 1, both.limit_scale < 1):
        assert abs(np.corrcoef(both.at_joints, other)[0, 1]) < 5 / np.sqrt(N)
    again = crowd(Population(masses="both"))
    np.testing.assert_array_equal(again.at_joints, both.at_joints)


def test_unknown_names_are_refused_with_the_nearest():
    with pytest.raises(UnknownNameError, match=r"distribution of masses 'at'"):
        Population(masses="at")
    with pytest.raises(UnknownNameError, match=r"impairment 'tremors'.*Did you mean 'tremor'"):
        Population(impairments=("tremors",))
    with pytest.raises(UnknownNameError, match=r"'contiguous'.*Did you mean 'continuous'"):
        Population(sizes="contiguous")
