"""One page for each environment id, and their index: from the records of tasks and robots, and from results."""

from __future__ import annotations

import inspect
import os
from collections.abc import Iterator
from pathlib import Path

from agym_jax import list_envs, observe
from agym_jax.changes import settings_of, settings_table
from agym_jax.metrics import TASK_PREFIX
from agym_jax.registry import Recipe, active_id, parse, static_id
from agym_jax.robots import ROBOTS
from agym_jax.spec import Measured, Task
from agym_jax.tasks import TASKS
from benchmarks.markdown import EARLIER, Line, is_earlier, read_results
from benchmarks.policy_tables import shipped

REPLAYS = "replays"
"""Folder of the site with an episode of each shipped policy to look around in."""
CLIPS = Path(__file__).resolve().parents[2] / "docs" / "images" / "clips"
SECTION = "environments"
BEFORE = f"{EARLIER} measured before the present physics"


def pages() -> dict[str, str]:
    """Path below ``docs`` -> Markdown."""
    found = {f"{SECTION}/index.md": index()}
    return found | {f"{SECTION}/{name}.md": page(name) for name in list_envs()}


def index() -> str:
    """The gallery of all ids."""
    lines = [
        "# Environments",
        "",
        "Seven tasks, each with four robots, with a person who is passive, and as `...Human-v0` with one who acts too.",
        "A still picture or film shows a policy that ships with the package. [Customizing environments](../make_it_yours.md) explains how to "
        "change weights, people and robots, and [creating an environment](../create_an_environment.md) how to add a task.",
    ]
    for name, task in TASKS.items():
        lines += ["", f"## {name}", "", _summary(task), "", '<div class="gallery" markdown>']
        for robot in ROBOTS:
            env = f"{name}{robot}-v0"
            links = f"[{env}]({env}.md) · [{'Human'}]({active_id(env)}.md)"
            clip = _clip(env)
            shown = (
                f"![{env}]({clip}){{ loading=lazy }}"
                if clip
                else '<div class="empty">no policy yet</div>'
            )
            lines += [
                "<figure markdown>",
                shown,
                f"<figcaption markdown>{links}</figcaption>",
                "</figure>",
            ]
        lines += ["</div>"]
    return "\n".join(lines) + "\n"


def page(name: str) -> str:
    """The page of an id."""
    recipe = parse(name)
    task = recipe.task
    parts = [f"# {name}", _head(recipe), *_try(name), "## Reward", _rewards(task)]
    parts += ["## Success", _success(recipe), *_measures(task), *_measured(name), "## Observation"]
    parts += [
        f"What the robot observes, {observe.size(task.robot_obs)} columns:",
        observe.table(task.robot_obs),
    ]
    if recipe.active:
        parts += [f"What the person observes, {observe.size(task.human_obs)} columns:"]
        parts += [observe.table(task.human_obs)]
    parts += ["## Settings", "Weights and thresholds that `config` or `--task.NAME` changes; see "
              "[customizing environments](../make_it_yours.md):", settings_table(settings_of(task))]  # fmt: skip
    return "\n\n".join(parts) + "\n"


def replayed() -> list[str]:
    """Ids whose pages have a replay: ``DOCS_REPLAYS`` names them, or "all" that a policy ships for; none without it."""
    asked = os.environ.get("DOCS_REPLAYS", "")
    known = sorted(set(shipped()) & set(list_envs()))
    return known if asked == "all" else [parse(name).name for name in asked.split(",") if name]


def _head(recipe: Recipe) -> str:
    """Picture, what it is about, and sizes."""
    task, robot = recipe.task, recipe.robot
    own, still = _clip(recipe.name), _clip(static_id(recipe.name))
    other = static_id(recipe.name) if recipe.active else active_id(recipe.name)
    lines = []
    if own or still:
        of = "The policy that ships" if own else f"The policy of {static_id(recipe.name)}"
        lines += [f"![{of}]({own or still}){{ .clip }}", ""]
    if recipe.name in replayed():
        link = f'<a class="md-button" href="../{REPLAYS}/{recipe.name}.html">Look around in it</a>'
        lines += [link, ""]
    lines += [_summary(task), ""]
    acts = "Robot and person act" if recipe.active else "The robot acts, the person is passive"
    else_ = "passive" if recipe.active else "acting too"
    lines += [f"{acts}; with the person {else_}: [{other}]({other}.md).", ""]
    joints = sum(len(arm.joints) for arm in robot.arms_for(task))
    moving = len(task.human.moving(recipe.active)) if recipe.active else 0
    tool = task.tool.name if task.tool else "none, the bare hand"
    rows = {
        "robot": f"{robot.name}, {len(robot.arms_for(task))} arm{'s' * (len(robot.arms_for(task)) > 1)}",
        "tool": tool,
        "actions": f"{joints} joints of the robot"
        + (f", {moving} of the person" if moving else ""),
        "episode": f"{task.episode_length} control steps of {task.control.period:g} s",
        "impairments": ", ".join(task.human.impairments),
        "policy ships": "yes" if recipe.name in shipped() else "no",
    }
    lines += ["| | |", "|---|---|", *(f"| {k} | {v} |" for k, v in rows.items())]
    return "\n".join(lines)


