"""Pose-dependent limits of the arm: which shoulder and elbow angles go together, and their torque.

How far a shoulder turns depends on its other axes and on the elbow. Assistive Gym resets an arm
that leaves the reachable set to its last reachable pose, as judged by a classifier. Here a small
tanh network, fitted to 150,000 samples of that classifier (``fit_limits.py``), drives a smooth
restoring torque instead: zero inside, growing with the distance outside.

All poses are ``(shoulder y, shoulder x, shoulder z, elbow)`` [rad], in the frames of the person's
joints; the left arm mirrors the right as ``(-y, x, -z, elbow)``.

DEVIATION(arm-limit-wrap): Assistive Gym wraps the angles to [0, 2 pi) before it judges them, so its
classifier jumps at shoulder x = 0, where 4.1 % of the labels flip: a wall no person has. The network
reads a smooth step across that plane (WRAP_WIDTH) as a fifth input, so it follows the labels on
either side. The torque leaves out the step's slope: nothing pushes towards or away from the plane
because of the jump, and a torque that exists on one side only fades in across the step.

DEVIATION(arm-limit-torque): an arm is pushed back instead of being reset to a stored pose, so it
stands a few degrees outside the boundary when pressed, and no pose outlives a reset.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from agym_jax.data.assets import asset_path
from agym_jax.data.npz import Shape, read_arrays
from agym_jax.errors import DamagedFileError

STIFFNESS = 30.0
"""Slope of the torque once well outside [N m/rad]. An estimate: the person's 1 N m of strength
rests some 3.5 degrees outside."""
MAX_TORQUE = 10.0
"""Bound on the norm of the torque [N m]: far above the 1 N m of person and robot, yet finite."""
DAMPING = 1.0
"""Resistance to outward motion when outside [N m s/rad]. Stable when explicit at 20 ms for
inertias down to 0.01 kg m^2, or less where the joint's implicit damping adds to them."""
ONSET = 0.05
"""Distance over which stiffness and damping set in [rad]."""
FLAT_GRADIENT = 4.0
"""Slope below which the network gives no clear direction and the torque fades [1/rad]. At the
boundary 9 poses of 10 have a slope of 9 to 81."""
BOX_MARGIN = 0.1
"""How far beyond the sampled box the network still follows the pose [half ranges]."""
WRAP_WIDTH = 0.1
"""Half width of the step at shoulder x = 0 [rad]."""


@dataclass(frozen=True)
class ArmLimits:
    """Weights of the network: 5 inputs (scaled angles, side of shoulder x = 0), tanh, one logit.

    ``kernels[i]`` is (inputs, outputs), ``biases[i]`` (outputs,).
    ``center`` (4,) and ``half_range`` (4,) [rad] scale the sampled box, right-arm convention, to
    [-1, 1].
    """

    kernels: tuple[jax.Array, ...]
    biases: tuple[jax.Array, ...]
    center: jax.Array
    half_range: jax.Array


jax.tree_util.register_dataclass(
    ArmLimits, data_fields=["kernels", "biases", "center", "half_range"], meta_fields=[]
)


def load_arm_limits(name: str = "human/arm_limits.npz") -> ArmLimits:
    """Reads the fitted weights from the assets, as NumPy float32.

    Raises:
        MissingAssetError: the asset is not there.
        DamagedFileError: it is damaged.
    """
    path = asset_path(name)
    shapes: dict[str, Shape] = {"center": (4,), "half_range": (4,), "kernel_0": (5, "units")}
    data = read_arrays(path, "arm limits", shapes, DamagedFileError, "Reinstall agym_jax.")
    layers = range(sum(key.startswith("kernel_") for key in data))
    return ArmLimits(
        kernels=tuple(data[f"kernel_{i}"] for i in layers),
        biases=tuple(data[f"bias_{i}"] for i in layers),
        center=data["center"],
        half_range=data["half_range"],
    )


