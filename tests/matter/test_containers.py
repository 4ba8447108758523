# ruff: noqa: D103
"""Food in the spoon and water in the cup: settling, carrying, pouring and spilling without leaks."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from xla_flags import RUN_QUICKLY

from agym_jax.data.npz import provenance_of, read_arrays
from agym_jax.errors import MissingFillError, UnknownNameError
from agym_jax.math3d import axis_angle_quat, rotation_matrix
from agym_jax.matter.particles import fill as fills
from agym_jax.matter.particles.fill import fill, fill_path, load_fill
from agym_jax.matter.particles.solver import FOOD, WATER, Contact, Obstacles, Particles, advance
from agym_jax.matter.shapes import columns, no_boxes, no_capsules
from agym_jax.offline import particle_fill

NUM_ENVS, PERIOD = 4, 0.1
PARTS = {"spoon": (FOOD, 0.01), "cup": (WATER, 0.01)}
UPRIGHT = np.array([1.0, 0, 0, 0])
Pose = tuple[np.ndarray, np.ndarray]
Path_of = Callable[[np.ndarray], Pose]
BOTH = pytest.mark.parametrize("name", ["spoon", "cup"])


def motion(pos: np.ndarray, quat: np.ndarray) -> Obstacles:
    """A vessel along a trajectory (..., T, 3), (..., T, 4), without other obstacles."""
    ends = jnp.zeros((*pos.shape[:-1], 0, 3))
    human = replace(no_capsules(), a_w=ends, b_w=ends)
    return Obstacles(
        jnp.asarray(pos, jnp.float32),
        jnp.asarray(quat, jnp.float32),
        human,
        no_boxes(),
        jnp.float32(-5),
    )


@pytest.fixture(scope="module")
def moves() -> dict[str, Any]:
    """Control steps of 0.1 s of four environments, by vessel."""
    axes = Obstacles(0, 0, replace(no_capsules(), a_w=0, b_w=0, radius=None), None, None)  # type: ignore
    return {
        name: jax.jit(
            jax.vmap(lambda p, m, s=spec, d=dt: advance(s, p, m, d), in_axes=(0, axes)),
            compiler_options=RUN_QUICKLY,
        )
        for name, (spec, dt) in PARTS.items()
    }


def about(axis: Any, angle: Any) -> np.ndarray:
    """Quaternions wxyz (..., 4) of turns about one axis."""
    return axis_angle_quat(np.asarray(axis, float), np.asarray(angle), np)


def play(
    moves: dict[str, Any], name: str, path: Path_of, time: float
) -> tuple[Particles, list, np.ndarray]:
    """Move a filled vessel along a path, one in each environment.

    Args:
        moves: the fixture.
        name: of the vessel.
        path: times (T,) -> positions (NUM_ENVS, T, 3) and quaternions (NUM_ENVS, T, 4).
        time: how long [s].

    Returns:
        particles; at the end of every control step, contacts; particles that are out (steps, NUM_ENVS).
    """
    spec, dt = PARTS[name]
    steps = round(PERIOD / dt)
    pos, quat = path(np.arange(round(time / PERIOD) * steps + 1) * dt)
    state = jax.vmap(lambda p, q: fill(load_fill(name), p, q))(
        *(jnp.asarray(x[:, 0], jnp.float32) for x in (pos, quat))
    )
    contacts, out = [], []
    for i in range(0, pos.shape[1] - 1, steps):
        part = slice(i, i + steps + 1)
        state, contact = moves[name](state, motion(pos[:, part], quat[:, part]))
        contacts.append(jax.tree.map(np.asarray, contact))
        local = in_vessel(state, pos[:, i + steps], quat[:, i + steps])
        radius = np.asarray(spec.vessel.polar(*columns(local)[:2])[0])
        held = (radius < spec.vessel.brim[0]) & (local[..., 2] > 0)
        out.append((~held | (local[..., 2] > spec.vessel.depth + 0.02)).sum(1))
    return state, contacts, np.array(out)


def in_vessel(state: Particles, pos: np.ndarray, quat: np.ndarray) -> np.ndarray:
    rot = np.asarray(rotation_matrix(jnp.asarray(quat, jnp.float32), normalize=True))
    return np.einsum("wji,wnj->wni", rot, np.asarray(state.pos_w) - pos[:, None])


def straight(distance: Callable[[np.ndarray], np.ndarray], ways: Any) -> Path_of:
    """Upright vessels on straight paths, one per environment."""

    def path(t: np.ndarray) -> Pose:
        pos = distance(t)[:, None] * np.asarray(ways, float)[:, None] + [0.0, 0.0, 1.0]
        return pos, np.broadcast_to(UPRIGHT, (*pos.shape[:2], 4))

    return path


def turned(angle: Callable[[np.ndarray], np.ndarray]) -> Path_of:
    """Vessels that turn in place, in four directions."""

    def path(t: np.ndarray) -> Pose:
        axes = ((1, 0, 0), (0, 1, 0), (-1, 0, 0), (-0.6, -0.8, 0))
        quat = np.stack([about(a, angle(t)) for a in axes])
        return np.broadcast_to([0.0, 0.0, 1.0], (*quat.shape[:2], 3)), quat

    return path


DIRECTIONS = ((1, 0, 0), (0, 1, 0), (0, 0, 1), (0.6, 0.5, 0.6))


@pytest.mark.slow
@pytest.mark.parametrize(("name", "tilt", "time"), [("spoon", 0.0, 20), ("spoon", 11.0, 20), ("spoon", 20.0, 20), ("cup", 0.0, 4), ("cup", 10.0, 4)])  # fmt: skip
def test_resting_vessel_spills_nothing(moves: Any, name: str, tilt: float, time: float) -> None:
    """For food as long as an episode; the number of particles is constant."""
    state, contacts, out = play(moves, name, turned(lambda t: 0 * t + np.deg2rad(tilt)), time)
    assert not out.any()
    assert np.all(state.alive)
    assert sum(int(c.lost.sum()) for c in contacts) == 0
    vessel = np.mean([c.vessel for c in contacts])
    assert 0.2 < vessel < 1.01
    assert not np.any([[c.human.any(), c.furniture.any(), c.floor.any()] for c in contacts])


def energy(state: Particles) -> tuple[np.ndarray, np.ndarray]:
    """Potential and kinetic energy of a particle, mean of each environment [J/kg]."""
    potential = 9.81 * np.asarray(state.pos_w)[..., 2].mean(1)
    return potential, np.square(state.vel_w).sum(-1).mean(1) / 2


@pytest.mark.slow
@BOTH
def test_energy_at_rest_does_not_grow(moves: Any, name: str) -> None:
    state, quiet = None, turned(lambda t: 0 * t)
    levels = []
    for time in (0.1, 0.5, 1.0, 2.0, 3.0):
        state, *_ = play(moves, name, quiet, time)
        levels.append(energy(state))
    potential, kinetic = (np.array(x) for x in zip(*levels, strict=True))
    assert kinetic.max() < 1e-5  # 4.5 mm/s
    assert (np.diff(potential, axis=0) < 9.81 * 2e-4).all()  # 0.2 mm
    assert abs(potential[-1] - potential[0]).max() < 9.81 * 5e-4


@BOTH
def test_vessel_carried_at_arm_speed_spills_nothing(moves: Any, name: str) -> None:
    """Back and forth at up to 0.5 m/s and 2 m/s^2, in several directions: more than the arms' greatest actions."""
    sway = straight(lambda t: 0.125 * (1 - np.cos(4 * t)), DIRECTIONS)
    _, _, out = play(moves, name, sway, 2.0)
    assert not out.any()


