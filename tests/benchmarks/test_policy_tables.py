# ruff: noqa: D103
"""Tables of the shipped policies rest on the result lines of their trainings."""

from __future__ import annotations

import json
import re

import pytest
from paths import ROOT

from agym_jax.errors import ArgumentError
from benchmarks import policy_tables
from benchmarks.markdown import RESULTS


def test_a_policy_without_the_line_of_its_training_is_an_error(tmp_path):
    for name in policy_tables.TRAININGS:
        lines = (RESULTS / f"{name}.jsonl").read_text().splitlines()
        kept = [x for x in lines if json.loads(x)["env"] != "FeedingPR2-v0"]
        (tmp_path / f"{name}.jsonl").write_text("\n".join(kept) + "\n")
    with pytest.raises(ArgumentError, match="FeedingPR2-v0: no result line tells of the training"):
        policy_tables.chosen_among(tmp_path)


def test_sweeps_of_other_hyperparameters_do_not_replace_each_other(tmp_path):
    def sweep(time, success, **setting):
        found = {"success_iqm": success, "worst": 0.0, "gentle_iqm": 0.0, "peak_iqm": 9.0}
        return {
            "env": "ReachingJaco-v0", "num_env_steps": 1e6, "planned_env_steps": 1e6, "num_seeds": 4,
            "time": time, "commit": "0123456789", "device": {"kind": "Some GPU"},
            "ranking": [found | {"setting": setting}],
        }  # fmt: skip

    lines = [
        sweep("2026-12-01T00:00", 0.111, lr=1e-3),
        sweep("2026-12-02T00:00", 0.222, gamma=0.9),
        sweep("2026-12-03T00:00", 0.333, lr=2e-3),
    ]
    (tmp_path / "sweeps.jsonl").write_text("\n".join(map(json.dumps, lines)) + "\n")
    table = policy_tables.sweeps(tmp_path)
    assert "22.2%" in table and "33.3%" in table and "11.1%" not in table


def test_the_share_of_policies_that_help_in_assistive_gym_is_the_tables():
    table = policy_tables.in_assistive_gym().splitlines()
    shares = [int(x) for row in table for x in re.findall(r"\| (\d+)% \|$", row)]
    kept = f"{sum(x >= 80 for x in shares)} of"
    assert f"where {kept} {len(shares)} keep" in (ROOT / "README.md").read_text()
    assert f"reached in {kept} these {len(shares)}" in (ROOT / "docs" / "transfer.md").read_text()
