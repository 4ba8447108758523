"""Banks of food and water at rest in spoon and cup, so that a reset is a look-up.

    agym-jax particles [spoon cup] [--seed 0] [--rows 64]

Assistive Gym drops a grid of spheres into the tool at every reset and lets it settle for 1 s (food) or 0.4 s
(water): feeding.py, drinking.py reset. Here that is done once, offline, for many directions in which
gravity may point in the vessel's frame: tilts up to 20 degrees for the spoon and 10 for the cup, spread
evenly over the disc, the first one upright. Each row is the lowest of several grids that are dropped
with small random shifts, almost without friction, tilted with the vessel, and then come to rest.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from importlib.metadata import version

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from agym_jax.data.npz import write_arrays
from agym_jax.errors import AgymError, UnknownNameError, checked_count
from agym_jax.math3d import rotation_matrix
from agym_jax.matter.particles.fill import CONTENTS, DOWN, FillBank, fill_path
from agym_jax.matter.particles.solver import Obstacles, Particles, ParticleSpec, advance
from agym_jax.matter.shapes import no_boxes, no_capsules

FALL_FRICTION = 0.02  # while they fall, so that the heap becomes low
FALL_TIME, TURN_TIME, REST_TIME = 2.0, 1.0, 2.0  # [s]
JITTER = 5e-4  # standard deviation of the grids' shifts [m]
REST_SPEED = 0.01  # mean speed below which particles are at rest [m/s]


@dataclass(frozen=True)
class FillRecipe:
    """How a bank is built.

    Attributes:
        spec: of the particles.
        dt: physics step [s].
        grid: number of particles along x, y, z, 10 mm apart.
        height: of the grid's lowest layer above the vessel's origin [m].
        tilt: the largest [rad].
        tries: grids dropped per row.
        finer: factor on the substeps while they fall and tilt: a tall heap falls fast.
    """

    spec: ParticleSpec
    dt: float
    grid: tuple[int, int, int]
    height: float
    tilt: float
    tries: int
    finer: int


FILL_RECIPES = {
    "spoon": FillRecipe(CONTENTS["spoon"], 0.01, (2, 2, 2), 0.0147, np.deg2rad(20.0), 16, 1),
    "cup": FillRecipe(CONTENTS["cup"], 0.01, (4, 4, 4), 0.075, np.deg2rad(10.0), 2, 2),
}


def directions(rows: int, tilt: float) -> np.ndarray:
    """Unit vectors (K, 3) around straight down, evenly over a disc of tilts; the first is straight down.

    Args:
        rows: K.
        tilt: the largest [rad].
    """
    i = np.arange(rows)
    angle = tilt * np.sqrt(i / max(rows - 1, 1))
    turn = i * np.pi * (3.0 - 5.0**0.5)  # the golden angle
    side = np.sin(angle)
    return np.stack([side * np.cos(turn), side * np.sin(turn), -np.cos(angle)], -1)


def tilted(gravity_dir: np.ndarray) -> np.ndarray:
    """Orientation wxyz (..., 4) of a vessel in whose frame straight down is ``gravity_dir`` (..., 3)."""
    down = np.broadcast_to(DOWN, gravity_dir.shape)
    quat = np.concatenate(
        [1.0 + np.sum(gravity_dir * down, -1, keepdims=True), np.cross(gravity_dir, down)], -1
    )
    return quat / np.linalg.norm(quat, axis=-1, keepdims=True)


def tilting_motion(quat: Array, n_turn: int, n_rest: int) -> Obstacles:
    """A vessel at the world's origin that tilts from upright and then rests; no other obstacles.

    Args:
        quat: final orientation, wxyz (4,), less than 180 degrees from upright.
        n_turn: physics steps in which it tilts.
        n_rest: physics steps in which it rests.
    """
    n_moments = n_turn + n_rest + 1
    share = jnp.minimum(jnp.arange(n_moments) / max(n_turn, 1), 1.0)[:, None]
    upright = jnp.array([1.0, 0.0, 0.0, 0.0])
    ends = jnp.zeros((n_moments, 0, 3))
    return Obstacles(
        vessel_pos_w=jnp.zeros((n_moments, 3)),
        vessel_quat_w=upright + share * (quat - upright),
        human=replace(no_capsules(), a_w=ends, b_w=ends),
        furniture=no_boxes(),
        floor=jnp.float32(-10.0),
    )


def resting_motion(quat: Array, n_rest: int) -> Obstacles:
    """The same vessel, at rest with an orientation (4,) for some physics steps."""
    motion = tilting_motion(quat, 0, n_rest)
    return replace(motion, vessel_quat_w=jnp.broadcast_to(quat, motion.vessel_quat_w.shape))


def build(name: str, seed: int = 0, rows: int = 64) -> tuple[FillBank, dict[str, float]]:
    """Let particles settle at K tilts.

    Args:
        name: of the vessel.
        seed: of the shifts of the grids.
        rows: K.

    Returns:
        the bank, and facts about its rows: speeds, overlaps, heights.

    Raises:
        AgymError: at some tilt no grid has come to rest inside the vessel.
    """
    recipe = FILL_RECIPES[name]
    spec, towards = recipe.spec, directions(rows, recipe.tilt)
    cell = (
        np.stack(np.meshgrid(*map(np.arange, recipe.grid), indexing="ij"), -1).reshape(-1, 3) * 0.01
    )
    cell = cell - [cell[:, 0].mean(), cell[:, 1].mean(), -recipe.height]
    shift = np.random.default_rng(seed).normal(0.0, JITTER, (rows, recipe.tries, spec.count, 3))
    quat_w = np.repeat(tilted(towards)[:, None], recipe.tries, axis=1)

    steps = [round(time / recipe.dt) for time in (FALL_TIME, TURN_TIME, REST_TIME)]

    @jax.jit
    @jax.vmap
    @jax.vmap
    def settle(local: Array, quat: Array) -> tuple[Array, Array]:
        particles = Particles(local, jnp.zeros_like(local), jnp.ones(spec.count, bool))
        fine, (fall, turn, rest) = replace(spec, substeps=recipe.finer * spec.substeps), steps
        upright = jnp.array([1.0, 0.0, 0.0, 0.0])
        fall_on = (
            tilting_motion(upright, 0, fall),
            tilting_motion(quat, turn, 0),
            resting_motion(quat, rest),
        )
        for some, motion in zip(
            (replace(fine, friction=FALL_FRICTION), fine, spec), fall_on, strict=True
        ):
            particles, _ = advance(some, particles, motion, recipe.dt)
        return particles.pos_w @ rotation_matrix(quat, normalize=True), particles.vel_w

    out = settle(jnp.asarray(cell + shift, jnp.float32), jnp.asarray(quat_w, jnp.float32))
    pos, vel = (np.asarray(x) for x in out)
    speed = np.linalg.norm(vel, axis=-1).mean(-1)
    height = -np.einsum("ktni,ki->kt", pos, towards) / spec.count
    well = _lies_in(spec, pos) & (speed < REST_SPEED)
    best = np.argmin(np.where(well, height, np.inf), axis=1)
    each = np.arange(rows)
    if not well[each, best].all():
        raise AgymError(f"{name}: at {np.sum(~well.any(1))} of {rows} tilts nothing came to rest.")
    pos = pos[each, best]
    gaps = np.linalg.norm(pos[:, :, None] - pos[:, None], axis=-1) + np.eye(spec.count)
    facts = {
        "grids_at_rest": float(well.mean()),
        "mean_speed": float(speed[each, best].max()),
        "mean_height": float(pos[..., 2].mean()),
        "highest": float(pos[..., 2].max()),
        "deepest_overlap": float(2 * spec.radius - gaps.min()),
    }
    return FillBank(towards.astype(np.float32), pos.astype(np.float32)), facts


def _lies_in(spec: ParticleSpec, pos: np.ndarray) -> np.ndarray:
    """Whether all n particles (..., n, 3), in the vessel's frame, lie within its outline (...)."""
    x, y, z = (pos[..., i] for i in range(3))
    within = np.asarray(spec.vessel.polar(x, y)[0]) < spec.vessel.brim[0]
    return np.all(within & (z > 0) & (z < spec.vessel.depth + 2 * spec.radius), axis=-1)


