"""Tables of ``benchmarks.tables`` about policies: what those that ship achieve, how they were chosen, who gets along."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from operator import itemgetter
from pathlib import Path

from agym_jax.data.assets import asset_root
from agym_jax.data.npz import read_npz
from agym_jax.errors import ArgumentError
from agym_jax.policy.policy import shipped
from agym_jax.registry import static_id
from benchmarks.markdown import (
    NOTHING,
    RESULTS,
    Line,
    former,
    grid,
    mark,
    matrix,
    read_results,
    several,
    table,
)
from train.runs import overview
from train.runs.progress import duration

COMMIT = 7
"""Characters of a commit that results and policies agree on."""
FEW = 6
"""Names that are listed."""
THERE = "in-assistive-gym"
"""Kind of results that were measured in Assistive Gym."""
MANY = 500
"""Episodes from which on a tenth of a percent is told: so many round 99.5 % to no 100 %."""


def _share(value: float, episodes: int) -> str:
    """A share of episodes."""
    return f"{value:.1%}" if episodes >= MANY else f"{value:.0%}"


def _success(line: Line) -> str:
    """Share of successes and its 95 % interval."""
    mean, low, high = (
        _share(line[name], line["episodes"]) for name in ("success", "success_low", "success_high")
    )
    return f"{mean} ({low} to {high})"


Training = tuple[str, str, int | None]
"""Of a policy: environment, beginning of the commit, seed."""
TRAININGS = {
    "suite": "one of the suite",
    "selection": "an earlier one",
    "gentle": "one made gentle",
    "continued": "a continued one",
    "restarts": "one with restarts",
    "not_shipped": "an earlier one",
}
"""Results that tell of which training a policy comes -> what a policy from them is called that is not the row's."""


def _training(line: Line) -> Training:
    """That of the seed that was chosen."""
    return line["env"], line.get("policy_commit", line["commit"])[:COMMIT], line["chosen"]


def shipped_trainings(folder: Path = RESULTS) -> dict[str, tuple[Training, str | None, int]]:
    """Environment -> training of the policy that ships, the results that it is in (None: no line), and its number of seeds."""
    chosen = {
        _training(x): (name, len(x["seeds"]))
        for name in TRAININGS
        for x in read_results(name, ("env", "commit", "policy_commit", "chosen"), folder)
        if "chosen" in x
    }
    found = {}
    for path in sorted((asset_root() / "policies").glob("*.npz")):
        info = read_npz(path)[1]
        key = (str(info.get("env")), str(info.get("commit"))[:COMMIT], info.get("seed"))
        name, count = chosen.get(key, (None, 0))
        found[path.stem] = (key, name, count)
    return found


def chosen_among(folder: Path = RESULTS) -> str:
    """Among how many seeds each shipped policy was chosen, in a sentence.

    Raises:
        ArgumentError: the results have no line of a policy's training.
    """
    among: dict[int, list[str]] = {}
    for env, ((_, commit, seed), name, count) in shipped_trainings(folder).items():
        if name is None:
            raise ArgumentError(
                f"{env}: no result line tells of the training of its policy (commit {commit}, seed {seed})."
            )
        among.setdefault(count, []).append(env.removesuffix("-v0"))
    parts = []
    for count, names in sorted(among.items(), reverse=True):
        listed = ", ".join(names) if len(names) <= FEW else str(len(names))
        are = "is" if len(names) == 1 else "are"
        parts.append(f"{listed} {are} the best of {count} seeds")
    return f"Of {sum(map(len, among.values()))} shipped policies, {'; '.join(parts)}."


def success(folder: Path = RESULTS) -> str:
    """How often shipped policies succeed, and how often gently, by task and robot."""
    lines = read_results("evaluation", ("env", "policy"), folder)
    mode = [x for x in lines if x["policy"] == "mode" and x["env"] in shipped()]
    usual = mode and Counter(x["episodes"] for x in mode).most_common(1)[0][0]

    def cell(x: Line) -> str:
        noted = f" of {x['episodes']:,}" if x["episodes"] != usual else ""
        gently = f" / {x['gentle_success']:.1%}" if "gentle_success" in x else ""
        return _share(x["success"], x["episodes"]) + gently + noted

    note = (
        "Episodes of the shipped policies that succeed / that also never exceed the [comfort limits](docs/care.md) of force, "
        f"{usual:,} episodes each unless noted;"
    )
    return matrix(mode, cell, note)


