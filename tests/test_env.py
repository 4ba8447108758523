# ruff: noqa: D103
"""The environment as a whole: what reset draws, what step keeps, how episodes end."""

from __future__ import annotations

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from brax import envs as brax_envs
from brax.envs.wrappers import training as brax_wrappers
from compiled import BATCH, STATIC, CompiledBatch, Rollout, roll
from products import full, full_in
from traced import Traced, traced

import agym_jax
from agym_jax import observe
from agym_jax.errors import ActionError, ImplementationError
from agym_jax.jax_settings import full_precision
from agym_jax.math3d import first_sign
from agym_jax.metrics import METRICS
from agym_jax.sim.physics import choose_impl
from agym_jax.wrappers import vectorize

jit = pytest.mark.jit


def _differ(values: Any) -> bool:
    """Whether all rows differ."""
    return len(np.unique(np.asarray(values), axis=0)) == len(values)


def _set(state: Any, name: str, **changes: Any) -> Any:
    """A state with some fields of its task or episode changed, dtypes kept."""
    old = getattr(state, name)
    same = {k: jnp.asarray(v, getattr(old, k).dtype) for k, v in changes.items()}
    return state.replace(**{name: dataclasses.replace(old, **same)})


# -- shapes, without compiling -----------------------------------------------------------------


def _avals(tree: Any) -> list:
    leaves = jax.tree.leaves_with_path(tree)
    return [(jax.tree_util.keystr(p), x.shape, x.dtype, x.weak_type) for p, x in leaves]


# a bed and a chair, one tool and two, a person who acts and one who does not, water; the rest of the product is data. Others begin in
# MJX in tests/sim/test_c_mujoco.py
TRACED = (STATIC,)
TRACED_SLOWLY = (
    "ArmManipulationPR2Human-v0", "BedBathingJacoHuman-v0", "ReachingBaxterHuman-v0", "DrinkingSawyer-v0",
)  # fmt: skip


@pytest.fixture(params=[*TRACED, *(pytest.param(x, marks=pytest.mark.slow) for x in TRACED_SLOWLY)])
def programs(request: pytest.FixtureRequest) -> Traced:
    """Reset and step of one of them; the first is compiled for the tests below."""
    return traced(request.param)


def test_step_returns_exactly_what_reset_returns(programs: Traced):
    env, first, second = programs.batch.env, programs.reset.out_info, programs.step.out_info
    assert jax.tree.structure(first) == jax.tree.structure(second)
    assert _avals(first) == _avals(second)
    assert not [path for path, *_, weak in _avals(first) if weak]
    assert first.obs.shape == (BATCH, env.observation_size)
    floats = [(p, d) for p, _, d, _ in _avals(first) if jnp.issubdtype(d, jnp.floating)]
    assert {d for _, d in floats} == {jnp.dtype("float32")}


@pytest.mark.slow
def test_brax_wrappers_accept_the_environment(static_env):
    env = brax_wrappers.EpisodeWrapper(brax_wrappers.VmapWrapper(static_env), 200, 1)
    first = jax.eval_shape(env.reset, jax.random.split(jax.random.PRNGKey(0), 3))
    assert first.obs.shape == (3, 30) and first.info["steps"].shape == (3,)
    after = jax.eval_shape(env.step, first, jax.ShapeDtypeStruct((3, env.action_size), jnp.float32))
    assert jax.tree.structure(first) == jax.tree.structure(after)
    assert after.info["truncation"].shape == (3,)
    assert isinstance(static_env, brax_envs.Env) and env.unwrapped is static_env


# -- refusals ----------------------------------------------------------------------------------


def test_actions_of_another_shape_are_refused(static_env, active_env):
    with pytest.raises(
        ActionError, match=r"ScratchItchJaco-v0 takes .*\(7,\) \(7 robot\), got \(6,\)"
    ):
        static_env.step(None, np.zeros(6))
    with pytest.raises(ActionError, match=r"\(17,\) \(7 robot \+ 10 human\), got \(7,\)"):
        active_env.step(None, np.zeros(7))
    with pytest.raises(ActionError, match=r"got \(4, 7\).*vectorize"):
        static_env.step(None, np.zeros((4, 7)))
    with pytest.raises(
        ActionError, match=r"batch of 2 takes actions of shape \(2, 7\), got \(7,\)"
    ):
        vectorize(static_env, 2).step(None, np.zeros(7))


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_actions_that_are_not_finite_are_refused_outside_of_jit(bad: float, static_env):
    with pytest.raises(ActionError, match="NaN or infinity"):
        static_env.step(None, np.array([0, 0, bad, 0, 0, 0, 0]))


