"""Fits the network of ``limits.py`` to samples of Assistive Gym's arm-limit classifier.

    agym-jax arm-limits SAMPLES.npz [--out WEIGHTS.npz] [--heldout-out HELDOUT.npz]

SAMPLES.npz holds ``angles`` (n, 4) [rad] right-arm convention, ``label`` (n,) 1 = reachable,
``probability`` (n,) the classifier's output, and the box ``lower``, ``upper`` (4,) [rad]. One
network overfits the samples (99.6 % agreement on them, 99.0 % held out), so some teachers are
fitted from different seeds, and the student learns their mean at poses drawn afresh from the box.
The held-out part never reaches either; ``--heldout-out`` writes up to 10,000 of it for the tests.
"""

from __future__ import annotations

import argparse
import hashlib
import sys
from collections.abc import Callable, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax

from agym_jax.data.assets import asset_root
from agym_jax.data.npz import Shape, read_arrays, write_arrays
from agym_jax.errors import AgymError
from agym_jax.human.limits import ArmLimits, reachability

SAMPLES: dict[str, Shape] = {
    "angles": ("samples", 4), "label": ("samples",), "probability": ("samples",), "lower": (4,),
    "upper": (4,),
}  # fmt: skip
HELD_OUT = 0.15
HELD_OUT_WRITTEN = 10_000
SHARPNESS = 2.0
"""Factor on the classifier's logit: soft labels that favour the place of the boundary."""
PROBABILITY_FLOOR = 1e-4
"""Of the soft labels, whose float16 storage rounds the surest to 0 and 1."""
WRAP_HALF_WIDTH = 0.1
"""Around shoulder x = 0, where the classifier jumps, agreement is reported apart [rad]."""
ROUND = 1000
"""Steps between progress lines."""


