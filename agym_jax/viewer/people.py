"""People whom the user chooses: as they are drawn for an episode, but for what was asked for."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from agym_jax.human.population import Human
from agym_jax.human.pose import BodyPose, seated, typical
from agym_jax.sim.episode import EpisodeSample
from agym_jax.spec import HumanSpec

SHAKES = 1e-4  # a tremor below it is none [rad]


@dataclass(frozen=True)
class Wishes:
    """What was asked for of a person; None leaves it as drawn.

    Attributes:
        sex: 0 a man, 1 a woman, and between them.
        stature: multiplies heights.
        girth: multiplies radii.
        strength: of the muscles, 1 without impairment.
        limit_scale: of the range of motion, 1 without impairment.
        tremor: the largest amplitude of a joint [rad].
    """

    sex: float | None = None
    stature: float | None = None
    girth: float | None = None
    strength: float | None = None
    limit_scale: float | None = None
    tremor: float | None = None

    def of(self, spec: HumanSpec) -> Callable[[EpisodeSample], EpisodeSample] | None:
        """What makes them come true, for ``NativeRows.revise``; None if there are none.

        Args:
            spec: the person's part in the task.
        """
        asked = {f.name: getattr(self, f.name) for f in fields(self)}
        asked = {name: value for name, value in asked.items() if value is not None}
        if not asked:
            return None

        def revise(drawn: EpisodeSample) -> EpisodeSample:
            human, pose, placement, robot = drawn
            changes: dict[str, Any] = {k: np.float32(v) for k, v in asked.items() if k != "tremor"}
            if "tremor" in asked:
                changes["tremor"] = trembling(np.asarray(human.tremor), asked["tremor"])
            chosen = replace(human, **changes)
            return chosen, posed_like(spec, human, chosen, pose), placement, robot

        return revise


def trembling(drawn: np.ndarray, amplitude: float) -> np.ndarray:
    """Amplitudes of joints, in the proportions that were drawn, or fixed ones if nothing was [rad] (n,)."""
    largest = np.max(np.abs(drawn), initial=0.0)
    if largest < SHAKES:
        drawn = np.random.default_rng(0).uniform(-1.0, 1.0, drawn.shape)
        largest = np.max(np.abs(drawn), initial=SHAKES)
    return (drawn * (amplitude / largest)).astype(np.float32)


def posed_like(spec: HumanSpec, before: Human, after: Human, pose: BodyPose) -> BodyPose:
    """How somebody sits or lies who takes another's place.

    Args:
        spec: the person's part in the task.
        before: whose pose was drawn.
        after: who takes it.
        pose: that was drawn, in NumPy.
    """
    if spec.postures:
        who = (after.sex, after.stature, after.girth, after.limit_scale)
        found = typical(spec, *(float(x) for x in who))
    else:
        old, new = (
            seated(spec, h.dims, h.sex, h.stature, h.girth, np, h.limit_scale)
            for h in (before, after)
        )
        noise = np.asarray(pose.angles) - old.angles
        found = BodyPose(new.root_pos, new.root_quat, new.angles + noise)
    parts = (found.root_pos, found.root_quat, found.angles)
    return BodyPose(*(np.asarray(x, np.float32) for x in parts))


def described(human: Human) -> str:
    """A person in a few words."""
    sex = float(human.sex)
    words = ["man" if sex < 0.25 else "woman" if sex > 0.75 else "person"]
    for name, value in (("height", human.stature), ("girth", human.girth)):
        if abs(float(value) - 1.0) > 5e-3:
            words.append(f"{name} × {float(value):.2f}")
    words += impairments_of(human)
    return ", ".join(words)


def impairments_of(human: Human) -> list[str]:
    """What is hard for a person, in words; empty for nothing."""
    tremor = float(np.max(np.abs(np.asarray(human.tremor)), initial=0.0))
    found = []
    if float(human.strength) < 1.0:
        found.append(f"strength {float(human.strength):.0%}")
    if float(human.limit_scale) < 1.0:
        found.append(f"range of motion {float(human.limit_scale):.0%}")
    if tremor >= SHAKES:
        found.append(f"tremor {np.degrees(tremor):.0f}°")
    return found or ["no impairment"]
