# ruff: noqa: D103
"""Episodes here begin as recorded ones do. The recording is made here too: Assistive Gym is not needed."""

from __future__ import annotations

from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import agym_jax
from agym_jax.errors import ArgumentError
from benchmarks import in_assistive_gym as ag
from benchmarks.same_starts import SEEN, begin, main

NAME = "ScratchItchJaco-v0"


@pytest.fixture(scope="module")
def env() -> agym_jax.Env:
    return agym_jax.make(NAME, impl="native")


@pytest.fixture(scope="module")
def recorded(env):
    """What ``start_of`` would tell of an episode, and the episode."""
    state = env.reset(jax.random.PRNGKey(3))
    human, task = state.episode.human, state.task
    return {
        "obs": np.asarray(state.obs, float), "sex": float(human.sex), "strength": float(human.strength),
        "limit_scale": float(human.limit_scale), "tremor": np.asarray(human.tremor, float),
        "on_forearm": float(task.on_forearm), "itch": np.asarray(task.target_limb, float),
    }, state  # fmt: skip


@pytest.mark.jit
def test_base_arm_person_and_itch_are_those_of_the_recording(env, recorded):
    start, theirs = recorded
    ours = begin(env, start)
    np.testing.assert_allclose(ours.obs[np.array(SEEN)], start["obs"][SEEN], atol=1e-3)
    np.testing.assert_allclose(ours.obs[7:13], start["obs"][7:13], atol=1e-6)
    np.testing.assert_allclose(ours.task.target_limb, theirs.task.target_limb, atol=1e-6)
    assert ours.episode.human.strength == theirs.episode.human.strength
    action = jnp.zeros(7)
    seen = [np.asarray(env.step(state, action).obs) for state in (ours, theirs)]
    np.testing.assert_allclose(
        seen[0][7:13], seen[1][7:13], atol=2e-3
    )  # the itch moves with the arm


@pytest.mark.jit
def test_the_start_of_another_robot_is_refused(env, recorded):
    start = dict(recorded[0])
    start["obs"] = start["obs"] + np.r_[0.3, np.zeros(29)]
    with pytest.raises(ArgumentError, match="another robot"):
        begin(env, start)


@pytest.mark.jit
@pytest.mark.slow
def test_successes_are_counted_with_and_without_tools_that_turned(recorded, tmp_path, capsys):
    start, _ = recorded
    ends = [SimpleNamespace(success=ok, turned=turned, start=start) for ok, turned in ((True, 0.1), (False, 1.0))]  # fmt: skip
    ag.write_starts(tmp_path / "starts.npz", 7000, ends)
    assert main([NAME, str(tmp_path / "starts.npz"), "--json", str(tmp_path / "out.jsonl")]) == 0
    said = capsys.readouterr()
    assert "there                    1\n" in said.out and "held_there               1\n" in said.out
    assert "seed 7001" in said.err and "failure there; the tool turned by 57 degrees" in said.err
    assert (tmp_path / "out.jsonl").is_file()


def test_other_tasks_have_no_starts(tmp_path, capsys):
    assert main(["FeedingJaco-v0", str(tmp_path / "none.npz")]) == 1
    assert "ScratchItch alone" in capsys.readouterr().err
    with pytest.raises(SystemExit, match="written for ScratchItch, not for Feeding"):
        ag.main(["FeedingJaco-v0", "none.npz", "--starts", "starts.npz"])
