"""Results of a suite into this repository: ``python -m benchmarks.collect RUNS ... [--only NAME ...] [--dry]``.

RUNS are folders that ``agym-jax suite`` had as ``--save-dir``. Of each run whose seeds were measured, the choice
(``results/selection.jsonl``), what training was (``results/seed_training.jsonl``) and what the chosen policy achieves
over other people are kept. The chosen policy replaces the one that ships where the sum of its successes and its gentle successes is
larger and at most 5 of 100 successes are lost, over the same people in
the same physics if ``select`` measured both; where none ships, from ``--least`` on. Choice and limit of runs under a cost limit are in ``results/gentle.jsonl``.
Of runs that began with a policy (``--robot-policy``; of pairs, ``--human-policy`` too), the choice is in ``results/continued.jsonl``. What training both
of these were is in ``results/continued_training.jsonl``. Runs with a memory (``--memory``), also those of a suite, are kept in
``results/memory.jsonl``; their policies ship in a folder of their own, if the memory is that of the others there and they are better than those without. With ``--trial``, what was tried and the choice are kept in
``results/trials.jsonl``, and nothing ships. With ``--suite``, all runs are kept in ``results/suite.jsonl``, as those of one command. Then the tables and the picture of the curves are made anew.
Collecting the same runs again changes nothing.
"""

from __future__ import annotations

import dataclasses
import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro

from agym_jax.changes import flags_of
from agym_jax.data.npz import write_file
from agym_jax.errors import AgymError
from agym_jax.memory import MEMORY, SHIPPED
from agym_jax.policy.files import FILE_NAMES
from agym_jax.policy.policy import read_policy, save_policy, shipped_folder
from agym_jax.registry import parse
from benchmarks import seed_curves, tables
from benchmarks.journal import whole_suite
from benchmarks.markdown import RESULTS, Line, is_earlier
from benchmarks.memory_tables import run_of
from benchmarks.restart_tables import usual_restarts
from benchmarks.shipped import recorded
from benchmarks.trained import statistics
from train.runs.overview import read_rows, selection_of, training_summary
from train.select import trainings_of

POLICIES = RESULTS.parent.parent / "assets" / "policies"
FOR_GENTLENESS = 0.05
"""Success that a policy may lack, compared with the one that it replaces."""
LARGEST = 1_000_000  # bytes of a policy file; the largest networks take 740 kB
ABOUT = "cost_limit", "cost_multiplier_max", "cost_margin", "started_from", "person_started_from", "candidates", "restart_share"  # fmt: skip
"""Fields of a training that its choice is kept with, if it had a cost limit, a memory or restarts, or began with a policy."""
MEASURED = ("commit", "device", "versions", "time", "impl")
"""Fields of a choice that hold for everything measured with it."""


class CollectError(AgymError, ValueError):
    """Runs that cannot become results."""


@dataclass(frozen=True)
class CollectConfig:
    """Flags of ``python -m benchmarks.collect``."""

    runs: Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="RUNS ...")]
    """Folders of runs, each the --save-dir of a suite."""
    only: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME ...")] = ()
    """Parts of ids; without them, all runs in the folder."""
    commit: str | None = None
    """Commit of the code that ran, for runs of a machine without git."""
    least: float = 0.4
    """Success from which a policy ships where none does."""
    ship: Annotated[tuple[str, ...], tyro.conf.arg(metavar="ID ...")] = ()
    """Ids whose chosen policy ships although the one that ships is better. The documentation has to say why."""
    keep: Annotated[tuple[str, ...], tyro.conf.arg(metavar="ID ...")] = ()
    """Ids whose policy stays although the chosen one is better. The documentation has to say why."""
    suite: bool = False
    """Keep the runs as those of one suite, with the time of the whole; the rows of the results over seeds stay as they are."""
    trial: str | None = None
    """Keep the runs as trials of something that is not what the id is trained with, in these words; nothing ships."""
    dry: bool = False
    """Say what would be done, and change nothing."""


