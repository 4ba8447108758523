# ruff: noqa: D103
"""Tables of the shipped policies rest on the result lines of their trainings."""

from __future__ import annotations

import json

import pytest

from agym_jax.errors import ArgumentError
from benchmarks import policy_tables
from benchmarks.markdown import RESULTS

FILES = ("selection", "gentle", "continued", "candidates")


def test_a_policy_without_the_line_of_its_training_is_an_error(tmp_path):
    for name in FILES:
        lines = (RESULTS / f"{name}.jsonl").read_text().splitlines()
        kept = [x for x in lines if json.loads(x)["env"] != "FeedingPR2-v0"]
        (tmp_path / f"{name}.jsonl").write_text("\n".join(kept) + "\n")
    with pytest.raises(ArgumentError, match="FeedingPR2-v0: no result line tells of the training"):
        policy_tables.chosen_among(tmp_path)