def test_unknown_implementation_is_refused():
    with pytest.raises(ImplementationError, match=r"'warps'.*Did you mean 'warp'"):
        agym_jax.make(STATIC, impl="warps")
    assert choose_impl("jax") == "jax"


def test_products_are_never_rounded_to_tf32(programs: Traced):
    for program in (programs.reset, programs.step):
        found = full_in(program.jaxpr)
        assert len(found) > 10
        assert all(found)


def test_an_unguarded_product_would_be_found():
    matrix = jnp.ones((3, 3))
    assert full(full_precision(jax.jit(jnp.dot)), matrix, matrix) == [True]
    assert full(jax.jit(jnp.dot), matrix, matrix) == [False]
    assert full_in(jax.make_jaxpr(jnp.dot)(matrix, matrix)) == [False]


def test_reset_and_step_trace_no_more_than_they_need(programs: Traced):
    batch = programs.batch
    reset, step = batch.calls["reset"], batch.calls["step"]
    assert batch.traces == {"reset": 1, "step": 1}
    # a new episode: no reward, no physics, the kinematics of its start alone
    assert (reset["advance"], reset["rewards"], reset["step"], reset["forward"]) == (0, 0, 0, 0)
    assert (reset["kinematics"], reset["init"], reset["observe"]) == (1, 1, 1)
    # a step: each part once, and those of a new episode once more for the environments that begin one
    assert (step["advance"], step["rewards"], step["step"], step["forward"]) == (1, 1, 1, 0)
    assert (step["kinematics"], step["init"], step["observe"]) == (2, 1, 2)
    assert step["make_data"] == 0


def test_names_of_metrics_are_data(programs: Traced):
    env = programs.batch.env
    measures = [f"task/{x.name}" for x in env.task.measures]
    names = (*(f"reward/{x}" for x in env.task.reward_terms), *METRICS, "success", *measures)
    assert env.metric_names == names
    assert set(programs.reset.out_info.metrics) == set(programs.step.out_info.metrics) == set(names)


# -- compiled ----------------------------------------------------------------------------------


@jit
def test_same_seed_same_trajectory_bit_for_bit(batch: CompiledBatch, rollout: Rollout):
    again = roll(batch, 0, rollout.actions[:12])
    np.testing.assert_array_equal(again.obs, rollout.obs[:13])
    np.testing.assert_array_equal(again.reward, rollout.reward[:12])
    for name, values in again.metrics.items():
        np.testing.assert_array_equal(values, rollout.metrics[name][:12], err_msg=name)


@jit
def test_one_trace_serves_every_state(batch: CompiledBatch, rollout: Rollout):
    # a weak type or a changed shape in step's result would make the second call trace again
    assert batch.traces == {"reset": 1, "step": 1}


@jit
def test_environments_of_a_batch_have_different_people_targets_and_starts(rollout: Rollout):
    first = rollout.first
    human = first.episode.human
    assert set(np.asarray(human.sex)) == {0.0, 1.0}
    impaired = [human.limit_scale < 1, human.strength < 1, (human.tremor != 0).any(-1)]
    assert 0 < np.sum(impaired) < BATCH
    assert _differ(first.episode.placement.arm_angles)
    assert _differ(first.task.target_limb)
    assert _differ(first.key)
    assert 0 < np.sum(np.asarray(first.task.on_forearm)) < BATCH


@jit
def test_another_seed_is_another_batch(batch: CompiledBatch, rollout: Rollout):
    other = batch.reset(jax.random.PRNGKey(1))
    assert not np.array_equal(other.episode.human.sex, rollout.first.episode.human.sex)
    assert _differ(np.concatenate([other.task.target_limb, rollout.first.task.target_limb]))
    assert _differ(np.concatenate([other.obs, rollout.first.obs]))


