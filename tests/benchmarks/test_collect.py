# ruff: noqa: D103 (a test's name says what it shows)
"""Runs of a suite become results of the repository, and what ships is replaced by what is better, only."""

from __future__ import annotations

import dataclasses
import json
import shutil
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from fake_env import FakeEnv
from fake_pair_env import FakePairEnv

from agym_jax.policy.policy import read_policy
from benchmarks import collect as collecting
from benchmarks import (
    continued_tables,
    markdown,
    policy_tables,
    seed_curves,
    shipped,
    suite_tables,
)
from benchmarks.journal import JournalError, whole_suite
from benchmarks.setting_as_run import SettingError, setting_as_run
from train import coop, ppo, select
from train.configs import CoopConfig, PPOConfig
from train.runs.overview import first_time, read_rows, reduced_curve, training_summary

SHORT = {
    "num_env_steps": 960, "num_envs": 16, "num_mini_batch": 4, "policy_hidden": (8,), "value_hidden": (8,),
    "log_interval": 1, "num_seeds": 2,
}  # fmt: skip
ALONE, PAIR = "ReachingJaco-v0", "ReachingJacoHuman-v0"


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """Two trainings with two seeds each, and the choices among them, as a suite leaves them."""
    folder = tmp_path_factory.mktemp("runs")
    ppo.train(FakeEnv(name=ALONE), PPOConfig(**SHORT, save_dir=str(folder)))
    coop.train(FakePairEnv(task_name="ReachingJaco"), CoopConfig(**SHORT, save_dir=str(folder)))
    for name, env in ((ALONE, FakeEnv(name=ALONE)), (PAIR, FakePairEnv(task_name="ReachingJaco"))):
        words = [str(folder / name), "--num-episodes", "16", "--no-shipped"]
        assert select.main(words, lambda *_, e=env: e) == 0
    return folder


@pytest.fixture
def repository(tmp_path, monkeypatch):
    """An empty one: results, policies."""
    results, policies = tmp_path / "results", tmp_path / "policies"
    results.mkdir()
    (policies / "human").mkdir(parents=True)
    monkeypatch.setattr(collecting, "RESULTS", results)
    monkeypatch.setattr(collecting, "POLICIES", policies)
    monkeypatch.setattr(
        collecting,
        "recorded",
        lambda: {x["env"]: x for x in read_rows(results / "evaluation.jsonl")},
    )
    monkeypatch.setattr(collecting.tables, "main", lambda words: 0)
    monkeypatch.setattr(collecting.seed_curves, "main", lambda words: 0)
    return tmp_path


def change(runs, name, **fields):
    """The choice of a run with other figures, in place; returns how it was."""
    path = runs / name / "selection.jsonl"
    before = path.read_text()
    path.write_text(json.dumps(json.loads(before) | fields))
    return path, before


def collected(runs, setting, **fields):
    """Collect a run whose choice and settings differ: (whether it ships, what is told).

    Args:
        runs: the folder.
        setting: text of its settings, and what stands there instead.
        fields: of its choice.
    """
    path, before = change(runs, ALONE, **fields, shipped_unfit="", commit="c" * 40)
    config = runs / ALONE / "config.json"
    settings = config.read_text()
    config.write_text(settings.replace(*setting))
    try:
        (found,) = collecting.find(collecting.CollectConfig((runs,), (ALONE,)))
        return collecting.collect(found, collecting.CollectConfig((runs,)))
    finally:
        path.write_text(before)
        config.write_text(settings)


def lines(repository, name):
    return read_rows(repository / "results" / f"{name}.jsonl")


def journal(folder, *rows):
    """A suite's journal; returns its path.

    Args:
        folder: of the suite.
        rows: of each command: environment, command, GPU, when it began, seconds that it took (None: it has not ended).
    """
    told = []
    for env, command, gpu, began, seconds in rows:
        told.append({"env": env, "command": command, "gpu": gpu, "began": began})
        if seconds is not None:
            told.append({"env": env, "command": command, "seconds": seconds, "status": 0})
    path = folder / "journal.jsonl"
    path.write_text("".join(json.dumps(row) + "\n" for row in told))
    return path


