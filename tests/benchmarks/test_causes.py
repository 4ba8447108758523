# ruff: noqa: D103
"""The largest forces on people, accounted for: they are found, played once more, and have a cause."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from agym_jax.sim.impulse import Balance
from benchmarks import causes, physics_tables
from train.runs.record import record


def seen(*peaks: float) -> SimpleNamespace:
    """A state of environments with these peaks, each on another region."""
    regions = SimpleNamespace(peak=np.diag(peaks))
    return SimpleNamespace(regions=regions, number=np.array(peaks))


def test_the_hardest_steps_are_kept_with_the_state_before(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(causes.jax.tree, "map", lambda f, state: f(state.number))
    hardest = causes.Hardest(3, length=3)
    for state in (seen(90, 80), seen(1, 2), seen(3, 40), seen(99, 98)):  # first, two steps, last
        hardest(state)
    for state in (seen(70, 60), seen(5, 30), seen(1, 1), seen(99, 98)):
        hardest(state)
    kept = sorted(hardest.kept, reverse=True)
    assert [x[0] for x in kept] == [40, 30, 5]
    assert [x[2] for x in kept] == [1, 1, 0]
    assert [x[3] for x in kept] == [2, 60, 70]


def test_where_nobody_is_touched_nothing_is_kept():
    hardest = causes.Hardest(3, length=3)
    for state in (seen(0, 0), seen(0, 0), seen(0, 0), seen(9, 9)):
        hardest(state)
    assert not hardest.kept


def balance(contacts: float, force: float, motors: float = 0.0) -> Balance:
    nothing = np.zeros(1)
    return Balance(
        momentum=nothing, motors=np.array([motors]), limits=nothing, contacts=np.array([contacts]),
        inertial=nothing, force=force, bound=1.0,
    )  # fmt: skip


def test_a_force_without_a_cause_shows():
    held = balance(contacts=-1.0, force=2.0, motors=1.0)  # a lever of half a metre
    found = causes.summary([2.0], [held, balance(0.0, 0.0)])
    assert found["beyond"] == 0.0 and found["lacks"] == 0.0 and found["force"] == 2.0
    found = causes.summary([9.0, 2.0], [held, balance(contacts=-5.0, force=10.0, motors=1.0)])
    assert found["beyond"] == pytest.approx(4.0)  # 2 N have a cause
    assert found["lacks"] == pytest.approx(4.0) and found["lacks_of"] == pytest.approx(0.8)
    assert (found["peak"], found["least_peak"]) == (9.0, 2.0)


@pytest.mark.jit
def test_a_policys_hardest_steps_happen_again_and_have_a_cause():
    config = causes.CausesConfig(num_episodes=8, steps=4)
    found = causes.measure("ReachingJaco-v0", config)
    assert found["steps"] == 4 and found["replay_off"] < 1e-3
    assert found["peak"] >= found["least_peak"] > 0.0 and found["force"] >= found["peak"]
    assert found["beyond"] < 0.15 and found["lacks"] < 0.35


def test_a_policy_that_touches_nobody_has_a_row_without_an_account(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
):
    env = SimpleNamespace(impl="native", episode_length=200)
    for name, value in {
        "make_env": lambda *_: env,
        "find_policies": str,
        "load_policies": lambda *_: None,
    }.items():
        monkeypatch.setattr(causes, name, value)
    monkeypatch.setattr(causes, "Evaluator", lambda *_: lambda *_, **__: None)
    found = causes.measure("DressingPR2-v0", causes.CausesConfig(num_episodes=64))
    assert found["steps"] == 0 and found["episodes"] == 64 and "peak" not in found
    (tmp_path / "causes.jsonl").write_text(json.dumps(record("causes", **found)))
    assert "| DressingPR2-v0 | 64 | 0 | none |" in physics_tables.causes(tmp_path)


def test_an_unknown_name_is_answered_before_long_work(capsys: pytest.CaptureFixture[str]):
    assert causes.main(["--only", "ReachingJako"]) == 2
    assert "ReachingJaco" in capsys.readouterr().err