@dataclass(frozen=True)
class Found:
    """A run whose seeds were measured.

    Attributes:
        run: its folder.
        choice: line of ``select``.
        training: from ``training_summary``.
        suite: from ``whole_suite``, if it is kept as one of a suite.
        memory: of its policies [s], see ``agym_jax.memory``.
    """

    run: Path
    choice: Line
    training: Line
    suite: Line | None = None
    memory: tuple[float, ...] = ()

    @property
    def ships_in(self) -> Path:
        """Folder of the policies that ship, among which its own would be."""
        return POLICIES.parent / shipped_folder(bool(self.memory))

    @property
    def file(self) -> Path:
        """Of the policy that ships."""
        return self.ships_in / f"{self.run.name}.npz"

    @property
    def recorded(self) -> Line | None:
        """What is recorded of the policy that ships."""
        if not self.memory:
            return recorded().get(self.run.name)
        run = run_of(self.run.name, read_policy(self.file).info, RESULTS)
        return run and run["reported"] | {"time": run["time"]}

    @property
    def replaced(self) -> bool:
        """Whether the policy that its choice was compared with ships no more; choices before 29 November 2026, 21:00 UTC, do not tell."""
        told, human = self.choice.get("shipped_trainings"), self.ships_in / "human" / self.file.name
        there = [x if x.is_file() else None for x in (self.file, human)]
        return bool(told) and told != trainings_of(*there)

    @property
    def gentle(self) -> bool:
        """Whether it was trained under a cost limit."""
        # of runs whose settings were lost, the choice tells
        return self.training.get("cost_limit") is not None or bool(self.choice.get("chosen_gently"))

    @property
    def continued(self) -> bool:
        """Whether it went on with the policies of all who learn: what its seeds achieve says nothing of a training from nothing."""
        begun = [self.training["started_from"]]
        if parse(self.run.name).active:
            begun.append(self.training["person_started_from"])
        return all(begun)


def find(config: CollectConfig) -> list[Found]:
    """The runs of a folder that have a choice among their seeds.

    Raises:
        CollectError: there are none, the suite has not ended, one has other settings than its id, or nobody knows with which commit they were made.
    """
    if config.trial and (config.suite or config.ship):
        raise CollectError(
            "A trial is not of a suite, and ships nothing. Leave out --suite and --ship."
        )
    if config.suite and config.only:
        raise CollectError(
            "--suite keeps all runs of a suite, with the time of the whole. Leave out --only."
        )
    found = []
    wholes = {folder: whole_suite(folder) for folder in config.runs if config.suite}
    folders = [path for folder in config.runs for path in folder.glob("*-v0") if path.is_dir()]
    for run in sorted(folders, key=lambda path: path.name):
        choice, training = selection_of(run), training_summary(run)
        if choice and training and (not config.only or any(x in run.name for x in config.only)):
            changes = dict(choice.get("changes") or {})
            memory = tuple(changes.pop(MEMORY, ()))
            if changes:
                raise CollectError(
                    f"{run} was trained with other settings than its id's ({flags_of(changes)}). Tables and what ships are of "
                    f"the ids as they are. Take it out of the folder, or name the others with --only."
                )
            commit = choice["commit"] or _known_commit(choice) or config.commit
            if not commit:
                raise CollectError(
                    f"{run} was made on a machine without git. Say with which commit: --commit HASH."
                )
            for name in MEASURED:  # config.json may have been lost on the way
                training[name] = training[name] or choice[name]
            training["commit"] = commit
            chosen = read_policy(run / FILE_NAMES["robot"]).info
            about = {
                "policy_commit": chosen.get("commit") or commit,
                "training_time": training["time"], "num_env_steps": training["num_env_steps"],
                "num_envs": training["num_envs"], "commit": commit,
            }  # fmt: skip
            found.append(Found(run, choice | about, training, wholes.get(run.parent), memory))
    if unknown := {*config.ship, *config.keep} - {x.run.name for x in found}:
        there = ", ".join(x.run.name for x in found) or "none"
        raise CollectError(
            f"--ship and --keep name {', '.join(sorted(unknown))}. Runs to collect: {there}."
        )
    if not found:
        raise CollectError(
            f"{', '.join(map(str, config.runs))} has no runs with selection.jsonl, config.json and curve.jsonl."
        )
    return found