@jit
def test_no_observation_entry_is_constant(batch: CompiledBatch, rollout: Rollout):
    names = [
        f"{name}[{i}]"
        for name, c in observe.columns(batch.env.task.robot_obs).items()
        for i in range(c.size)
    ]
    spread = rollout.obs.reshape(-1, len(names)).std(0)
    # a random policy seldom touches anything; test_parity.py sees this entry at work
    may_be_constant = {"tool_force[0]"}
    constant = {n for n, s in zip(names, spread, strict=True) if s < 1e-6}
    assert constant <= may_be_constant, constant
    assert np.isfinite(rollout.obs).all()


@jit
def test_observed_differences_fit_together(batch: CompiledBatch, rollout: Rollout):
    where = observe.layout(batch.env.task.robot_obs)
    part = {name: rollout.obs[..., where[name]] for name in where}
    np.testing.assert_allclose(
        part["tool_pos_target"], part["tool_pos_torso"] - part["target_pos_torso"], atol=1e-5
    )
    np.testing.assert_allclose(np.linalg.norm(part["tool_quat_w"], axis=-1), 1.0, atol=1e-5)
    # limbs keep their length: 0.279 m for a man, 0.264 m for a woman (humans.md section 2)
    length = np.linalg.norm(part["shoulder_pos_torso"] - part["elbow_pos_torso"], axis=-1)
    sex = np.asarray(rollout.first.episode.human.sex)
    np.testing.assert_allclose(
        length, np.broadcast_to(0.279 - 0.015 * sex, length.shape), atol=1e-5
    )
    # reset already shows the drawn start
    np.testing.assert_allclose(
        part["arm_angles"][0], rollout.first.episode.placement.arm_angles, atol=1e-6
    )


@jit
def test_quaternions_begin_with_bullets_sign_and_keep_it(batch: CompiledBatch, rollout: Rollout):
    quat = rollout.obs[..., observe.layout(batch.env.task.robot_obs)["tool_quat_w"]]
    np.testing.assert_allclose(quat[0], first_sign(quat[0]), atol=0)
    assert ((quat[1:] * quat[:-1]).sum(-1) > 0.9).all()
    last = np.asarray(rollout.last.past.quats)[:, 0]
    np.testing.assert_array_equal(last, quat[-1])
    # a turned state goes on turned; a new episode does not
    over = np.arange(BATCH) % 2 == 0
    state = _set(rollout.last, "episode", step=np.where(over, 199, 50))
    state = _set(state, "past", quats=-rollout.last.past.quats)
    after = batch.step(state, rollout.actions[0])
    seen = np.asarray(after.obs)[:, observe.layout(batch.env.task.robot_obs)["tool_quat_w"]]
    assert ((seen * last).sum(-1)[~over] < -0.9).all()
    np.testing.assert_array_equal(seen[over], first_sign(seen[over]))


@jit
def test_reward_is_the_sum_of_its_terms(rollout: Rollout):
    terms = {k: v for k, v in rollout.metrics.items() if k.startswith("reward/")}
    assert {"reward/distance", "reward/action", "reward/scratch"} <= set(terms)
    np.testing.assert_allclose(rollout.reward, sum(terms.values()), atol=1e-5)
    action = -0.01 * np.sum(rollout.actions**2, axis=-1)  # config.ini action_weight
    np.testing.assert_allclose(terms["reward/action"], action, rtol=1e-5)


@jit
def test_robot_moves_towards_the_joint_target(batch: CompiledBatch, rollout: Rollout):
    # tasks.md section 1.5: a full action moves a free joint 0.0566 rad in a control step
    state = batch.step(rollout.first, np.ones((BATCH, 7), np.float32))
    moved = state.data.qpos - rollout.first.data.qpos
    moved = np.asarray(moved)[:, batch.env.scene.index.robot_qpos]
    np.testing.assert_allclose(moved[:, -1], 0.0566, atol=5e-4)  # the wrist carries next to nothing
    # the others have 1 N m to accelerate the arm, and feel each other's reaction, which may throw one back
    assert (moved > -0.03).all() and (moved < 0.0566 + 5e-4).all()
    assert (moved.mean(-1) > 0.015).all()


