"""Whom an evaluation helped: success and gentle success by sex, impairment and size of the person."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

PREFIX = "person/"
FIFTHS = 5
LEAST = 20
"""Episodes from which on a group can be the worst: of fewer, chance decides."""
SIZES = {"stature": ("shortest", "tallest"), "girth": ("slimmest", "stoutest")}
"""What people differ in where sizes are continuous, and what its first and last fifth are called."""


@dataclass(frozen=True)
class People:
    """The person of each episode; arrays have one entry an episode. See ``agym_jax.human.population.Human``.

    Attributes:
        sex: 0 a man, 1 a woman, or between or beyond them.
        stature: height scale.
        girth: radius scale.
        strength: of the muscles; 1 is full.
        limit_scale: of the joint limits; 1 is the full range.
        tremor: largest amplitude of a joint [rad]; 0 where no joint moves, as of somebody who lies still in bed.
    """

    sex: np.ndarray
    stature: np.ndarray
    girth: np.ndarray
    strength: np.ndarray
    limit_scale: np.ndarray
    tremor: np.ndarray

    def groups(self) -> dict[str, np.ndarray]:
        """Name of each group -> whether a person belongs to it (episodes,); groups of nobody are left out.

        Fifths are of these people, where sizes differ.
        """
        women, trembles = self.sex >= 0.5, self.tremor > 0
        weak, limited = self.strength < 1, self.limit_scale < 1
        found = {
            "men": ~women,
            "women": women,
            "without impairment": ~(trembles | weak | limited),
            "with limited joints": limited,
            "with weakness": weak,
            "with tremor": trembles,
        }
        for name, (low, high) in SIZES.items():
            values = getattr(self, name)
            if len(np.unique(values)) < FIFTHS:
                continue
            fifth = np.argsort(np.argsort(values)) * FIFTHS // len(values)
            names = [f"{low} fifth", *(f"{name}, fifth {i}" for i in range(2, FIFTHS)), f"{high} fifth"]  # fmt: skip
            found |= {words: fifth == i for i, words in enumerate(names)}
        return {name: mask for name, mask in found.items() if mask.any()}


def people_in(first: Any) -> dict[str, Any]:
    """The people of a batch of first states, as ``person/<field>``; empty where environments have none."""
    human = getattr(getattr(first, "episode", None), "human", None)
    if human is None:
        return {}
    found = {f"{PREFIX}{x.name}": getattr(human, x.name) for x in fields(People)}
    return found | {f"{PREFIX}tremor": abs(human.tremor).max(-1, initial=0.0)}


def people_of(sums: Mapping[str, np.ndarray]) -> People | None:
    """The people among what an evaluation found, in NumPy."""
    if f"{PREFIX}sex" not in sums:
        return None
    return People(**{x.name: sums[f"{PREFIX}{x.name}"] for x in fields(People)})


def describe(human: Any) -> str:
    """One person in words: "a woman with tremor"."""
    found = [
        ("limited joints", human.limit_scale < 1),
        ("weakness", human.strength < 1),
        ("tremor", (abs(human.tremor) > 0).any()),
    ]
    impairments = " and ".join(name for name, there in found if there)
    who = "a woman" if human.sex >= 0.5 else "a man"
    return f"{who} with {impairments}" if impairments else f"{who} without impairment"


@dataclass(frozen=True)
class Group:
    """What an evaluation found among the people of one group."""

    name: str
    episodes: int
    success: float
    gentle_success: float | None


def by_group(people: People, successes: np.ndarray, gentle: np.ndarray | None) -> list[Group]:
    """Success and gentle success of each group.

    Args:
        people: of each episode.
        successes: whether it was one (episodes,).
        gentle: whether it was a gentle one (episodes,); None where that is not measured.
    """
    return [
        Group(
            name,
            int(mask.sum()),
            float(successes[mask].mean()),
            None if gentle is None else float(gentle[mask].mean()),
        )
        for name, mask in people.groups().items()
    ]


def worst(groups: list[Group]) -> Group | None:
    """The group that is helped least often, of those with ``LEAST`` episodes; None if there is none."""
    return min((x for x in groups if x.episodes >= LEAST), key=lambda x: x.success, default=None)


def rows(groups: list[Group]) -> list[tuple[str, str]]:
    """Lines of a table: name, value."""
    return [
        (
            x.name,
            f"{x.success:9.1%}"
            + ("" if x.gentle_success is None else f"   gently {x.gentle_success:.1%}")
            + f"   of {x.episodes}",
        )
        for x in groups
    ]