def test_a_suites_time_is_that_in_which_something_ran(tmp_path):
    commands = [
        (ALONE, "train", "0", 5.0, 60.0),
        (PAIR, "coop", "1", 35.0, 90.0),
        (ALONE, "select", "0", 65.0, 10.0),
        (ALONE, "enjoy", None, 75.0, 900.0),  # films do not count
        (PAIR, "select", "1", 1125.0, 8.0),  # nor does a pause
    ]
    journal(tmp_path, *commands)
    whole = {"seconds": 128, "process_seconds": 168, "gpus": 2}
    assert whole_suite(tmp_path) == whole
    journal(tmp_path, *commands[:2], (ALONE, "select", "0", 65.0, None))
    with pytest.raises(JournalError, match=f"have not: select of {ALONE}"):
        whole_suite(tmp_path)


@pytest.mark.slow
def test_a_suite_is_kept_as_a_whole_with_its_time(runs, repository, capsys):
    words = [str(runs), "--suite", "--least", "0", "--commit", "abc"]
    assert collecting.main(words) == 2 and "0 commands that have" in capsys.readouterr().err
    assert collecting.main([*words, "--only", ALONE]) == 2
    assert "Leave out --only" in capsys.readouterr().err
    assert not lines(repository, "suite") and not lines(repository, "evaluation")
    path = journal(runs, (ALONE, "train", "1", 5.0, 62.4))
    try:
        assert collecting.main(words) == 0
    finally:
        path.unlink()
    line, other = lines(repository, "suite")
    assert line["suite"] == {"seconds": 62, "process_seconds": 62, "gpus": 1} == other["suite"]
    assert line["training"]["num_env_steps"] == 960 and "curve" not in line["training"]
    assert not lines(repository, "selection")
    for kind, name in ((suite_tables.suite, ALONE), (suite_tables.suite_pairs, PAIR)):
        table = kind(repository / "results")
        assert name in table and "evaluated in 1:02 on 1 GPU, by" in table
        assert "1 environments" in table
    newer = {**line, "time": "2099", "suite": {**line["suite"], "seconds": 125}}
    collecting.put("suite", newer, ("env", "time"))  # of a newer suite
    table = suite_tables.suite(repository / "results")
    assert "1 environments" in table and "2:05" in table and PAIR not in table
    folder = repository / "results"
    assert suite_tables.suite_gentle(folder) == markdown.NOTHING
    under = {**line["training"], "cost_limit": 0.1, "cost_multiplier_max": 0.25}
    before = {"success": 0.75, "gentle_success": 0.25}
    limited = {**newer, "time": "2100", "training": under, "shipped": before, "reported": before}
    limited |= {"suite": {**line["suite"], "seconds": 185}, "gentle_success_of_seeds": [0.5, 0.25]}
    collecting.put("suite", limited, ("env", "time"))  # of one under a cost limit
    table = suite_tables.suite_gentle(folder)
    for cell in ("| 0.1, 0.25, 0 |", "| 50, 25 |", "| 75.0%, 25.0% |", "3:05"):
        assert cell in table
    assert "2:05" in suite_tables.suite(folder)


@pytest.mark.slow
def test_what_a_suite_leaves_becomes_results(runs, repository, capsys):
    assert collecting.main([str(runs), "--least", "0", "--commit", "abc"]) == 0
    out = capsys.readouterr().out
    assert out.count("ships now (none ships, at least 0% wanted)") == 2
    assert f"benchmarks.clips {ALONE} {PAIR}" in out
    alone, pair = lines(repository, "selection")
    assert (alone["env"], pair["env"]) == (ALONE, PAIR) and alone["num_env_steps"] == 960
    training, _ = lines(repository, "seed_training")
    assert training["curve"]["env_steps"] and training["num_seeds"] == training["seeds_at_end"] == 2
    assert training["device"] and training["versions"] and training["commit"]
    (line,) = lines(repository, "evaluation")
    assert (line["policy"], line["seed"], line["success"]) == (
        "mode",
        1001,
        alone["chosen_success"],
    )
    (crossed,) = lines(repository, "crossplay")
    assert crossed["human_policy"] == "person" and crossed["env"] == PAIR
    for path in (f"{ALONE}.npz", f"{PAIR}.npz", f"human/{PAIR}.npz"):
        assert read_policy(repository / "policies" / path).info["commit"]
    folder = repository / "results"
    table = policy_tables.selections(folder)
    assert f"| {ALONE} | 2 x 0.00096 M |" in table and "not reached" in table
    assert [run["env"] for run in seed_curves.trainings(folder)] == [ALONE, PAIR]
    before = {path.name: path.read_text() for path in folder.iterdir()}
    assert collecting.main([str(runs), "--least", "0", "--commit", "abc"]) == 0
    assert {path.name: path.read_text() for path in folder.iterdir()} == before
    assert "does not ship (gently" in capsys.readouterr().out