@jit
def test_actions_beyond_the_box_act_as_its_border_and_are_penalised_as_asked_for(
    batch: CompiledBatch, rollout: Rollout
):
    one, many = (batch.step(rollout.first, np.full((BATCH, 7), x, np.float32)) for x in (1.0, 7.0))
    np.testing.assert_array_equal(one.obs, many.obs)
    # AG scratch_itch.py step: np.sum(np.square(action)) of the action before take_step clips it, times config.ini action_weight
    np.testing.assert_allclose(one.reward - many.reward, 0.01 * 7 * (7.0**2 - 1.0), rtol=1e-4)


@jit
def test_action_with_nan_acts_as_zero_under_jit(batch: CompiledBatch, rollout: Rollout):
    action = rollout.actions[0].copy()
    action[:, 2] = 0.0
    clean = batch.step(rollout.first, action)
    action[:, 2] = [np.nan, np.inf, -np.inf, np.nan, 0, 0, 0, np.nan]
    dirty = batch.step(rollout.first, action)
    np.testing.assert_array_equal(clean.obs, dirty.obs)
    np.testing.assert_array_equal(clean.reward, dirty.reward)
    assert (dirty.metrics["nan"] == 0).all()


@jit
def test_episodes_end_after_200_steps_and_not_before(batch: CompiledBatch, rollout: Rollout):
    state, still = rollout.first, np.zeros((BATCH, 7), np.float32)
    for i in range(200):  # tasks.md section 1.1
        assert (np.asarray(state.episode.step) == i).all()
        state = batch.step(state, still)
        assert (np.asarray(state.done) == (i == 199)).all()
        assert (np.asarray(state.info["truncation"]) == (i == 199)).all()
    assert (np.asarray(state.episode.step) == 0).all()
    assert np.isfinite(state.obs).all()


@jit
def test_a_finished_environment_starts_anew_and_the_others_go_on(
    batch: CompiledBatch, rollout: Rollout
):
    over = np.arange(BATCH) % 2 == 0
    state = _set(rollout.last, "episode", step=np.where(over, 199, 50))
    state = _set(state, "task", scratches=np.full(BATCH, 7.0))
    state = _set(state, "task", last_scratch_w=np.ones((BATCH, 3)))
    action = rollout.actions[0]
    after = batch.step(state, action)
    np.testing.assert_array_equal(after.done, over)
    np.testing.assert_array_equal(after.info["truncation"], over)
    # what goes on is as if nobody had finished
    alone = batch.step(_set(state, "episode", step=np.full(BATCH, 50)), action)
    same = lambda a, b: np.testing.assert_array_equal(np.asarray(a)[~over], np.asarray(b)[~over])  # noqa: E731
    for name in ("obs", "reward", "metrics", "task", "episode", "key"):
        jax.tree.map(same, getattr(after, name), getattr(alone, name))
    same(after.data.qpos, alone.data.qpos)
    np.testing.assert_array_equal(after.episode.step, np.where(over, 0, 51))
    np.testing.assert_array_equal(after.task.scratches, np.where(over, 0.0, alone.task.scratches))
    # the last observation and reward of the old episode are kept (tremor knows even from odd steps)
    np.testing.assert_array_equal(after.info["final_observation"][~over], after.obs[~over])
    assert (np.abs(after.info["final_observation"] - after.obs)[over].max(-1) > 1e-3).all()
    trembles = np.asarray(state.episode.human.tremor != 0.0).any(-1)
    assert trembles.any() and not trembles.all()
    for people, atol in ((~trembles, 1e-5), (trembles, 5e-2)):
        last, other = (x.info["final_observation"][people] for x in (after, alone))
        np.testing.assert_allclose(last, other, atol=atol)
    # and everything else is new
    for name, old, new in (
        ("target", state.task.target_limb, after.task.target_limb),
        ("start", state.episode.placement.arm_angles, after.episode.placement.arm_angles),
        ("key", state.key, after.key),
    ):
        changed = (np.asarray(old) != np.asarray(new)).any(-1)
        np.testing.assert_array_equal(changed, over, err_msg=name)
    fresh = np.asarray(after.task.last_scratch_w)[over]
    np.testing.assert_array_equal(fresh, 0.0)
    angles = np.asarray(after.data.qpos)[:, batch.env.scene.index.robot_qpos]
    np.testing.assert_array_equal(
        angles[over], np.asarray(after.episode.placement.arm_angles)[over]
    )
    assert (np.asarray(after.data.qvel)[over] == 0).all()
    assert (np.abs(np.asarray(after.data.qvel)[~over]).max(-1) > 0).all()