def _try(name: str) -> Iterator[str]:
    yield f'```python\nimport agym_jax, gymnasium\nenv = gymnasium.make({name!r}, render_mode="rgb_array")\n```'
    trainer = "train" if name == static_id(name) else "coop"
    yield f"```bash\nagym-jax {trainer} --env-name {name}\n```"


def _rewards(task: Task) -> str:
    """Terms with what their weights are about."""
    settings = {setting.name: setting for setting in settings_of(task)}
    rows = [
        "The sum of these terms, each also a metric `reward/NAME`:",
        "",
        "| term | weight | unit | about |",
        "|---|---|---|---|",
    ]
    for term in task.reward_terms:
        own = term.replace("preference_", "preferences.", 1)
        found = settings.get(own) or settings.get(term.removesuffix("s"))
        cells = (f"`{found.default}`", found.unit, found.meaning) if found else ("", "", "")
        rows.append(f"| `{term}` | {' | '.join(cells)} |")
    return "\n".join(rows)


def _success(recipe: Recipe) -> str:
    return (inspect.getdoc(recipe.task.success) or "").splitlines()[0].replace(" ().", ".")


def _measures(task: Task) -> Iterator[str]:
    """What the task tells besides."""
    if isinstance(task, Measured):
        rows = [f"| `{TASK_PREFIX}{x.name}` | {x.unit} | {x.words} |" for x in task.measures]
        yield "How far it has come is a metric of every step:"
        yield "\n".join(["| metric | unit | about |", "|---|---|---|", *rows])


def _measured(name: str) -> Iterator[str]:
    """What the policy that ships achieves, how gently, and what all seeds did."""
    modes = [x for x in read_results("evaluation", ("env", "policy")) if x["policy"] == "mode"]
    selections = read_results("selection", ("env",))
    line = next((x for x in modes if x["env"] == name and name in shipped()), None)
    chosen = next((x for x in selections if x["env"] == name), None)
    pairs = read_results("crossplay", ("env", "human_policy"))
    pair = next((x for x in pairs if x["env"] == name and x["human_policy"]), None)
    if name not in shipped():
        pair = None
    if line is None and chosen is None and pair is None:
        yield "No policy has been measured here yet."
        return
    rows = []
    if line:
        share = f"{line['success']:.1%} ({line['success_low']:.1%} to {line['success_high']:.1%})"
        rows.append(("success of the policy that ships", share, line))
        rows.append(("its return", f"{line['return_mean']:.1f} ± {line['return_std']:.1f}", line))
    if pair:
        share = f"{pair['success']:.1%} ({pair['success_low']:.1%} to {pair['success_high']:.1%})"
        rows.append(("success of the robot and the person that ship", share, pair))
        rows.append(("their return", f"{pair['return_mean']:.1f} ± {pair['return_std']:.1f}", pair))
    if chosen:
        gentle = chosen["reported"]
        if "gentle_success" in gentle:
            share = f"{gentle['gentle_success']:.1%}"
            rows.append(("gentle success of the chosen seed", share, chosen))
            rows.append(
                ("its peak force, median of the episodes", f"{gentle['peak_median']:.1f} N", chosen)
            )
        of = [f"{x:.0%}" for x in sorted(chosen["success_of_seeds"])]
        rows.append((f"success of all {len(of)} seeds", ", ".join(of), chosen))
    yield "\n".join(["| | |", "|---|---|", *(f"| {a}{_sign(x)} | {b} |" for a, b, x in rows)])
    old = f" {BEFORE}." if any(is_earlier(x) for *_, x in rows) else ""
    yield (
        f"Over {rows[0][2]['episodes']:,} people each, deterministic (mode) actions.{old} [Care](../care.md) defines gentle success, and "
        "[results over seeds](../seeds.md) explains how seeds are chosen."
    )


def _sign(line: Line) -> str:
    return f" {EARLIER}" if is_earlier(line) else ""


def _clip(name: str) -> str:
    path = CLIPS / f"{name}.webp"
    return f"../images/clips/{path.name}" if path.is_file() else ""


def _summary(task: Task) -> str:
    """The first paragraph of a task's module, without the name."""
    module = inspect.getmodule(type(task))
    text = (inspect.getdoc(module) or "").splitlines()[0]
    return text.partition(": ")[2][:1].upper() + text.partition(": ")[2][1:]