def policies(folder: Path = RESULTS) -> str:
    """What shipped policies achieve: the mode's figures."""
    lines = read_results("evaluation", ("env", "policy"), folder)
    columns = {
        "environment": lambda x: x["env"],
        "episodes": lambda x: f"{x['episodes']:,}",
        "return": lambda x: f"{x['return_mean']:.1f} ± {x['return_std']:.1f}",
        "mean force on the person": lambda x: f"{x['force_mean']:.2f} N",
        "success (95 % interval)": _success,
    }
    mode = [x for x in lines if x["policy"] == "mode" and x["env"] in shipped()]
    return table(mode, columns, itemgetter("env"), "Deterministic policy (mode);")


def selections(folder: Path = RESULTS) -> str:
    """What all seeds of a setting achieve, the one that was chosen over other people, and what training cost."""
    lines = sorted(read_results("selection", ("env",), folder), key=itemgetter("env"))
    trainings = {x["env"]: x for x in read_results("seed_training", ("env",), folder)}

    def training(line: Line) -> Line | None:
        found = trainings.get(line["env"])
        return found if found and found["time"] == line.get("training_time") else None

    if not lines:
        return NOTHING
    ships = shipped_trainings(folder)

    def policy(line: Line) -> str:
        key, name, _ = ships.get(line["env"], (None, None, 0))
        if key == _training(line):
            return "the chosen one"
        return TRAININGS[name] if name else ""

    of = [training(line) for line in lines]
    rows = [[*row, policy(line)] for row, line in zip(rows_of_seeds(lines, of), lines, strict=True)]
    episodes = several(f"{x['episodes']:,}" for x in lines)
    took = sum(x["wall_seconds"] or x["train_seconds"] for x in of if x)
    note = f"{episodes} episodes of each seed, mode; all trainings one after another: {duration(took)};"
    return grid([(*overview.HEADINGS, "the policy that ships"), *rows], lines, note)


def rows_of_seeds(lines: Sequence[Line], trainings: Sequence[Line | None]) -> list[list[str]]:
    """Rows under ``overview.HEADINGS``, with a sign where the physics has changed since."""
    return signed([overview.cells(*both) for both in zip(lines, trainings, strict=True)], lines)


def signed(rows: Sequence[Sequence[str]], lines: Sequence[Line]) -> list[list[str]]:
    """Rows, with a sign after the environments of which the physics has changed since."""
    sign = mark(lines)
    return [[row[0] + sign(line), *row[1:]] for row, line in zip(rows, lines, strict=True)]


def seeds_and_steps(line: Line) -> str:
    """How many seeds were trained, and for how many steps each."""
    more = (line.get(name) for name in ("candidates", "restart_share"))
    return overview.seeds_and_steps(len(line["seeds"]), line["num_env_steps"], *more)


def worst_and_mean(line: Line) -> str:
    """Success of the worst seed, and the interquartile mean."""
    return f"{min(line['success_of_seeds']):.1%}, {line['success_iqm']:.1%}"


def seeds_in_percent(values: Sequence[float]) -> str:
    """The shares of all seeds."""
    return ", ".join(f"{100 * x:.3g}" for x in values)


def not_shipped(folder: Path = RESULTS) -> str:
    """What chosen policies that do not ship achieve: elsewhere too, beside those that ship."""
    tried = read_results("not_shipped", ("kind", "env", "policy"), folder)
    ships = {x["env"]: x for x in read_results("in_assistive_gym", ("env",), folder)}
    elsewhere = {x["env"] for x in tried if x["kind"] == THERE}
    beside = [x | {"policy": "the one that ships"} for x in ships.values() if x["env"] in elsewhere]

    def there(x: Line) -> bool:
        return x["kind"] == THERE

    columns = {
        "environment": lambda x: x["env"],
        "policy": lambda x: x["policy"],
        "in": lambda x: "Assistive Gym" if there(x) else "agym_jax",
        "success": lambda x: (
            f"{x['successes']} of {x['episodes']}" if there(x)
            else f"{_share(x['success'], x['episodes'])} of {x['episodes']:,}"
        ),
        "gentle success": lambda x: "" if there(x) else _share(x["gentle_success"], x["episodes"]),
        "peak force of 99 % of episodes at most": lambda x: "" if there(x) else f"{x['peak_99']:.0f} N",
    }  # fmt: skip
    return table([*tried, *beside], columns, lambda x: (x["env"], there(x), x["policy"]))