def split(count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Indices of the fitted and of the held-out samples."""
    order = np.random.default_rng(seed).permutation(count)
    held_out = int(HELD_OUT * count)
    return order[held_out:], order[:held_out]


def soft_labels(probability: np.ndarray) -> np.ndarray:
    """The classifier's probability with its logit scaled by SHARPNESS, (n,)."""
    p = np.clip(probability.astype(np.float64), PROBABILITY_FLOOR, 1 - PROBABILITY_FLOOR)
    return (1.0 / (1.0 + ((1 - p) / p) ** SHARPNESS)).astype(np.float32)


def initial(seed: int, hidden: tuple[int, ...], lower: np.ndarray, upper: np.ndarray) -> ArmLimits:
    """Random weights for the box ``lower`` .. ``upper`` (4,) [rad]."""
    rng = np.random.default_rng(seed)
    sizes = (len(lower) + 1, *hidden, 1)
    return ArmLimits(
        kernels=tuple(
            jnp.asarray(rng.normal(size=(i, o)) / np.sqrt(i), jnp.float32)
            for i, o in pairwise(sizes)
        ),
        biases=tuple(jnp.zeros(o) for o in sizes[1:]),
        center=jnp.asarray((lower + upper) / 2, jnp.float32),
        half_range=jnp.asarray((upper - lower) / 2, jnp.float32),
    )


def fit(
    limits: ArmLimits,
    draw: Callable[[jax.Array], tuple[jax.Array, jax.Array]],
    *,
    name: str,
    seed: int,
    steps: int,
    learning_rate: float,
) -> ArmLimits:
    """Minimises the cross entropy with Muon under a cosine schedule.

    Args:
        limits: initial weights; its box stays as it is.
        draw: random key -> angles (batch, 4) [rad] and soft labels (batch,).
        name: for the progress line.
        seed: of the batches.
        steps: a multiple of ROUND.
        learning_rate: at the start.
    """
    schedule = optax.cosine_decay_schedule(learning_rate, steps)
    optimizer = optax.contrib.muon(schedule, adam_learning_rate=schedule)

    def model(weights):
        return ArmLimits(*weights, center=limits.center, half_range=limits.half_range)

    def loss(weights, key):
        angles, target = draw(key)
        logit = reachability(model(weights), angles)
        return optax.sigmoid_binary_cross_entropy(logit, target).mean()

    def step(carry, key):
        weights, state = carry
        value, gradient = jax.value_and_grad(loss)(weights, key)
        update, state = optimizer.update(gradient, state, weights)
        return (optax.apply_updates(weights, update), state), value

    @jax.jit
    def advance(carry, key):
        carry, values = jax.lax.scan(step, carry, jax.random.split(key, ROUND))
        return carry, values.mean()

    weights = (limits.kernels, limits.biases)
    carry = (weights, optimizer.init(weights))
    for i, key in enumerate(jax.random.split(jax.random.key(seed), steps // ROUND)):
        carry, value = advance(carry, key)
        print(f"\r{name}: step {(i + 1) * ROUND}/{steps}  loss {value:.5f}", end="", flush=True)
    print()
    return model(carry[0])


def main(argv: Sequence[str] | None = None, prog: str = "agym-jax arm-limits") -> int:
    """The command line; returns the exit status."""
    description = "Fits the arm-limit network to classifier samples."
    parser = argparse.ArgumentParser(prog=prog, description=description)
    parser.add_argument("samples", type=Path, metavar="SAMPLES.npz")
    parser.add_argument("--out", type=Path, default=asset_root() / "human" / "arm_limits.npz")
    parser.add_argument("--heldout-out", type=Path, help="write held-out samples for the tests")
    parser.add_argument("--hidden", type=int, nargs="+", default=[64, 64, 64])
    parser.add_argument("--teachers", type=int, default=4)
    parser.add_argument(
        "--steps", type=int, default=14_000, help="per teacher; twice for the student"
    )
    parser.add_argument("--batch", type=int, default=2048)
    parser.add_argument("--learning-rate", type=float, default=0.02)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args(argv)

    try:
        data = read_arrays(
            args.samples,
            "file of samples",
            SAMPLES,
            AgymError,
            "The help says what it has to hold.",
        )
    except AgymError as error:
        print(error, file=sys.stderr)
        return 1
    angles, label = data["angles"].astype(np.float32), data["label"] > 0
    target, lower, upper = soft_labels(data["probability"]), data["lower"], data["upper"]
    fitted, held_out = split(len(angles), args.seed)
    x, y = jnp.asarray(angles[fitted]), jnp.asarray(target[fitted])
    hidden = tuple(args.hidden)

    def draw_samples(key):
        index = jax.random.randint(key, (args.batch,), 0, len(x))
        return x[index], y[index]

    teachers = [
        fit(
            initial(seed, hidden, lower, upper),
            draw_samples,
            name=f"teacher {i + 1}/{args.teachers}",
            seed=seed,
            steps=args.steps,
            learning_rate=args.learning_rate,
        )
        for i, seed in enumerate(range(args.seed + 1, args.seed + 1 + args.teachers))
    ]

    def draw_box(key):
        shape = (args.batch, 4)
        pose = jax.random.uniform(key, shape, minval=jnp.asarray(lower), maxval=jnp.asarray(upper))
        logit = sum(reachability(teacher, pose) for teacher in teachers) / len(teachers)
        return pose, jax.nn.sigmoid(logit)

    limits = fit(
        initial(args.seed, hidden, lower, upper),
        draw_box,
        name="student",
        seed=args.seed,
        steps=2 * args.steps,
        learning_rate=args.learning_rate,
    )

    for i, teacher in enumerate(teachers):
        same = np.asarray(reachability(teacher, angles[held_out]) > 0) == label[held_out]
        print(f"held-out agreement of teacher {i + 1}: {same.mean():.5f}")
    right = np.asarray(reachability(limits, angles[held_out]) > 0) == label[held_out]
    near = np.abs(angles[held_out, 1]) < WRAP_HALF_WIDTH
    print(f"held-out agreement {right.mean():.5f} of {len(right)}")
    print(f"  |shoulder x| < {WRAP_HALF_WIDTH}: {right[near].mean():.5f} of {near.sum()}")
    print(f"  elsewhere: {right[~near].mean():.5f}")

    arrays: dict[str, Any] = {"center": limits.center, "half_range": limits.half_range}
    for i, (kernel, bias) in enumerate(zip(limits.kernels, limits.biases, strict=True)):
        arrays |= {f"kernel_{i}": kernel, f"bias_{i}": bias}
    arrays = {name: np.asarray(value, np.float32) for name, value in arrays.items()}
    arrays |= {
        "seed": args.seed, "n_samples": len(angles), "n_fitted": len(fitted),
        "heldout_agreement": right.mean(),
        "samples_sha256": hashlib.sha256(args.samples.read_bytes()).hexdigest(),
    }  # fmt: skip
    write_arrays(args.out, arrays)
    print(f"wrote {args.out}")
    if args.heldout_out:
        chosen = held_out[:HELD_OUT_WRITTEN]
        write_arrays(args.heldout_out, {"angles": angles[chosen], "label": label[chosen]})
        print(f"wrote {args.heldout_out}")
    return 0