@pytest.mark.slow
@pytest.mark.parametrize(
    ("shipped_there", "ours", "ships"), [(0.5, 0.6, True), (0.6, 0.6, False), (0.7, 0.6, False)]
)
def test_what_ships_is_replaced_by_what_is_better(shipped_there, ours, ships, runs, repository):
    kept = repository / "policies" / f"{ALONE}.npz"
    kept.write_bytes((runs / ALONE / "seed_1" / "policy.npz").read_bytes())
    was = json.loads((runs / ALONE / "selection.jsonl").read_text())["reported"]
    fields = {"reported": was | {"success": ours}, "shipped": was | {"success": shipped_there}}
    told, text = collected(runs, ("", ""), **fields)
    assert told is ships and f"what ships has {shipped_there:.1%}, gently" in text
    (line,) = lines(repository, "evaluation")  # the newest figure of what ships, whichever that is
    assert line["success"] == (ours if ships else shipped_there) and line["commit"] == "c" * 40
    config = collecting.CollectConfig((runs,), only=(ALONE,), ship=(ALONE,))
    assert all(collecting.collect(found, config)[0] for found in collecting.find(config))
    before = (repository / "results" / "evaluation.jsonl").read_text()
    kept = dataclasses.replace(config, ship=(), keep=(ALONE,))
    for found in collecting.find(kept):  # its choice tells of a policy that ships no more
        assert not collecting.collect(found, kept, replaced=True)[0]
    assert (repository / "results" / "evaluation.jsonl").read_text() == before
    now = select.trainings_of(repository / "policies" / f"{ALONE}.npz")
    assert now["robot"] | {"commit": ""} == {"env": ALONE, "commit": "", "seed": 1}
    fields["reported"] = was | {"success": 0.55}
    # the seed that ships, and one of a policy before it, whose figures count no more
    for seed, theirs in ((1, 0.99), (7, 0.2)):
        trainings = {"robot": now["robot"] | {"seed": seed}}
        fields |= {"shipped": was | {"success": theirs}, "shipped_trainings": trainings}
        told, text = collected(runs, ("", ""), **fields)
        assert not told and "what ships has 99.0%, gently" in text
        before = before if seed == 7 else (repository / "results" / "evaluation.jsonl").read_text()
    assert (repository / "results" / "evaluation.jsonl").read_text() == before
    with pytest.raises(
        collecting.CollectError, match=f"--ship and --keep name Wrong-v0. Runs to collect: {ALONE}"
    ):
        collecting.find(dataclasses.replace(config, ship=("Wrong-v0",)))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("success", "gently", "ships", "why"),
    [
        (0.86, 0.6, True, "gently 60.0%; what ships has 90.0%, gently 20.0%, over the same people"),
        (0.86, 0.23, False, "gently 23.0%"),  # 3 more gentle successes for 4 successes
        (0.98, 0.1, False, "gently 10.0%"),
        (0.7, 0.6, False, "gently 60.0%"),  # 20 successes lost
    ],
)
def test_gentle_successes_count_as_much_as_successes(success, gently, ships, why, runs, repository):
    """And choices under a cost limit are told apart from those without."""
    kept = repository / "policies" / f"{ALONE}.npz"
    kept.write_bytes((runs / ALONE / "seed_1" / "policy.npz").read_bytes())
    was = json.loads((runs / ALONE / "selection.jsonl").read_text())["reported"]
    fields = {
        "reported": was | {"success": success, "gentle_success": gently},
        "shipped": was | {"success": 0.9, "gentle_success": 0.2},
    }
    cost_limit = ('"cost_limit": null', '"cost_limit": 0.1')
    told, text = collected(runs, cost_limit, **fields)
    assert told is ships and why in text
    (line,) = lines(repository, "gentle")
    assert line["cost_limit"] == 0.1
    assert not lines(repository, "selection") and not lines(repository, "seed_training")