def save_fill(bank: FillBank, name: str, provenance: dict) -> None:
    """Write the bank of a vessel, with its provenance."""
    arrays = {f.name: getattr(bank, f.name) for f in fields(FillBank)}
    write_arrays(fill_path(name), arrays, provenance)


def main(argv: Sequence[str] | None = None, prog: str = "agym-jax particles") -> int:
    """The command line; returns the exit status."""
    parser = argparse.ArgumentParser(
        prog=prog, description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("vessels", nargs="*", default=list(FILL_RECIPES), metavar="VESSEL")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--rows", type=int, default=64)
    args = parser.parse_args(argv)
    try:
        checked_count("--rows", args.rows)
        checked_count("--seed", args.seed, at_least=0)
        for name in args.vessels:  # the last of them too, before the first is built
            if name not in FILL_RECIPES:
                raise UnknownNameError("vessel", name, FILL_RECIPES)
        for name in args.vessels:
            bank, facts = build(name, args.seed, args.rows)
            command = f"agym-jax particles {name} --seed {args.seed} --rows {args.rows}"
            versions = {p: version(p) for p in ("jax", "numpy")}
            provenance = {"command": command, "seed": args.seed, "facts": facts}
            save_fill(bank, name, provenance | {"versions": versions})
            print(f"{name}: {facts}")
    except AgymError as error:
        print(error, file=sys.stderr)
        return 1
    return 0
