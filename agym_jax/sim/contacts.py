"""Which geoms may touch which: pairs by what their force means, by names with prefixes."""

from __future__ import annotations

from agym_jax.human import body
from agym_jax.spec import Arm, Task

SELF_CONTACTS = (
    ("upper_arm", "chest"), ("forearm", "chest"), ("forearm", "waist"), ("forearm", "thigh"),
    ("forearm", "hips"), ("hand", "chest"), ("hand", "waist"), ("hand", "hips"), ("hand", "thigh"),
    ("hand", "head"),
)  # fmt: skip
"""Of the person's moving arm with the rest of the body (AG's self-collision mask, the near ones)."""


def tool_prefixes(task: Task, arms: tuple[Arm, ...]) -> tuple[str, ...]:
    """Name prefix of the tool in each arm's hand; none for tasks without a tool."""
    return ("tool/", "tool2/")[: len(arms)] if task.tool is not None else ()


def contact_pairs(
    task: Task, arms: tuple[Arm, ...], moving: tuple[str, ...]
) -> dict[str, list[tuple[str, str]]]:
    """Geom pairs that may touch, by what their force means; names with prefixes.

    The hand and the tool's working part may touch every limb of ``task.human.limbs``; the other
    links and the rest of the tool the arm that is helped, the links also the thigh beneath it.
    """
    limbs = task.human.limbs
    arm = [x for x in limbs if x.split("_", 1)[-1] in ("upper_arm", "forearm", "hand")]
    near = [*arm, *(x for x in limbs if x.endswith("thigh"))]
    seat = [f"seat/{g}" for g in task.seat.geoms]
    pairs: dict[str, list[tuple[str, str]]] = {}
    for prefix in tool_prefixes(task, arms):
        parts = [f"{prefix}{g}" for g in task.tool.geoms]  # pyrefly: ignore
        working, rest = parts[: task.tool.n_working], parts[task.tool.n_working :]  # pyrefly: ignore
        pairs[f"{prefix}human"] = [(g, f"human/{x}") for g in working for x in limbs] + [
            (g, f"human/{x}") for g in rest for x in arm
        ]
        pairs[f"{prefix}seat"] = [(g, x) for g in working for x in seat]
    pairs["robot_human"], pairs["robot_seat"] = [], []
    for each in arms:
        hand, *links = (f"robot/{g}" for g in each.links)
        pairs["robot_human"] += [(hand, f"human/{x}") for x in limbs]
        pairs["robot_human"] += [(g, f"human/{x}") for g in links for x in near]
        pairs["robot_seat"] += [(hand, g) for g in seat]
    free = [x for x in arm if body.is_free(body.LINK[x], moving)]
    outer = [x for x in free if task.seat.bears_upper_arm or not x.endswith("upper_arm")]
    pairs["human_seat"] = [(f"human/{x}", g) for x in outer for g in seat]
    side = task.human.arm
    pairs["human_self"] = [
        (f"human/{side}_{a}", f"human/{side}_{b}" if b == "thigh" else f"human/{b}")
        for a, b in SELF_CONTACTS
        if f"{side}_{a}" in free and (f"{side}_{b}" if b == "thigh" else b) in limbs
    ]
    return pairs


def is_sensed(kind: str) -> bool:
    """Whether pairs of this kind carry a contact sensor."""
    return kind.startswith(("tool", "robot_human"))