def mirror_left(angles: Any, side_sign: Any = -1.0, xp: Any = jnp) -> Any:
    """Angles, velocities or torques of the left arm as those of a right arm, and back.

    Args:
        angles: (..., 4) shoulder y, x, z and elbow.
        side_sign: -1 mirrors; +1, for a right arm, changes nothing. () or (...).
        xp: numpy or jax.numpy.
    """
    sign = xp.asarray(side_sign, angles.dtype)
    one = xp.ones_like(sign)
    return angles * xp.stack([sign, one, sign, one], axis=-1)


def reachability(limits: ArmLimits, angles: Any, xp: Any = jnp) -> Any:
    """Logit of a person reaching the pose: > 0 is reachable.

    Outside the sampled box (Assistive Gym's nominal joint limits) the pose is drawn smoothly back
    to its surface, so the value stays that of the border; the joints' own limits act there.

    Args:
        limits: fitted weights.
        angles: (..., 4) right-arm convention [rad].
        xp: numpy or jax.numpy.

    Returns:
        (...) logit [-].
    """
    return _logit(limits, angles, _wrap_side(angles, xp), xp)


def _wrap_side(angles: Any, xp: Any = jnp) -> Any:
    """Side of shoulder x = 0, where the classifier wraps: a smooth step from -1 to 1, (..., 1)."""
    return xp.tanh(angles[..., 1:2] / WRAP_WIDTH)


def _logit(limits: ArmLimits, angles: Any, side: Any, xp: Any = jnp) -> Any:
    matmul = partial(jnp.matmul, precision="highest") if xp is jnp else np.matmul
    scaled = (angles - limits.center) / limits.half_range
    inside = xp.clip(scaled, -1.0, 1.0)
    drawn = inside + BOX_MARGIN * xp.tanh((scaled - inside) / BOX_MARGIN)
    x = xp.concatenate([drawn, side], axis=-1)
    *hidden, (kernel, bias) = zip(limits.kernels, limits.biases, strict=True)
    for k, b in hidden:
        x = xp.tanh(matmul(x, k) + b)
    return (matmul(x, kernel) + bias)[..., 0]


def _inward(limits: ArmLimits, angles: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Distance outside [rad] (), 0 inside, and direction back (4,), of norm < 1."""
    side = _wrap_side(angles)  # held fixed: its slope is the classifier's wrap, not the arm's
    logit, gradient = jax.value_and_grad(_logit, argnums=1)(limits, angles, side)
    steepness = jnp.sqrt(jnp.sum(gradient**2) + FLAT_GRADIENT**2)
    return jnp.maximum(-logit, 0.0) / steepness, gradient / steepness


def limit_torque(
    limits: ArmLimits,
    angles: jax.Array,
    velocity: jax.Array,
    side_sign: float | jax.Array = 1.0,
) -> jax.Array:
    """Torque that pushes an arm back into its reachable poses [N m].

    Outside, with ``d = -logit / |gradient|`` the distance to the boundary to first order and ``n``
    the normalised gradient, the torque is ``n * MAX_TORQUE * tanh((STIFFNESS * d + DAMPING * o) * s
    / MAX_TORQUE)``: ``o`` is the outward speed ``max(-n . velocity, 0)``, and ``s = d / (d +
    ONSET)`` sets in smoothly at the boundary. Inside the torque is exactly zero.

    Args:
        limits: fitted weights.
        angles: (4,) joint angles of the arm [rad].
        velocity: (4,) joint velocities [rad/s].
        side_sign: +1 for a right arm, -1 for a left arm, ().

    Returns:
        (4,) torque on the same joints, of norm at most MAX_TORQUE [N m].
    """
    distance, inward = _inward(limits, mirror_left(angles, side_sign))
    outward_speed = jnp.maximum(-jnp.dot(inward, mirror_left(velocity, side_sign)), 0.0)
    onset = distance / (distance + ONSET)
    push = (STIFFNESS * distance + DAMPING * outward_speed) * onset
    torque = MAX_TORQUE * jnp.tanh(push / MAX_TORQUE) * inward
    return mirror_left(torque, side_sign)
