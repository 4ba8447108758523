"""The people helped in an evaluation: success and gentle success by sex, impairment and size of the person."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from agym_jax.human.population import Human

PREFIX = "person/"
FIFTHS = 5
LEAST = 20
"""Smallest number of episodes for a group to be reported as the worst; with fewer, chance decides."""
IMPAIRED = {"limits": "with limited joints", "weakness": "with weakness", "tremor": "with tremor"}
WELL = "without impairment"
SIZES = {"stature": ("shortest", "tallest"), "girth": ("slimmest", "stoutest")}
"""Continuous sizes in which people differ -> names of the lowest and the highest fifth."""


@dataclass(frozen=True)
class People:
    """The person of each episode; arrays have one entry per episode. See ``agym_jax.human.population.Human``.

    Attributes:
        sex: 0 male, 1 female, or a value between or beyond these.
        stature: height scale.
        girth: radius scale.
        limits: whether the joints are limited.
        weakness: whether the muscles are weak.
        tremor: whether a joint trembles.
    """

    sex: np.ndarray
    stature: np.ndarray
    girth: np.ndarray
    limits: np.ndarray
    weakness: np.ndarray
    tremor: np.ndarray

    def groups(self) -> dict[str, np.ndarray]:
        """Return name of each group -> whether a person belongs to it (episodes,); empty groups are omitted.

        Fifths refer to these people, if their sizes differ.
        """
        women = self.sex >= 0.5
        impaired = {words: getattr(self, name) for name, words in IMPAIRED.items()}
        found = {"men": ~women, "women": women, WELL: ~np.any([*impaired.values()], 0), **impaired}
        for name, (low, high) in SIZES.items():
            values = getattr(self, name)
            if len(np.unique(values)) < FIFTHS:
                continue
            fifth = np.argsort(np.argsort(values)) * FIFTHS // len(values)
            names = [f"{low} fifth", *(f"{name}, fifth {i}" for i in range(2, FIFTHS)), f"{high} fifth"]  # fmt: skip
            found |= {words: fifth == i for i, words in enumerate(names)}
        return {name: mask for name, mask in found.items() if mask.any()}


def people_in(first: Any) -> dict[str, Any]:
    """Return the people of a batch of first states, as ``person/<field>``; empty if environments have none."""
    human = getattr(getattr(first, "episode", None), "human", None)
    if human is None:
        return {}
    found = {name: getattr(human, name) for name in ("sex", "stature", "girth")} | human.impaired
    return {f"{PREFIX}{name}": value for name, value in found.items()}


def people_of(sums: Mapping[str, np.ndarray]) -> People | None:
    """Extract the people from an evaluation's sums, in NumPy."""
    if f"{PREFIX}sex" not in sums:
        return None
    return People(**{x.name: sums[f"{PREFIX}{x.name}"] for x in fields(People)})


def describe(human: Human) -> str:
    """Describe a person in words: "a woman with tremor"."""
    impairments = [IMPAIRED[name] for name, there in human.impaired.items() if there]
    who = "a woman" if human.sex >= 0.5 else "a man"
    return " ".join([who, " and ".join(impairments) or WELL])


@dataclass(frozen=True)
class Group:
    """Results of an evaluation for one group of people."""

    name: str
    episodes: int
    success: float
    gentle_success: float | None


def by_group(people: People, successes: np.ndarray, gentle: np.ndarray | None) -> list[Group]:
    """Compute success and gentle success of each group.

    Args:
        people: person of each episode.
        successes: whether the episode was a success (episodes,).
        gentle: whether it was a gentle success (episodes,); None if that is not measured.
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
    """Return the group with the lowest success among those with at least ``LEAST`` episodes; None if there is none."""
    return min((x for x in groups if x.episodes >= LEAST), key=lambda x: x.success, default=None)


def group_rows(groups: list[Group]) -> list[tuple[str, str]]:
    """Return rows of a table: name, value."""
    return [
        (
            x.name,
            f"{x.success:9.1%}"
            + ("" if x.gentle_success is None else f"   gently {x.gentle_success:.1%}")
            + f"   of {x.episodes}",
        )
        for x in groups
    ]