def _known_commit(choice: Line) -> str | None:
    """The commit under which the same choice was kept before."""
    rows = read_rows(RESULTS / "selection.jsonl")
    return next((x["commit"] for x in rows if _same(x, choice, ("env", "time"))), None)


def _same(a: Line, b: Line, keys: Sequence[str]) -> bool:
    return all(a.get(key) == b.get(key) for key in keys)


def put(name: str, line: Line, keys: Sequence[str]) -> None:
    """Add a line to a file of results, or replace the one that agrees with it in ``keys``."""
    path = RESULTS / f"{name}.jsonl"
    text = path.read_text() if path.is_file() else ""
    rows = [json.loads(row) for row in text.splitlines() if row.strip()]
    at = next((i for i, row in enumerate(rows) if _same(row, line, keys)), len(rows))
    rows[at : at + 1] = [line]
    text = "".join(json.dumps(row, sort_keys=True) + "\n" for row in rows)
    write_file(path, text.encode())


def evaluation(found: Found, summary: Line, policy: Line) -> tuple[str, Line]:
    """The line that says what a policy achieves over the people of the report, and the file for it.

    Args:
        found: the run.
        summary: of the evaluation.
        policy: ``info`` of the policy.
    """
    line = {
        **summary,
        **{name: found.choice[name] for name in MEASURED},
        "policy": "mode", "deterministic": True, "seed": found.choice["reported_over"],
        "policy_commit": policy.get("commit") or found.choice["commit"],
        "policy_env_steps": policy.get("env_steps"),
    }  # fmt: skip
    if parse(found.run.name).active:
        return "crossplay", line | {
            "kind": "crossplay", "robot_policy": "robot", "human_policy": "person",
        }  # fmt: skip
    return "evaluation", line | {"kind": "evaluation"}


def reported(choice: Line) -> Line:
    """What the chosen policy achieves over other people, also of runs that kept less of it."""
    whole = choice.get("reported")
    if whole:
        return whole
    prefix = "chosen_"
    kept = {
        key.removeprefix(prefix): value for key, value in choice.items() if key.startswith(prefix)
    }
    kept.pop("over")
    return kept | {name: choice[name] for name in ("env", "episodes", "nan_episodes", "overflow")}


def known_better(found: Found, summary: Line) -> bool:
    """Whether more episodes of what ships are recorded than this evaluation has, in the present physics."""
    known = found.recorded
    return bool(known) and not is_earlier(known) and known.get("episodes", 0) > summary["episodes"]


def decide(found: Found, least: float, replaced: bool = False) -> tuple[bool, str]:
    """Whether the chosen policy is to ship, and why; ``replaced`` as for ``collect``."""
    name, ours = found.run.name, reported(found.choice)
    if ours["overflow"] or found.choice["overflow"]:
        return False, "contacts were lost: not a result"
    if found.memory not in ((), SHIPPED):
        return False, f"policies with a memory ship with {SHIPPED} alone"
    if not found.memory and not found.file.is_file():
        return ours["success"] >= least, f"none ships, at least {least:.0%} wanted"
    theirs, where = found.choice.get("shipped"), "the same people"
    if found.memory and not found.file.is_file():
        theirs, where = recorded().get(name), "the recorded evaluation of the one without a memory"
    elif found.choice.get("shipped_unfit") and not replaced:
        return ours["success"] >= least, "what ships fits no more"
    elif replaced or not theirs:
        theirs, where = found.recorded, "its recorded evaluation"
    if not theirs:
        return ours["success"] >= least, "what ships was never measured"
    if is_earlier(theirs):
        again = f"python -m benchmarks.shipped --only {name}"
        return False, f"what ships was measured in an earlier physics; again: {again}"
    known = "gentle_success" in ours and "gentle_success" in theirs
    gently, theirs_gently = (x["gentle_success"] if known else 0.0 for x in (ours, theirs))
    gain = round(ours["success"] - theirs["success"], 6)  # of shares of some thousand episodes
    ships = gain >= -FOR_GENTLENESS and round(gain + gently - theirs_gently, 6) > 0
    return ships, (
        f"gently {gently:.1%}; what ships has {theirs['success']:.1%}, gently {theirs_gently:.1%}, over {where}"
    )


