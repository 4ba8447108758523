"""Regions of the body, and limits on the forces that the robot and its tools may exert on them.

Each region has two kinds of limits: those that industrial robots must not exceed, because pain begins there
(``Region.quasi_static``, ``Region.transient``), and a limit of what is comfortable in care (``Region.comfort``), which a
task may override (``spec.Comfortable``). An episode is a *gentle* success if it is a success and none of its steps
exceeded a comfort limit.

The forces are the normal forces of all contacts of the robot and its tools with the person, summed over each region, with
left and right added together, which is strict. Forces of the seat or bed that supports the person do not count, nor do
those of the gown (Dressing observes its force).

Each control step of 0.1 s yields two values. The *peak* is the largest force in any of its physics steps, of 0.01 or
0.02 s each: contacts have a time constant of 0.04 s (``sim.contacts.SOLREF``), so that no impact is shorter, whereas a
mean over 0.1 s would hide two thirds of it. It is compared with the comfort limit and the limit for transient contact.
The *mean* is compared with the limit for quasi-static contact, which ISO applies only after 0.5 s; here it applies to
every 0.1 s.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from agym_jax.errors import SpecError, UnknownNameError
from agym_jax.human.body import SHAPES
from agym_jax.spec import Comfortable


class Region(NamedTuple):
    """A region of the body and its force limits [N]."""

    name: str
    shapes: tuple[str, ...]  # of the body, without "left_" and "right_"
    quasi_static: float  # that lasts
    transient: float  # of an impact
    comfort: float


HEAD, LIMB = 10.0, 20.0
"""Comfort limits [N]. These are estimates: nobody has measured which forces people receiving care find comfortable over
the whole body.

Head: people without impairments who chose how hard a robot might shave and wipe their face allowed at most 11.1 and 36.4 N
(Proc IMechE H 237(7):829, 2023); a spoon or cup at the lips needs less than a shaver.
Limbs and trunk: twice as much. A robot that wiped the limbs of a person in bed needed less than 3 N (King et al., IROS
2010), and Assistive Gym regards 10 N at the target as high; 20 N is the weight of a resting forearm and hand.
"""

# Of ISO/TS 15066:2016, table A.2, since 2025 in ISO 10218-2; from secondary sources (integrators' tables; BG/BGIA 2011, which
# preceded it), as the standard is not public. Some print 150 N for the neck: the lower is taken. Twice the force when
# transient, but for skull and face, where ISO gives no factor: counted once.
REGIONS: tuple[Region, ...] = (
    Region("face", ("face", "nose"), 65.0, 65.0, HEAD),
    Region("skull", ("head",), 130.0, 130.0, HEAD),
    Region("neck", ("neck",), 145.0, 290.0, HEAD),
    Region("shoulder", ("girdle",), 210.0, 420.0, LIMB),
    Region("chest", ("chest",), 140.0, 280.0, LIMB),
    Region("abdomen", ("waist",), 110.0, 220.0, LIMB),
    Region("pelvis", ("hips",), 180.0, 360.0, LIMB),
    Region("upper arm", ("upper_arm",), 150.0, 300.0, LIMB),
    Region("forearm", ("forearm",), 160.0, 320.0, LIMB),
    Region("hand", ("hand",), 140.0, 280.0, LIMB),
    Region("thigh", ("thigh",), 220.0, 440.0, LIMB),
    Region("lower leg", ("shin", "foot"), 130.0, 260.0, LIMB),
)
"""The regions; every shape of the body belongs to one of them."""

NAMES = tuple(region.name for region in REGIONS)
QUASI_STATIC = np.array([region.quasi_static for region in REGIONS], np.float32)
TRANSIENT = np.array([region.transient for region in REGIONS], np.float32)
REGION_OF: dict[str, int] = {
    shape: i
    for shape in SHAPES
    for i, region in enumerate(REGIONS)
    if shape.removeprefix("left_").removeprefix("right_") in region.shapes
}
"""Body shape -> row in ``REGIONS``."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class RegionForces:
    """Normal force of the robot and its tools on each of ``REGIONS`` during one control step."""

    both: (
        Array  # in one array, as each that enters C MuJoCo's stages costs time (..., 2, n_regions)
    )

    @classmethod
    def of(cls, mean: Any, peak: Any, xp: Any = jnp) -> RegionForces:
        """Make from means and peaks (..., n_regions)."""
        return cls(xp.stack([mean, peak], axis=-2))

    @property
    def mean(self) -> Array:
        """Mean force over the physics steps of the control step [N] (..., n_regions)."""
        return self.both[..., 0, :]

    @property
    def peak(self) -> Array:
        """Largest force in any physics step of the control step [N] (..., n_regions)."""
        return self.both[..., 1, :]

    def of_comfort(self, comfort: Any) -> Array:
        """Return the largest ratio of a region's force to its comfort limit; above 1, a limit is exceeded ().

        Args:
            comfort: result of ``comfort_limits``.
        """
        return jnp.max(self.peak / comfort)

    def of_limit(self) -> Array:
        """Return the largest ratio of a region's force to its ISO limits; above 1, a limit is exceeded ()."""
        return jnp.max(jnp.maximum(self.peak / TRANSIENT, self.mean / QUASI_STATIC))


def no_forces() -> RegionForces:
    """Return zero forces on all regions."""
    return RegionForces(jnp.zeros((2, len(REGIONS))))


def comfort_limits(task: Any) -> np.ndarray:
    """Return the comfort limit of each region in a task [N] (n_regions,).

    Args:
        task: any task; its own limits apply if it is ``Comfortable``.

    Raises:
        UnknownNameError: if it names a region that does not exist.
        SpecError: if a limit is not greater than 0.
    """
    own = dict(task.comfort) if isinstance(task, Comfortable) else {}
    for name, limit in own.items():
        if name not in NAMES:
            raise UnknownNameError("region of the body", name, NAMES)
        if not limit > 0:
            raise SpecError(
                f"{task.name}'s comfort limit of the {name} must be above 0, got {limit}."
            )
    return np.array([own.get(region.name, region.comfort) for region in REGIONS], np.float32)
