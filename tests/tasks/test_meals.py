# ruff: noqa: D103
"""Whole meals: every episode begins with a full vessel, holding still spills nothing, and it can be done."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from meal_script import play

import agym_jax
from agym_jax.data.banks import load_bank
from agym_jax.human.capsules import link_capsules
from agym_jax.math3d import rotation_matrix
from agym_jax.matter.particles.checks import MatterError, capacity
from agym_jax.matter.particles.fill import fill, load_fill
from agym_jax.matter.particles.solver import Particles, ParticleSpec
from agym_jax.matter.shapes import columns
from agym_jax.offline import kinematics
from agym_jax.robots import ROBOTS
from agym_jax.sim.scene import build_scene
from agym_jax.spec import Pose
from agym_jax.tasks import TASKS
from agym_jax.tasks.drinking import INSIDE, side_of
from agym_jax.tasks.feeding import DISH
from agym_jax.tasks.shared import meals

PEOPLE = 24
VESSELS: dict[str, tuple[str, Pose]] = {"Feeding": ("spoon", DISH), "Drinking": ("cup", INSIDE)}
LIMBS = (*meals.TOUCHABLE, *meals.BELOW)


def spec_of(task: Any) -> ParticleSpec:
    return task.food if task.name == "Feeding" else task.water


def particles_of(state: Any) -> Particles:
    return state.task.food if hasattr(state.task, "food") else state.task.water


@cache
def env_of(name: str) -> Any:
    """One environment on C MuJoCo."""
    return agym_jax.make(name, impl="native")


@cache
def episodes(task: str) -> list[Any]:
    """How those of the people begin."""
    env = env_of(f"{task}Jaco-v0")
    return [env.reset(jax.random.PRNGKey(seed)) for seed in range(PEOPLE)]


@cache
def humans(task: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Their capsules, as they sit: both ends (PEOPLE, k, 3), radii (PEOPLE, k) [m]. No robot changes them."""
    env = env_of(f"{task}Jaco-v0")
    bodies = dict(zip(env.scene.index.links, env.scene.index.human_body, strict=True))
    found, capsules = [], jax.jit(link_capsules, static_argnums=1)
    for state in episodes(task):
        pos = {x: np.asarray(state.data.xpos)[bodies[x]] for x in LIMBS}
        rot = {x: rotation_matrix(np.asarray(state.data.xquat)[bodies[x]], np) for x in LIMBS}
        found.append(capsules(state.episode.human.dims, LIMBS, pos, rot))
    a, b, radius = (np.stack([np.asarray(x) for x in part]) for part in zip(*found, strict=True))
    return a, b, radius