def ship(found: Found) -> Line:
    """Copy the chosen policies to those that ship; returns the ``info`` of the robot's.

    Raises:
        CollectError: a file is too large, or of another environment.
    """
    name, policies = found.run.name, {}
    for agent, target in (("human", found.ships_in / "human"), ("robot", found.ships_in)):
        source = found.run / FILE_NAMES[agent]
        if agent == "human" and not parse(name).active:
            continue
        policy = read_policy(source)  # checks that it is whole, and never unpickles
        if source.stat().st_size > LARGEST or policy.info["env"] != name:
            raise CollectError(
                f"{source} is of {policy.info['env']} and has {source.stat().st_size:,} bytes; expected "
                f"{name} and at most {LARGEST:,}."
            )
        info = {**policy.info, "commit": found.choice["policy_commit"]}
        policies[target / f"{name}.npz"] = dataclasses.replace(policy, info=info)
    for file, policy in policies.items():  # both of a pair, or neither
        save_policy(file, policy)
    return dict(policy.info)


def collect(found: Found, config: CollectConfig, replaced: bool = False) -> tuple[bool, str]:
    """Keep one run; returns whether its policy ships now, and a line about it.

    Args:
        found: the run.
        config: flags.
        replaced: whether the policy that its choice was compared with ships no more.
    """
    name, choice, replaced = found.run.name, found.choice, replaced or found.replaced
    ships, why = decide(found, config.least, replaced)
    if name in config.ship and not reported(choice)["overflow"]:
        ships, why = True, f"--ship; {why}"
    if name in config.keep:
        ships, why = False, f"--keep; {why}"
    if config.trial:
        ships, why = False, "a trial"
    if not config.dry:
        about = {name: found.training[name] for name in ABOUT} | statistics(found.training)
        training = {name: x for name, x in found.training.items() if name != "curve"}
        if config.trial:
            put("trials", {**choice, **about, "trial": config.trial}, ("env", "time"))
        elif found.memory:
            put("memory", {**choice, **about, "training": training}, ("env", "time"))
        elif found.suite:
            line = {**choice, "training": training, "suite": found.suite}
            put("suite", line, ("env", "time"))
        elif found.gentle or found.continued:
            put("gentle" if found.gentle else "continued", {**choice, **about}, ("env", "time"))
            put("continued_training", found.training, ("env", "time"))
        elif found.training["restart_share"] != usual_restarts(name):
            put("restarts", {**choice, **about}, ("env", "time"))
        else:
            put("selection", choice, ("env", "time"))
            put("seed_training", found.training, ("env", "time"))
        info: dict[str, Any] = {}
        summary = reported(choice)
        if ships:
            info = ship(found)
        elif found.file.is_file() and choice.get("shipped") and not replaced:
            summary = choice["shipped"]
            info = {} if known_better(found, summary) else dict(read_policy(found.file).info)
        if info and not found.memory and not config.trial:
            put(*evaluation(found, summary, info), ("env", "time", "policy", "human_policy"))
    low, high = choice["success_iqm_low"], choice["success_iqm_high"]
    verb = "ships now" if ships else "does not ship"
    return ships, (
        f"{name:<28} {len(choice['seeds'])} seeds: worst {min(choice['success_of_seeds']):6.1%}, interquartile "
        f"mean {choice['success_iqm']:6.1%} ({low:.1%} to {high:.1%}); seed {choice['chosen']} "
        f"{reported(choice)['success']:6.1%}: {verb} ({why})"
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit status."""
    config = tyro.cli(CollectConfig, prog="python -m benchmarks.collect", args=arguments)
    try:
        new: list[Path] = []
        for found in find(config):
            ships, text = collect(found, config, found.file in new)
            new += [found.file] * ships
            print(text, flush=True)
    except AgymError as error:
        print(f"{type(error).__name__}: {error}", file=sys.stderr)
        return 2
    if not config.dry:
        tables.main([])
        seed_curves.main([])
        if new:
            print(
                f"Their films are to be made anew: python -m benchmarks.clips {' '.join(x.stem for x in new)}"
            )
    return 0


if __name__ == "__main__":
    sys.exit(main())