@pytest.mark.parametrize(("name", "least"), [("spoon", 8), ("cup", 10)])
def test_jerked_vessel_spills(moves: Any, name: str, least: int) -> None:
    """Carried at 2 m/s and stopped within one physics step."""
    stop = straight(lambda t: 2.0 * np.minimum(t, 0.3), [(0.7, 0, 0.7), (0, 0.7, 0.7), (-0.7, 0, 0.7), (0.5, 0.5, 0.7)])  # fmt: skip
    state, _, out = play(moves, name, stop, 1.0)
    assert (out[-1] >= least).all()
    assert np.all(state.alive)


def level_pour_angle(packing: float) -> float:
    """Tilt [deg] at which the level surface of the cup's content reaches the rim, by counting points."""
    cup, rng = WATER.vessel, np.random.default_rng(0)
    points = rng.uniform(-1, 1, (100_000, 3)) * [0.042, 0.042, cup.depth / 2]
    points[:, 2] += cup.floor + cup.depth / 2
    wide = (
        cup.floor_radius
        + (cup.rim_radius - cup.floor_radius) * (points[:, 2] - cup.floor) / cup.depth
    )
    inside = np.hypot(points[:, 0], points[:, 1]) < wide
    content = WATER.count * 4 / 3 * np.pi * WATER.radius**3 / packing
    for tilt in np.arange(40.0, 90.0, 0.5):
        up = np.array([np.sin(np.deg2rad(tilt)), 0, np.cos(np.deg2rad(tilt))])
        below = points @ up < np.array([-cup.rim_radius, 0, cup.rim_height]) @ up
        if (inside & below).mean() * 0.084**2 * cup.depth < content:
            return float(tilt)
    raise AssertionError("more than the cup holds")