@pytest.mark.parametrize("robot", ROBOTS)
@pytest.mark.parametrize("task", VESSELS)
def test_an_episode_begins_with_a_full_vessel_that_touches_nobody(task: str, robot: str):
    """Every placement of the bank with every one of the people: more than 10,000 draws."""
    name, frame = VESSELS[task]
    scene, bank = build_scene(TASKS[task], ROBOTS[robot]), load_bank(TASKS[task], ROBOTS[robot])
    index, spec = scene.index, spec_of(TASKS[task])
    chain = kinematics.chain_of(
        scene.model, index.robot_joint, index.tools[0].tip, index.robot_base
    )

    @jax.jit
    @jax.vmap
    def begin(angles: jax.Array, base: jax.Array, turn: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Particles in the world and in the vessel (n, 3)."""
        pos, rot, _ = kinematics.forward(chain, angles)
        inside = (
            rotation_matrix(turn, normalize=True)
            @ rot
            @ rotation_matrix(jnp.array(frame.quat), normalize=True)
        )
        where = base + rotation_matrix(turn, normalize=True) @ (pos + rot @ jnp.array(frame.pos))
        particles = fill(load_fill(name), where, quaternion(inside))
        return particles.pos_w, (particles.pos_w - where) @ inside

    pos_w, local = begin(*map(jnp.asarray, (bank.arm_angles, bank.base_pos, bank.base_quat)))
    assert pos_w.shape == (len(bank.base_pos), {"Feeding": 8, "Drinking": 64}[task], 3)
    assert len(pos_w) * PEOPLE > 10_000
    # in the vessel: within its rim, over its bottom, clear of its wall
    x, y, z = columns(local)
    assert (np.asarray(spec.vessel.polar(x, y)[0]) < spec.vessel.brim[0]).all()
    assert (np.asarray(z) > spec.radius / 2).all() and (
        z < spec.vessel.depth + 2 * spec.radius
    ).all()
    assert (
        np.asarray(spec.vessel.wall(x, y, z)[0]) - spec.vessel.thickness / 2 > 0.8 * spec.radius
    ).all()
    # not on the person: the closest particle of each placement, by a sphere around all of them
    middle = np.asarray(pos_w).mean(1)
    reach = np.linalg.norm(np.asarray(pos_w) - middle[:, None], axis=-1).max() + spec.radius
    a, b, radius = humans(task)
    away, axis = middle[:, None, None] - a, b - a
    square = np.maximum((axis * axis).sum(-1), 1e-12)
    share = np.clip((away * axis).sum(-1) / square, 0, 1)[..., None]
    gap = np.linalg.norm(away - share * axis, axis=-1) - radius
    assert gap.min() > reach


@pytest.mark.parametrize("robot", ROBOTS)
def test_the_side_of_the_person_is_assistive_gyms_sign(robot: str):
    """tasks.md section 5: Jaco's cup lies before the person at a roll of -pi/2, the others' at pi/2."""
    scene, bank = (
        build_scene(TASKS["Drinking"], ROBOTS[robot]),
        load_bank(TASKS["Drinking"], ROBOTS[robot]),
    )
    index = scene.index
    chain = kinematics.chain_of(
        scene.model, index.robot_joint, index.tools[0].tip, index.robot_base
    )
    mouths = jnp.stack([state.task.mouth_pos_w for state in episodes("Drinking")])

    @jax.jit
    @jax.vmap
    def sides(angles: jax.Array, base: jax.Array, turn: jax.Array) -> jax.Array:
        pos, rot, _ = kinematics.forward(chain, angles)
        cup = base + rotation_matrix(turn, normalize=True) @ pos
        turned = quaternion(rotation_matrix(turn, normalize=True) @ rot)
        return jax.vmap(lambda mouth: side_of(turned, mouth - cup))(mouths)

    found = sides(*map(jnp.asarray, (bank.arm_angles, bank.base_pos, bank.base_quat)))
    assert found.size > 10_000
    assert (np.asarray(found) == (-1.0 if robot == "Jaco" else 1.0)).all()


def quaternion(rot: jax.Array) -> jax.Array:
    """Of a rotation matrix (3, 3): the eigenvector wxyz (4,) of its largest eigenvalue."""
    (a, b, c), (d, e, f), (g, h, i) = rot
    upper = [[a + e + i, h - f, c - g, d - b], [h - f, a - e - i, b + d, c + g],
             [c - g, b + d, e - a - i, f + h], [d - b, c + g, f + h, i - a - e]]  # fmt: skip
    return jnp.linalg.eigh(jnp.array(upper))[1][:, -1]


@pytest.mark.slow
@pytest.mark.jit
@pytest.mark.parametrize("name", ["FeedingSawyer-v0", "DrinkingBaxter-v0"])
def test_a_robot_that_holds_still_spills_nothing(name: str):
    env = env_of(name)
    state = env.reset(jax.random.PRNGKey(5))
    begun = np.asarray(particles_of(state).pos_w)
    for _ in range(env.episode_length):
        state = env.step(state, np.zeros(env.action_size, np.float32))
        assert float(state.metrics["reward/preference_food_hit"]) == 0.0
    after = particles_of(state)
    assert after.alive.all() and int(state.task.lost) == 0 and state.done == 1.0
    moved = np.asarray(after.pos_w) - begun
    # the motors of Drinking, which aim at where the arm is, give way under the weight of the cup
    assert np.linalg.norm(moved.mean(axis=0)) < (0.04 if name.startswith("Drinking") else 0.01)
    assert np.linalg.norm(moved - moved.mean(axis=0), axis=-1).max() < 0.02


@pytest.mark.slow
@pytest.mark.jit
def test_a_scripted_spoon_feeds_all_there_is():
    state, _, total = play(env_of("FeedingSawyer-v0"), jax.random.PRNGKey(4))
    assert float(state.task.eaten) == 8.0 and not state.task.food.alive.any()
    assert total["reward/food"] == pytest.approx(8 * 20.0)
    assert float(env_of("FeedingSawyer-v0").task.success(state.task)) == 1.0


@pytest.mark.slow
@pytest.mark.jit
def test_a_scripted_cup_pours_nine_tenths_into_the_mouth():
    env = env_of("DrinkingBaxter-v0")
    state, _, total = play(env, jax.random.PRNGKey(5))
    assert float(state.task.drunk) >= 0.9 * 64
    assert total["reward/water"] >= 0.9 * 640 - 0.1 * 64
    assert float(env.task.success(state.task)) == 1.0


@pytest.mark.slow
@pytest.mark.jit
@pytest.mark.parity
def test_food_is_the_same_in_native_and_in_mjx():
    """The same key and actions: the same pieces, to what float32 makes of the arm."""
    name, key = "FeedingSawyer-v0", jax.random.PRNGKey(2)
    env, mjx = env_of(name), agym_jax.make(name, impl="jax")
    step, reset = jax.jit(mjx.step), jax.jit(mjx.reset)
    mine, theirs, rng = env.reset(key), reset(key), np.random.default_rng(0)
    np.testing.assert_allclose(particles_of(mine).pos_w, particles_of(theirs).pos_w, atol=1e-5)
    for _ in range(4):
        action = rng.uniform(-1, 1, env.action_size).astype(np.float32)
        mine, theirs = env.step(mine, action), step(theirs, action)
    a, b = particles_of(mine), particles_of(theirs)
    np.testing.assert_array_equal(a.alive, b.alive)
    np.testing.assert_allclose(a.pos_w, b.pos_w, atol=1e-4)
    assert (
        np.linalg.norm(np.asarray(a.pos_w - particles_of(env.reset(key)).pos_w), axis=-1).min()
        > 1e-3
    )


@pytest.mark.parametrize(("task", "field"), [("Feeding", "food"), ("Drinking", "water")])
def test_what_cannot_be_simulated_well_is_refused_when_it_is_asked_for(task: str, field: str):
    """With the limit: too many particles, a tool without an inside, a step in which walls are crossed."""
    whole = TASKS[task]
    spec = getattr(whole, field)
    most = capacity(spec.vessel, spec.radius)
    assert spec.count <= most
    with pytest.raises(MatterError, match=f"it holds {most}"):
        replace(whole, **{field: replace(spec, count=most + 1)})
    with pytest.raises(MatterError, match="need a vessel, got None"):
        replace(whole, **{field: replace(spec, vessel=None)})
    slow = replace(whole.control, time_step=0.1, frame_skip=1)
    with pytest.raises(MatterError, match=r"the limit is [\d.]+ m/s\. Use substeps=\d+"):
        replace(whole, control=slow)