def sweeps(folder: Path = RESULTS) -> str:
    """Success of the settings that were compared with several seeds each, at the end of training."""
    lines = read_results("sweeps", ("env", "num_env_steps", "time"), folder)
    kept = {(x["env"], x["num_env_steps"], _swept(x)): x for x in lines}  # the newest
    rows = [
        {**x, "rank": i, **setting}
        for x in kept.values()
        for i, setting in enumerate(x["ranking"])
        if x["num_seeds"] > 1
    ]
    columns = {
        "environment": lambda x: x["env"],
        "seeds": lambda x: x["num_seeds"],
        "steps of each": _steps,
        "setting": lambda x: ", ".join(f"{k} {v:g}" for k, v in x["setting"].items()),
        "success while training: IQM": lambda x: f"{x['success_iqm']:.1%}",
        "worst": lambda x: f"{x['worst']:.1%}",
        "gentle success": lambda x: f"{x['gentle_iqm']:.1%}",
        "median peak force": lambda x: f"{x['peak_iqm']:.0f} N",
    }
    note = "1,024 environments of each seed, all side by side in one program; sampled actions;"
    return table(rows, columns, itemgetter("env", "num_env_steps", "time", "rank"), note)


def _swept(line: Line) -> tuple[str, ...]:
    """Names of the hyperparameters that a sweep varied or set."""
    return tuple(sorted({name for x in line["ranking"] for name in x["setting"]}))


def _steps(line: Line) -> str:
    """Steps of a training, and of how many it was cut off."""
    made, planned = (line[name] / 1e6 for name in ("num_env_steps", "planned_env_steps"))
    return f"{made:.1f} M" if made > 0.98 * planned else f"{made:.1f} of {planned:.1f} M"


def together(folder: Path = RESULTS) -> str:
    """What robots and people who learned together achieve, and a robot that learned without such a person."""
    lines = read_results("crossplay", ("env", "human_policy"), folder)
    alone = read_results("evaluation", ("env", "policy"), folder)
    robots = {x["env"]: x for x in alone if x["policy"] == "mode" and x["env"] in shipped()}

    def robot(env: str) -> str:
        x = robots.get(static_id(env))
        return f"{x['success']:.0%}, {x['return_mean']:.0f}" if x else ""

    columns = {
        "environment": lambda x: x["env"],
        "episodes": lambda x: f"{x['episodes']:,}",
        "success (95 % interval)": _success,
        "return": lambda x: f"{x['return_mean']:.0f} ± {x['return_std']:.0f}",
        "mean force on the person": lambda x: f"{x['force_mean']:.1f} N",
        "robot trained with a passive person": lambda x: robot(x["env"]),
    }
    both = [x for x in lines if x["human_policy"] is not None and x["env"] in shipped()]
    note = "Deterministic policies (mode); last column: success, return;"
    return table(both, columns, itemgetter("env"), note)


def seeds(folder: Path = RESULTS) -> str:
    """How robots and people of different trainings of the same pair get along."""
    lines = read_results("seeds", ("env", "robot_policy", "human_policy"), folder)
    if not lines:
        return NOTHING
    of = {(x["robot_policy"], x["human_policy"]): x for x in lines}
    robots, humans = ({x[name]: None for x in lines} for name in ("robot_policy", "human_policy"))

    def cell(robot: str, human: str | None) -> str:
        return f"{of[robot, human]['success']:.0%}, {of[robot, human]['return_mean']:.0f}"

    head = ["robot \\ person", *(human or "passive" for human in humans)]
    rows = [[robot, *(cell(robot, human) for human in humans)] for robot in robots]
    env = several(x["env"] for x in lines if x["human_policy"])
    episodes = several(f"{x['episodes']:,}" for x in lines)
    note = f"{env}: success, return; {episodes} episodes each;"
    return grid([head, *rows], lines, note)


def in_assistive_gym(folder: Path = RESULTS) -> str:
    """Success of policies in Assistive Gym itself, beside that here."""
    here = {x["env"]: x for x in read_results("evaluation", ("env",), folder)}

    def share(x: Line) -> float:
        return x["successes"] / x["episodes"]

    def said(x: Line) -> str:
        return former(here[x["env"]].get("policy_commit"), x["commit"])

    def there(x: Line) -> str:
        return f"{x['successes']} of {x['episodes']}{said(x)}"

    def ratio(x: Line) -> str:
        return "" if said(x) else f"{share(x) / here[x['env']]['success']:.0%}"

    columns = {
        "environment": lambda x: x["env"],
        "success in Assistive Gym": there,
        "success here": lambda x: f"{here[x['env']]['success']:.0%}",
        "share of it": ratio,
    }
    lines = read_results("in_assistive_gym", ("env",), folder)
    return table(
        lines, columns, lambda x: -share(x), "Commits are those that trained the policies;"
    )