def test_cup_pours_when_the_level_reaches_the_rim(moves: Any) -> None:
    """Not before, and, as spheres heap up, some 10 to 20 degrees later; MuJoCo's rolling spheres: 85 to 90.

    Half is out at 92 degrees and all at 100 with spheres of friction 0.25 that roll in MuJoCo.
    """
    level = level_pour_angle(packing=0.6)
    assert 70 < level < 77
    rate = 30.0
    state, _, out = play(moves, "cup", turned(lambda t: np.deg2rad(rate * t)), 120 / rate)
    tilt = rate * PERIOD * np.arange(1, len(out) + 1)
    first = np.array([tilt[np.argmax(o > 0)] for o in out.T])
    half = np.array([tilt[np.argmax(o >= 32)] for o in out.T])
    assert (first > level).all() and (first < level + 27).all()
    assert (half > 88).all() and (half <= 105).all()  # told every 3 degrees
    assert (out[-1] == 64).all()
    assert np.all(state.alive)


def test_spoon_keeps_food_up_to_20_degrees_and_loses_it_by_80(moves: Any) -> None:
    """MuJoCo's rolling spheres of friction 0.25 leave a spoon one by one from 20 to 50 degrees."""
    rate = 15.0
    _, _, out = play(moves, "spoon", turned(lambda t: np.deg2rad(rate * t)), 81 / rate)
    tilt = rate * PERIOD * np.arange(1, len(out) + 1)
    assert not out[tilt < 20].any()
    assert (out[tilt > 50].min(0) >= 3).all()
    assert (out[-1] == 8).all()


def test_shaken_water_does_not_pass_the_wall() -> None:
    """At up to 2 m/s and 30 rad/s (50 and 750 in accelerations) all leave by the opening or stay."""
    spec, dt = PARTS["cup"]
    t = np.arange(round(1.0 / dt) + 1) * dt
    swing, sway = 30.0 / 25 * np.sin(25 * t), 0.08 * np.sin(25 * t + 1)
    pos = np.stack([sway, 0.5 * sway, 1 + 0.5 * sway[::-1]], -1)
    quat = about((0.8, 0.6, 0), swing)
    turns, places = (
        rotation_matrix(jnp.asarray(quat, jnp.float32), normalize=True),
        jnp.asarray(pos, jnp.float32),
    )

    @jax.jit
    def shake(state: Particles) -> jax.Array:
        def one(state: Particles, now: tuple) -> tuple[Particles, jax.Array]:
            where, turn, p, q = now
            state, _ = advance(spec, state, motion(p, q), dt)  # type: ignore
            return state, (state.pos_w - where) @ turn

        both = lambda x: jnp.stack([x[:-1], x[1:]], 1)  # noqa: E731
        now = places[1:], turns[1:], both(places), both(jnp.asarray(quat, jnp.float32))
        return jax.lax.scan(one, state, now)[1]

    state = fill(load_fill("cup"), places[0], jnp.asarray(quat[0], jnp.float32))
    first = np.asarray(fill(load_fill("cup"), jnp.zeros(3), jnp.asarray(UPRIGHT)).pos_w)
    local = np.concatenate([first[None], shake(state)])
    assert np.isfinite(local).all()
    held = np.asarray(spec.vessel.holds(*columns(local)))
    changed = held[1:] != held[:-1]
    assert changed.sum() > 5
    # in a step of dt a particle comes at most this far: it changed sides near the opening
    near = spec.vessel.brim[1] - 6.0 * dt
    assert (np.maximum(local[1:, :, 2], local[:-1, :, 2])[changed] > near).all()
    gap = np.asarray(spec.vessel.wall(*columns(local))[0]) - spec.radius - spec.vessel.thickness / 2
    assert (
        gap.min() > -0.9 * spec.radius
    )  # pressed in at 50 m/s^2 and by the rest, never to the middle