@jit
def test_people_change_from_episode_to_episode(batch: CompiledBatch, rollout: Rollout):
    state, seen = rollout.first, []
    for _ in range(6):
        state = batch.step(_set(state, "episode", step=np.full(BATCH, 199)), rollout.actions[0])
        p = state.episode.human
        seen.append(np.stack([p.sex, p.strength, p.limit_scale, p.tremor[:, 0]], -1))
    seen = np.array(seen)  # (episodes, environments, traits)
    assert all(len(np.unique(seen[:, i], axis=0)) > 1 for i in range(BATCH))
    # the body follows: the upper arm is as long as this person's, not the last one's
    data, index = state.data, batch.env.scene.index
    bodies = dict(zip(index.links, index.human_body, strict=True))
    shoulder, elbow = (data.xpos[:, bodies[x]] for x in ("right_upper_arm", "right_forearm"))
    length = np.linalg.norm(shoulder - elbow, axis=-1)
    np.testing.assert_allclose(
        length, 0.279 - 0.015 * np.asarray(state.episode.human.sex), atol=1e-5
    )


@jit
def test_an_environment_that_breaks_ends_its_episode_and_recovers(
    batch: CompiledBatch, rollout: Rollout
):
    sick, action = 3, rollout.actions[0]
    healthy = np.arange(BATCH) != sick
    data = rollout.first.data
    exploded = rollout.first.replace(data=data.replace(qvel=data.qvel.at[sick, 5].set(1e6)))
    np.testing.assert_array_equal(batch.step(exploded, action).metrics["nan"], ~healthy)
    broken = rollout.first.replace(data=data.replace(qpos=data.qpos.at[sick, 5].set(jnp.nan)))
    after, clean = batch.step(broken, action), batch.step(rollout.first, action)
    np.testing.assert_array_equal(after.done, ~healthy)
    np.testing.assert_array_equal(after.metrics["nan"], ~healthy)
    np.testing.assert_array_equal(after.info["truncation"], ~healthy)  # not a termination worth 0
    final = after.info["final_observation"]
    np.testing.assert_array_equal(final[sick], rollout.first.obs[sick])  # what can be seen last
    np.testing.assert_array_equal(final[healthy], after.obs[healthy])
    assert after.reward[sick] == 0.0
    np.testing.assert_array_equal(after.reward[healthy], clean.reward[healthy])
    np.testing.assert_array_equal(after.obs[healthy], clean.obs[healthy])
    state = after
    for step in range(4):
        for x in (
            state.obs,
            state.reward,
            state.info["final_observation"],
            *state.metrics.values(),
        ):
            assert np.isfinite(x).all(), step
        assert np.isfinite(state.data.qpos).all() and np.isfinite(state.data.qvel).all()
        jax.tree.map(
            lambda x: np.testing.assert_(np.isfinite(x).all()), (state.task, state.episode)
        )
        state = batch.step(state, action)
        assert (np.asarray(state.done) == 0).all() and (np.asarray(state.metrics["nan"]) == 0).all()
    assert state.episode.step[sick] == 4 and state.episode.step[0] == 5
    assert (np.abs(state.obs[sick]) > 0).sum() > 20


@jit
def test_stagger_spreads_the_clocks(batch: CompiledBatch, rollout: Rollout):
    for interval, distinct in ((None, BATCH // 2), (1, BATCH - 1)):
        state = batch.env.stagger(rollout.first, jax.random.PRNGKey(0), interval)
        steps = np.asarray(state.episode.step)
        assert steps.dtype == np.int32 and (steps >= 0).all() and (steps < 200).all()
        assert len(set(steps)) >= distinct and (steps % (interval or 25) == 0).all()
        assert jax.tree.structure(state) == jax.tree.structure(rollout.first)


@pytest.mark.parametrize(
    ("length", "interval"),
    [(200, 25), (100, 25), (50, 25), (40, 20), (26, 13), (29, 1), (7, 1), (25, 5), (1, 1)],
)
def test_resets_of_a_staggered_batch_come_at_regular_steps(static_env, length, interval):
    env = vectorize(static_env, 2)
    env.episode_length = length
    assert env.reset_interval == interval