@pytest.mark.slow
def test_a_run_of_nobody_knows_which_code_is_refused(runs, repository, capsys):
    path, before = change(runs, ALONE, commit=None)
    try:
        assert collecting.main([str(runs), "--dry"]) == 2
        assert "--commit HASH" in capsys.readouterr().err
        assert collecting.main([str(runs), "--dry", "--commit", "abc", "--least", "0"]) == 0
    finally:
        path.write_text(before)
    assert not list((repository / "results").iterdir())  # a dry run changes nothing
    assert collecting.main([str(repository)]) == 2


@pytest.mark.slow
def test_lost_contacts_do_not_ship(runs, repository):
    path, before = change(runs, ALONE, overflow=3)
    try:
        (found,) = collecting.find(collecting.CollectConfig((runs,), (ALONE,), commit="abc"))
    finally:
        path.write_text(before)
    assert collecting.decide(found, 0.0) == (False, "contacts were lost: not a result")


@pytest.mark.parametrize(
    ("episodes", "year", "better"), [(1000, 2027, True), (500, 2027, False), (1000, 2021, False)]
)
def test_what_ships_keeps_its_figure_over_more_people(episodes, year, better):
    line = {"env": ALONE, "episodes": episodes, "time": f"{year}-01-01T00:00:00+00:00"}
    found = SimpleNamespace(recorded=line)
    assert collecting.known_better(found, {"episodes": 500}) is better
    assert not collecting.known_better(SimpleNamespace(recorded=None), {"episodes": 500})


@pytest.mark.slow
def test_what_ships_is_to_be_measured_again_after_the_physics_changed(runs, repository):
    kept = repository / "policies" / f"{ALONE}.npz"
    kept.write_bytes((runs / ALONE / "seed_1" / "policy.npz").read_bytes())
    before = {"env": ALONE, "success": 0.0, "time": "2026-11-21T00:00:00+00:00"}
    (repository / "results" / "evaluation.jsonl").write_text(json.dumps(before))
    (found,) = collecting.find(collecting.CollectConfig((runs,), (ALONE,), commit="abc"))
    ships, why = collecting.decide(found, 0.0)
    assert not ships and why.endswith(f"benchmarks.shipped --only {ALONE}")


@pytest.mark.slow
def test_a_run_of_other_settings_becomes_no_result(runs, repository, capsys):
    path, before = change(runs, ALONE, changes={"humans.sizes": "continuous"})
    try:
        assert collecting.main([str(runs), "--least", "0", "--commit", "abc"]) == 2
    finally:
        path.write_text(before)
    assert "--humans.sizes continuous" in capsys.readouterr().err
    assert not list((repository / "results").iterdir())


@pytest.mark.slow
@pytest.mark.parametrize(("plain", "ships"), [(0.5, True), (0.7, False), (None, True)])
def test_policies_with_a_memory_ship_beside_those_without(plain, ships, runs, repository):
    if plain is not None:
        figures = {"success": plain, "gentle_success": 0.0, "time": "2027-01-01T00:00:00"}
        row = {"env": ALONE, "policy": "mode", **figures}
        (repository / "results" / "evaluation.jsonl").write_text(json.dumps(row))
        (repository / "policies" / f"{ALONE}.npz").write_bytes(b"the one without")
    reported = {"success": 0.6, "gentle_success": 0.0, "overflow": 0, "env": ALONE, "episodes": 16}
    fields = {"changes": {"memory": [0.3, 4.0]}, "reported": reported, "shipped": None}
    assert collected(runs, ("", ""), **fields)[0] == ships
    (line,) = lines(repository, "memory")
    assert line["changes"] == {"memory": [0.3, 4.0]} and line["training"]["num_seeds"] == 2
    assert not lines(repository, "selection") and "curve" not in line["training"]
    file = Path("policies", "memory", f"{ALONE}.npz")
    assert (repository / file).is_file() == ships
    if plain is not None:
        assert (repository / "policies" / f"{ALONE}.npz").read_bytes() == b"the one without"
    assert len(lines(repository, "evaluation")) == (plain is not None)


