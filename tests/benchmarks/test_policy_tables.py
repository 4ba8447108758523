# ruff: noqa: D103
"""Tables of the shipped policies rest on the result lines of their trainings."""

from __future__ import annotations

import json

import pytest
from paths import ROOT

from agym_jax.errors import ArgumentError
from agym_jax.policy.files import find_policy
from agym_jax.policy.policy import read_policy, shipped
from agym_jax.registry import parse
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


def table_of(page, name):
    """Rows of a generated table, as cells."""
    text = page.partition(f"<!-- table:{name} -->")[2].partition(f"<!-- /table:{name} -->")[0]
    rows = [line.strip("| ").split(" | ") for line in text.splitlines() if line.startswith("| ")]
    return [[cell.strip() for cell in row] for row in rows[1:]]


def test_how_many_policies_keep_four_fifths_of_their_success_is_what_the_pages_say():
    readme, transfer, memory = (
        (ROOT / name).read_text() for name in ("README.md", "docs/transfer.md", "docs/memory.md")
    )
    shares = {row[0]: int(row[3].rstrip("%")) for row in table_of(transfer, "in-assistive-gym")}
    kept = {env for env, share in shares.items() if share >= 80}
    remembering = set()
    for env, _, success, *_, there in table_of(memory, "memory-policies"):
        here = float(success.rpartition("-> ")[2].partition("%")[0]) / 100
        successes, episodes = map(int, there.rpartition("-> ")[2].split(" of "))
        remembering |= {env} if successes / episodes >= 0.8 * here else set()
    assert remembering and remembering < shares.keys()
    plain, all_kept, whole = len(kept), len(kept | remembering), len(shares)
    assert f"where {plain} of {whole} keep at least four fifths of their success" in readme
    assert f"({all_kept}, counting policies with a [memory](docs/memory.md) that ship" in readme
    assert f"Four fifths are reached in {plain} of these {whole} environments" in transfer
    assert f"So {all_kept} of the {whole} environments have a policy that keeps" in transfer


def test_how_many_policies_met_people_of_every_size_is_what_the_page_says():
    care = (ROOT / "docs/care.md").read_text()
    found = {name: read_policy(find_policy(name)).info.get("changes", {}) for name in shipped()}
    met = [name for name, changes in found.items() if changes.get("humans.sizes") == "both"]
    alone = [name for name in met if not parse(name).active]
    assert f"Of the 28 policies of robots alone, {len(alone)} were trained" in care
    assert f"Of the pairs, {len(met) - len(alone)} met both kinds of size" in care


def test_policies_among_arms_as_there_have_the_figures_of_the_other_tables():
    transfer, memory = ((ROOT / f"docs/{name}.md").read_text() for name in ("transfer", "memory"))
    there = {(row[0], "ships"): row[1] for row in table_of(transfer, "in-assistive-gym")}
    for env, _, success, *_, runs in table_of(memory, "memory-policies"):
        there[env, "ships, with a memory"] = runs.rpartition("-> ")[2]
        there[env, "usual"] = success.rpartition("-> ")[2].partition("%")[0]
    rows = table_of(transfer, "dressing-arms")
    shipped = [row for row in rows if row[1].startswith("ships")]
    assert len(shipped) == 7  # with all four robots, and with a memory for three
    for env, policy, usual, *_, runs in shipped:
        assert runs == there[env, policy]
        if "memory" in policy:
            assert int(usual.rstrip("%")) == round(float(there[env, "usual"]))