@BOTH
def test_fill_banks_are_at_rest_inside_the_vessel(name: str) -> None:
    spec, how, bank = PARTS[name][0], particle_fill.FILL_RECIPES[name], load_fill(name)
    rows = len(bank.gravity_dir)
    assert rows == 64 and bank.pos.shape == (rows, spec.count, 3)
    np.testing.assert_allclose(
        bank.gravity_dir, particle_fill.directions(rows, how.tilt), atol=1e-6
    )
    tilt = np.arccos(np.clip(-bank.gravity_dir[:, 2], -1, 1))
    assert tilt[0] < 1e-3 and tilt.max() == pytest.approx(how.tilt, abs=1e-3)
    gap = np.linalg.norm(bank.pos[:, :, None] - bank.pos[:, None], axis=-1) + np.eye(spec.count)
    assert gap.min() > 2 * spec.radius - 0.0013
    wall = np.asarray(spec.vessel.wall(*columns(bank.pos))[0]) - spec.vessel.thickness / 2
    assert wall.min() > spec.radius - 0.0005
    arrays = read_arrays(fill_path(name), "bank", {}, MissingFillError, "")
    provenance = provenance_of(arrays)
    assert provenance["command"].endswith(f" {name} --seed 0 --rows 64")
    assert fill_path(name).stat().st_size < 100_000


def test_settled_water_matches_assistive_gym() -> None:
    """Reference tasks.md section 5: mean height 0.0195, at most 0.036, within 0.028 of the axis."""
    pos = load_fill("cup").pos[0]
    assert pos[:, 2].mean() == pytest.approx(0.0195, abs=0.0025)
    assert pos[:, 2].max() < 0.036
    assert np.abs(pos[:, :2]).max() < 0.028


def test_settled_food_matches_assistive_gym() -> None:
    """Reference furniture.md section 7, above the spoon's inside: 0.0047 to 0.0117, mean 0.0082."""
    pos = load_fill("spoon").pos[0]
    assert pos[:, 2].mean() == pytest.approx(0.0082, abs=0.002)
    assert pos[:, 2].max() < 0.012
    assert np.abs(pos[:, 0]).max() < 0.012 and np.abs(pos[:, 1]).max() < 0.018


def test_fill_takes_the_nearest_tilt() -> None:
    bank = load_fill("spoon")
    for row in (0, 17, 63):
        quat = particle_fill.tilted(bank.gravity_dir[row].astype(float))
        state = fill(bank, jnp.array([1.0, 2.0, 3.0]), jnp.asarray(quat, jnp.float32))
        rot = np.asarray(rotation_matrix(jnp.asarray(quat), normalize=True))
        np.testing.assert_allclose(rot @ bank.gravity_dir[row], [0, 0, -1], atol=1e-5)
        np.testing.assert_allclose(state.pos_w, [1, 2, 3] + bank.pos[row] @ rot.T, atol=1e-5)
        assert np.all(state.alive) and not np.any(state.vel_w)


def test_missing_or_damaged_bank_names_the_command_that_builds_it(
    tmp_path: Path, monkeypatch: Any
) -> None:
    with pytest.raises(UnknownNameError, match=r"Unknown vessel 'mug'.*cup, spoon"):
        load_fill("mug")
    load = load_fill.__wrapped__
    monkeypatch.setattr(fills, "fill_path", lambda name: tmp_path / f"{name}.npz")
    with pytest.raises(MissingFillError, match=r"no bank .*agym-jax particles cup"):
        load("cup")
    (tmp_path / "cup.npz").write_bytes(b"PK not a bank")
    with pytest.raises(MissingFillError, match=r"damaged: .*agym-jax particles cup"):
        load("cup")
    np.savez(tmp_path / "cup.npz", gravity_dir=np.zeros((3, 3)), pos=np.zeros((3, 8, 3)))
    with pytest.raises(MissingFillError, match="damaged"):
        load("cup")


def test_command_line_builds_and_saves_a_bank(
    tmp_path: Path, monkeypatch: Any, capsys: Any
) -> None:
    """Two rows, two grids each, through the command line."""
    how = particle_fill.FILL_RECIPES["spoon"]
    coarse = replace(how.spec, substeps=2, sweeps=1)  # quick to compile
    monkeypatch.setitem(particle_fill.FILL_RECIPES, "spoon", replace(how, spec=coarse, tries=2))
    for module in (particle_fill, fills):
        monkeypatch.setattr(module, "fill_path", lambda name: tmp_path / f"{name}.npz")
    assert particle_fill.main(["spoon", "--rows", "2", "--seed", "3"]) == 0
    bank = load_fill.__wrapped__("spoon")
    assert bank.pos.shape == (2, 8, 3) and np.isfinite(bank.pos).all()
    assert "deepest_overlap" in capsys.readouterr().out
    assert particle_fill.main(["mug"]) == 1
    assert "Unknown vessel 'mug'" in capsys.readouterr().err


def test_contact_fields_are_masks() -> None:
    assert set(Contact.__dataclass_fields__) == {"vessel", "human", "furniture", "floor", "lost"}