@pytest.mark.slow
def test_trainings_with_restarts_have_results_of_their_own(runs, repository):
    collected(runs, ('"restart_share": 0.0', '"restart_share": 0.5'), shipped=None)
    (line,) = lines(repository, "restarts")
    assert line["restart_share"] == 0.5 and line["env"] == ALONE
    assert not lines(repository, "selection") and not lines(repository, "seed_training")


def test_a_trial_has_a_line_of_its_own_and_ships_nothing(runs, repository, capsys):
    path, before = change(runs, ALONE, shipped=None, shipped_unfit="", commit="c" * 40)
    words = [str(runs), "--only", ALONE, "--trial", "more noise"]
    try:
        assert collecting.main(words) == 0
    finally:
        path.write_text(before)
    assert "does not ship (a trial)" in capsys.readouterr().out
    (line,) = lines(repository, "trials")
    assert (line["trial"], line["env"], line["seeds"]) == ("more noise", ALONE, [1, 2])
    for other in ("selection", "seed_training", "evaluation"):
        assert not lines(repository, other)
    assert not list((repository / "policies").rglob("*.npz"))
    for other in (["--suite"], ["--ship", ALONE]):
        assert collecting.main([*words, *other]) == 2
        assert "Leave out --suite and --ship" in capsys.readouterr().err


def test_tables_leave_out_results_of_other_settings(tmp_path):
    usual = {"env": ALONE, "success": 0.9, "overflow": 0}
    others = [{"changes": {"episode_length": 50}}, {"other_than_in_training": "x"}]
    rows = [usual, *(usual | {"success": 0.1} | x for x in others)]
    (tmp_path / "evaluation.jsonl").write_text("".join(json.dumps(x) + "\n" for x in rows))
    assert markdown.read_results("evaluation", ("env",), tmp_path) == [usual]


@pytest.mark.slow
def test_the_picture_is_drawn_when_what_it_shows_has_changed(runs, tmp_path, capsys):
    results, picture = tmp_path / "results", tmp_path / "curves.png"
    results.mkdir()
    assert seed_curves.main(["--check"], results, picture) == 0  # nothing to show
    file = results / "seed_training.jsonl"
    summary = training_summary(runs / ALONE)
    file.write_text(json.dumps(summary) + "\n")
    assert seed_curves.main(["--check"], results, picture) == 1
    assert seed_curves.main([], results, picture) == 0 and picture.stat().st_size > 5_000
    assert seed_curves.main(["--check"], results, picture) == 0
    file.write_text(json.dumps(summary | {"num_seeds": 8}) + "\n")
    assert seed_curves.main(["--check"], results, picture) == 1
    assert "benchmarks.seed_curves" in capsys.readouterr().err


def test_the_curve_that_is_kept():
    row = {"success": None, "env_steps": 1, "seconds": 0.5}
    later = [
        {"success": x, "success_low": x - 0.01, "env_steps": 1234567 * i, "seconds": 1.23456 * i}
        for i, x in enumerate((0.5, 0.91234, 0.8), 1)
    ]
    curve = reduced_curve([row, *later])
    assert curve["success"] == [0.5, 0.9123, 0.8] and curve["env_steps"][0] == 1234567
    assert first_time(curve) == (2469134, 2.469) and first_time(curve, 0.95) is None
    assert first_time(reduced_curve([row])) is None
    assert np.allclose(curve["success_low"], [0.49, 0.9023, 0.79])


