# ruff: noqa: D103
"""People with AG's masses on the bed: the same landing in NumPy and JAX, and only where there is a bed."""

from __future__ import annotations

from types import SimpleNamespace

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

import agym_jax
from agym_jax.human import limits
from agym_jax.human.population import Population
from agym_jax.robots import ROBOTS
from agym_jax.sim.control import Controller
from agym_jax.sim.landing import REACH, RESTING, Landing
from agym_jax.sim.scene import build_scene
from agym_jax.tasks import TASKS
from benchmarks.parity import limp_arm
from benchmarks.parity.row import traces

FIELDS = ("geom_xpos", "geom_xmat", "xanchor", "xaxis")


def _controller(task: str, masses: str) -> Controller:
    return Controller.of(build_scene(TASKS[task], ROBOTS["Jaco"]), TASKS[task], False, masses)


def test_only_limp_arms_with_ags_masses_land():
    assert _controller("ArmManipulation", "ag").landing is not None
    assert _controller("ArmManipulation", "body").landing is None
    assert _controller("ScratchItch", "ag").landing is None  # an armrest is no bed
    model = build_scene(TASKS["ArmManipulation"], ROBOTS["Jaco"]).model
    early = _controller("ArmManipulation", "ag").model_of(model)
    (changed,) = np.nonzero(early.pair_margin != model.pair_margin)
    names = {early.geom(g).name for g in early.pair_geom1[changed]} | {
        early.geom(g).name for g in early.pair_geom2[changed]
    }
    assert all(n.startswith(("human/right_", "seat/")) for n in names)
    assert (early.pair_margin[changed] == RESTING).all()
    assert _controller("ArmManipulation", "body").model_of(model) is model
    assert _controller("ArmManipulation", "both").model_of(model) is model  # each person's own


@pytest.mark.parametrize(
    "name",
    ["ArmManipulationJaco-v0", "ScratchItchJaco-v0"],
)
@pytest.mark.slow
def test_where_both_masses_are_drawn_everybody_is_as_among_their_like(name: str):
    make = lambda masses: agym_jax.make(  # noqa: E731
        name, impl="native", humans=Population(masses=masses, impairments=("none",))
    )
    both, like = make("both"), {1.0: make("ag"), 0.0: make("body")}
    push, seen = np.full(7, 0.5, np.float32), set()
    for seed in range(12):
        key = jax.random.PRNGKey(seed)
        mine = both.reset(key)
        kind = float(mine.episode.human.at_joints)
        if kind in seen:
            continue
        seen.add(kind)
        theirs = like[kind].reset(key)
        for _ in range(8):
            mine, theirs = both.step(mine, push), like[kind].step(theirs, push)
        np.testing.assert_allclose(mine.data.qpos, theirs.data.qpos, atol=1e-5)
        np.testing.assert_allclose(mine.obs, theirs.obs, atol=1e-3)  # forces [N] are among them
        other = like[1.0 - kind].reset(key)
        for _ in range(8):
            other = like[1.0 - kind].step(other, push)
        assert np.abs(mine.data.qpos - other.data.qpos).max() > 1e-4
        if len(seen) == 2:
            return
    raise AssertionError(f"only {seen} of both")


@pytest.mark.parametrize("sex", [0, 1])
def test_distances_are_mujocos(sex: int):
    arm = limp_arm.person(sex)
    model, landing = arm.model, arm.controller.landing
    assert isinstance(landing, Landing)
    data, checked = mujoco.MjData(model), 0
    for q in traces("limp_arm")[f"{limp_arm.SEXES[sex]}_bed_start"]:
        data.qpos[arm.scene.index.human_qpos] = q
        mujoco.mj_kinematics(model, data)
        found = landing._nearest(model, data, np)[0]
        for a, b in {*zip(landing.limb.tolist(), landing.bed.tolist(), strict=True)}:
            mine = found[(landing.limb == a) & (landing.bed == b)].min()
            exact = mujoco.mj_geomDistance(model, data, a, b, 1.0, None)
            assert mine >= exact - 1e-6
            if model.geom_type[b] == mujoco.mjtGeom.mjGEOM_CAPSULE:
                assert mine == pytest.approx(exact, abs=1e-5)
                checked += 1
    assert checked > 30


def test_jax_lands_as_numpy_does():
    arm = limp_arm.person(0)
    model, index, landing = arm.model, arm.scene.index, arm.controller.landing
    assert isinstance(landing, Landing)
    data, changed = mujoco.MjData(model), 0
    data.qpos[index.human_qpos] = traces("limp_arm")["male_bed_start"][1]
    for _ in range(30):
        mujoco.mj_step(model, data)
        mobility = np.linalg.inv(arm.controller.human_motors.inertia(data.M, np))
        v = data.qvel[index.human_dof].copy()
        ours = landing.stop(v, mobility, model, data, 0.02, np)
        there = SimpleNamespace(**{f: jnp.asarray(getattr(data, f)) for f in FIELDS})
        sizes = SimpleNamespace(geom_size=jnp.asarray(model.geom_size))
        theirs = landing.stop(jnp.asarray(v), jnp.asarray(mobility), sizes, there, 0.02, jnp)
        np.testing.assert_allclose(theirs, ours, atol=2e-3)
        distance = landing._nearest(model, data, np)[0]
        if (distance > REACH).all():
            np.testing.assert_array_equal(ours, v)
        changed += not np.array_equal(ours, v)
        arm.after_step(data)
    assert changed > 0


@pytest.mark.parametrize(("masses", "limited"), [("ag", False), ("body", True)])
@pytest.mark.slow
def test_limits_of_the_pose_push_the_arms_of_still_people_but_not_with_ags_masses(
    masses: str, limited: bool, monkeypatch: pytest.MonkeyPatch
):
    def moved() -> np.ndarray:
        env = agym_jax.make(
            "ArmManipulationJaco-v0", impl="native", humans=Population(masses=masses)
        )
        state = env.step(env.reset(jax.random.PRNGKey(0)), np.zeros(7, np.float32))
        return np.asarray(state.data.qpos)[env.scene.index.human_qpos]

    usual = moved()
    monkeypatch.setattr(limits, "reachability", lambda *_: jnp.full(1, -1.0))
    monkeypatch.setattr(limits, "limit_torque", lambda *_: jnp.full(4, 5.0))
    assert (np.abs(moved() - usual).max() > 0.01) == limited
