"""Comparison of the banks of people in bed with the people whom Assistive Gym's simulation settles.

``agym-jax postures report`` prints it.
"""

from __future__ import annotations

import numpy as np

from agym_jax.human import body
from agym_jax.human.posture import Postures, link_positions

LINKS, ALL, ARM = tuple(body.LINK), tuple(body.JOINTS), body.RIGHT_ARM

AG = {
    "BedBathing": {
        "chest": ((-0.150, 0.200, 0.875), (-0.151, 0.201, 0.868)),
        "right_upper_arm": ((-0.328, 0.341, 0.862), (-0.309, 0.336, 0.835)),
        "right_forearm": ((-0.413, 0.091, 0.782), (-0.359, 0.084, 0.775)),
        "right_hand": ((-0.506, -0.178, 0.752), (-0.414, -0.170, 0.777)),
        "head": ((-0.150, 0.486, 0.885), (-0.150, 0.451, 0.877)),
        "waist": ((-0.150, 0.044, 0.885), (-0.151, 0.051, 0.875)),
        "hips": ((-0.150, -0.037, 0.891), (-0.151, -0.023, 0.879)),
        "right_shin": ((-0.245, -0.538, 0.837), (-0.231, -0.486, 0.835)),
        "r_shoulder_y": (19, 12), "r_shoulder_x": (20, 22), "r_shoulder_z": (1, 5),
        "r_elbow_x": (-11, -14), "r_forearm_roll_z": (-12, 4), "r_wrist_x": (-1, -10),
        "r_wrist_y": (-6, -8),
    },
    "ArmManipulation": {
        "chest": ((-0.249, 0.200, 0.881), (-0.249, 0.199, 0.871)),
        "right_upper_arm": ((-0.428, 0.340, 0.862), (-0.407, 0.329, 0.835)),
        "right_forearm": ((-0.621, 0.286, 0.670), (-0.619, 0.294, 0.683)),
        "right_hand": ((-0.818, 0.234, 0.466), (-0.827, 0.258, 0.530)),
        "head": ((-0.250, 0.484, 0.910), (-0.249, 0.447, 0.895)),
        "waist": ((-0.249, 0.044, 0.885), (-0.248, 0.049, 0.877)),
        "hips": ((-0.248, -0.037, 0.887), (-0.248, -0.026, 0.880)),
        "right_shin": ((-0.349, -0.537, 0.835), (-0.327, -0.489, 0.830)),
        "r_shoulder_y": (83, 88), "r_shoulder_x": (38, 38), "r_shoulder_z": (-1, 13),
        "r_elbow_x": (1, 0), "r_forearm_roll_z": (-17, -14), "r_wrist_x": (-23, -12),
        "r_wrist_y": (-7, 0),
    },
}  # fmt: skip
"""AG's settled men and women: mean link positions [m] and angles [deg], humans.md section 5."""


def statistics(bank: Postures, sex: float) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Mean and standard deviation of links [m] (3,) and angles [deg] () of a bank.

    Over its rows of AG's man (0) or woman (1) with full joint limits.
    """
    plain = (bank.stature == 1) & (bank.girth == 1) & (bank.limit_scale == 1)
    seen: dict[str, list] = {}
    for i in np.flatnonzero((bank.sex == sex) & plain):
        human = bank.row(int(i))
        degrees = dict(zip(ALL, np.rad2deg(human.angles), strict=True))
        for key, value in (link_positions(human) | degrees).items():
            seen.setdefault(key, []).append(value)
    return {key: (np.mean(v, axis=0), np.std(v, axis=0)) for key, v in seen.items()}


def compare(bank: Postures, name: str) -> None:
    """Print a bank's statistics beside AG's."""
    print(name)
    for sex, who in enumerate(("men", "women")):
        found = statistics(bank, sex)
        for key in (*AG[name], *(j for j in ARM if j not in AG[name])):
            mean, deviation = (np.round(x, 3 if key in LINKS else 0) for x in found[key])
            wanted = AG[name][key][sex] if key in AG[name] else "not measured"
            print(f"{who:6} {key:18} {mean!s:24} +- {deviation!s:22} AG {wanted}")