def test_the_results_of_this_repository_are_whole():
    for line in seed_curves.trainings(markdown.RESULTS):
        assert line["commit"] and line["device"]["kind"] and line["versions"]["jax"], line["env"]
        assert len(line["curve"]["success"]) == len(line["curve"]["success_low"]) > 10
    for line in markdown.read_results("selection", ("env",)):
        assert line["commit"] and line["chosen_over"] != line["reported_over"]
    assert set(shipped.shipped()) <= shipped.recorded().keys()


@pytest.mark.parametrize(
    ("name", "robot", "person", "expected"),
    [
        (ALONE, None, None, False),
        (ALONE, "shipped", None, True),
        (PAIR, "shipped", None, False),  # the person was new
        (PAIR, "shipped", "a.npz", True),
    ],
)
def test_a_training_goes_on_if_nobody_who_learns_is_new(name, robot, person, expected):
    about = {"started_from": robot, "person_started_from": person}
    assert collecting.Found(Path(name), {}, about).continued is expected


@pytest.mark.slow
def test_what_went_on_with_a_policy_is_told_apart_from_what_began_with_nothing(runs, repository):
    kept = repository / "policies" / f"{ALONE}.npz"
    kept.write_bytes((runs / ALONE / "seed_1" / "policy.npz").read_bytes())
    was = json.loads((runs / ALONE / "selection.jsonl").read_text())["reported"]
    fields = {"reported": was | {"success": 0.6}, "shipped": was | {"success": 0.5}}
    told, _ = collected(runs, ('"robot_policy": null', '"robot_policy": "shipped"'), **fields)
    assert told
    (line,) = lines(repository, "continued")
    assert line["started_from"] == "shipped" and line["cost_limit"] is None
    assert line["statistics"] == "kept"  # by what the policy normalises its observation
    assert not lines(repository, "selection") and not lines(repository, "seed_training")
    (row,) = continued_tables.continued(repository / "results").splitlines()[2:3]
    assert row.startswith(f"| {ALONE} | 2 x 0.00096 M |") and row.endswith("| 50.0% |")


@pytest.mark.slow
def test_a_setting_of_a_sweep_is_collected_as_a_run(runs, tmp_path):
    sweep = tmp_path / "sweeps" / ALONE
    setting = sweep / "lr=0.001"
    shutil.copytree(runs / ALONE, setting)
    about = json.loads((setting / "config.json").read_text())
    (sweep / "config.json").write_text(json.dumps(about))
    run = setting_as_run(setting, tmp_path / "runs")
    changed = json.loads((run / "config.json").read_text())["config"]
    assert changed["lr"] == 0.001 and changed["num_seeds"] == 2
    rows, before = read_rows(run / "curve.jsonl"), read_rows(runs / ALONE / "curve.jsonl")
    assert [row["env_steps"] for row in rows] == [row["env_steps"] for row in before]
    assert rows[-1]["return"] == pytest.approx(before[-1]["return"])
    (found,) = collecting.find(collecting.CollectConfig((tmp_path / "runs",), commit="c" * 40))
    assert found.training["num_seeds"] == 2 and not found.continued


@pytest.mark.slow
def test_of_a_seed_that_diverged_the_curve_has_the_rows_it_made(runs, tmp_path):
    setting = tmp_path / ALONE / "use_linear_lr_decay=0"
    shutil.copytree(runs / ALONE, setting)
    shutil.copy(runs / ALONE / "config.json", setting.parent)
    curve = setting / "seed_2" / "curve.jsonl"
    curve.write_text(curve.read_text().splitlines()[0] + "\n")
    run = setting_as_run(setting, tmp_path / "runs")
    rows = read_rows(run / "curve.jsonl")
    assert [rows[0]["num_seeds"], rows[-1]["num_seeds"]] == [2, 1]
    settings = json.loads((run / "config.json").read_text())["config"]
    assert settings["use_linear_lr_decay"] is False
    with pytest.raises(SettingError, match="exists"):
        setting_as_run(setting, tmp_path / "runs")


@pytest.mark.slow
def test_what_is_no_setting_is_refused(runs, tmp_path):
    with pytest.raises(SettingError, match="no setting of a sweep"):
        setting_as_run(runs / ALONE, tmp_path)
