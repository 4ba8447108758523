# ruff: noqa: D103
"""Bad input is refused before anything long begins, by an error that names what was asked and what fits.

Each row is a call, the error, and what its message must contain; nothing here compiles or steps an environment.
"""

from __future__ import annotations

import math
import warnings
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import gymnasium
import jax
import mujoco
import numpy as np
import pytest

import agym_jax
import agym_jax.errors as e
from agym_jax.adapters.gymnasium import RenderModeError
from agym_jax.data.assets import asset_path
from agym_jax.data.npz import read_npz, write_npz
from agym_jax.human.population import Population
from agym_jax.offline import placements
from agym_jax.registry import list_envs, parse, register_robot, register_task
from agym_jax.rendering import Renderer
from agym_jax.rendering.clips import FrameError, OutputPathError, write_clip
from agym_jax.rendering.render import RenderBackendError, UnknownCameraError
from agym_jax.sim.physics import choose_impl
from agym_jax.wrappers import vectorize
from train import compare, coop, crossplay, demo, enjoy, evaluate, ppo, select, suite, sweep
from train.configs import CoopConfig, PPOConfig
from train.errors import ConfigError

ID = "ReachingJaco-v0"
NAN, INF = math.nan, math.inf


@pytest.fixture(scope="module")
def env() -> agym_jax.Env:
    """C MuJoCo: built in a second, and never stepped here."""
    return agym_jax.make(ID, impl="native")


@pytest.fixture(scope="module")
def envs(env: agym_jax.Env) -> Any:
    return vectorize(env, 4)


def refused(error: type[Exception], *told: str) -> Any:
    """The error, with all of this in its message."""
    together = "".join(f"(?=.*{part})" for part in told)
    return pytest.raises(error, match=f"(?s){together}")


# -- environments ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "error", "told"),
    [
        ({"name": None}, e.UnknownNameError, ("None", "task . robot")),
        ({"name": 7}, e.UnknownNameError, ("7", "task . robot")),
        ({"name": ""}, e.UnknownNameError, ("''", "task . robot")),
        ({"name": "JacoScratchItch-v0"}, e.UnknownNameError, ("mean 'ScratchItchJaco-v0'",)),
        ({"name": "JacoHumanFeeding-v0"}, e.UnknownNameError, ("mean 'FeedingJacoHuman-v0'",)),
        ({"name": "scratchitchjaco-v0"}, e.UnknownNameError, ("mean 'ScratchItchJaco-v0'",)),
        ({"name": "ScratchItchJaco"}, e.UnknownNameError, ("mean 'ScratchItchJaco-v0'",)),
        ({"name": "ScratchItchJaco-v1"}, e.UnknownNameError, ("mean 'ScratchItchJaco-v0'",)),
        ({"name": "ReachingPanda-v0"}, e.UnknownNameError, ("robot 'Panda'", "Sawyer")),
        ({"name": "no_module:ReachingJaco-v0"}, e.UnknownNameError, ("no_module", "PYTHONPATH")),
        ({"impl": None}, e.ImplementationError, ("None", "native")),
        ({"impl": "mjx"}, e.ImplementationError, ("'mjx'", "jax, native, warp")),
        ({"impl": 3}, e.ImplementationError, ("3", "native")),
        ({"humans": "children"}, e.ArgumentError, ("'children'", "Population")),
        ({"humans": {}}, e.ArgumentError, ("{}", "Population")),
        ({"humans": ""}, e.ArgumentError, ("''", "Population")),
        ({"humans": Population}, e.ArgumentError, ("class", "Population")),
        ({"num_envs": 0}, e.ArgumentError, ("num_envs", "at least 1", "0")),
        ({"num_envs": -2}, e.ArgumentError, ("num_envs", "-2")),
        ({"num_envs": "many"}, e.ArgumentError, ("num_envs", "'many'")),
        ({"num_envs": 2.0}, e.ArgumentError, ("num_envs", "2.0")),
        ({"num_envs": None}, e.ArgumentError, ("num_envs", "None")),
    ],
)
def test_environments(arguments, error, told):
    with refused(error, *told):
        agym_jax.make(**{"name": ID, "impl": "native", **arguments})


@pytest.mark.parametrize("num_envs", [0, -2, 2.5, "4", None, True, NAN])
def test_batches(env, num_envs):
    with refused(e.ArgumentError, "num_envs", "at least 1", repr(num_envs)):
        vectorize(env, num_envs)


@pytest.mark.parametrize("what", [ID, None, 4, agym_jax])
def test_what_is_no_environment_has_no_batch(what):
    with refused(e.ArgumentError, "takes an environment", "make" if what == ID else "got"):
        vectorize(what, 4)


@pytest.mark.parametrize(
    ("key", "told"),
    [
        (0, "got 0"),
        (None, "got None"),
        ("seed", "got 'seed'"),
        ([0, 1], "got .0, 1."),
        (np.zeros(2), "got array"),
        (np.arange(2), "got array"),
    ],
)
def test_keys(env, envs, key, told):
    for batch in (env, envs):
        with refused(e.ArgumentError, "jax.random.key", told):
            batch.reset(key)


def test_as_many_keys_as_environments(env, envs):
    three = jax.random.split(jax.random.key(0), 3)
    for keys in (three, jax.random.key_data(three)):
        with refused(e.ArgumentError, "or 4 of them", "keys of shape .3,."):
            envs.reset(keys)
        with refused(e.ArgumentError, "vectorize", "keys of shape .3,."):
            env.reset(keys)


@pytest.mark.parametrize(
    ("action", "error", "told"),
    [
        (np.zeros(3), e.ActionError, ("7",)),
        (np.zeros((4, 7)), e.ActionError, ("vectorize",)),
        (0.0, e.ActionError, ("7",)),
        (np.full(7, NAN), e.ActionError, ("NaN",)),
        (np.full(7, INF), e.ActionError, ("infinity",)),
    ],
)
def test_actions(env, action, error, told):
    with refused(error, ID, *told):
        env.step(SimpleNamespace(obs=np.zeros(env.observation_size)), action)


def test_states_of_another_batch(env, envs):
    def state(*shape: int) -> Any:
        return SimpleNamespace(obs=np.zeros((*shape, env.observation_size)))

    with refused(e.ArgumentError, "batch of 4", "vectorize"):
        env.step(state(4), np.zeros(7))
    for wrong in (state(), state(3), state(2, 4)):
        with refused(e.ArgumentError, "batch of 4", "its own reset and step"):
            envs.step(wrong, np.zeros((4, 7)))
    with refused(e.ActionError, "batch of 4"):
        envs.step(state(4), np.zeros((3, 7)))


@pytest.mark.parametrize("name", ["My Task", "", "Très", "9Lives", "a-b", "a:b", "TheHuman"])
def test_names_of_tasks_and_robots(name):
    before = list_envs()
    for register in (register_task, register_robot):
        with refused(e.SpecError, repr(name), "letters"):
            register(SimpleNamespace(name=name))
    assert list_envs() == before


def test_names_that_are_taken():
    with refused(e.SpecError, "Reaching", "already"):
        register_task(parse(ID).task)
    with refused(e.SpecError, "Jaco", "already"):
        register_robot(parse(ID).robot)


# -- populations -------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["blend", "stature", "girth"])
@pytest.mark.parametrize(
    "value",
    [(), (1.1, 0.9), (NAN, 1.1), (0.9, INF), (0.9,), (0.9, None), [0.9, 1.1], 1.0, ("a", "b")],
)
def test_ranges(name, value):
    with refused(e.ArgumentError, name, "low <= high"):
        Population(**{"sizes": "continuous", name: value})


@pytest.mark.parametrize(
    ("fields", "error", "told"),
    [
        ({"stature": (-0.1, 1.1)}, e.ArgumentError, ("stature", "-0.1", "0 < low")),
        ({"girth": (0.0, 1.1)}, e.ArgumentError, ("girth", "0 < low")),
        ({"sizes": "ag", "girth": (1.0, 1.1)}, e.ArgumentError, ("ignores girth", "continuous")),
        ({"sizes": "ag", "stature": (1.0, 1.1)}, e.ArgumentError, ("ignores stature",)),
        ({"sizes": "ag", "blend": (0.0, 1.0)}, e.ArgumentError, ("ignores blend",)),
        ({"sizes": "children"}, e.UnknownNameError, ("'children'", "continuous")),
        ({"sizes": None}, e.UnknownNameError, ("None", "continuous")),
        ({"masses": "real"}, e.UnknownNameError, ("'real'", "body")),
        ({"impairments": ()}, e.ArgumentError, ("none", "tremor")),
        ({"impairments": "tremor"}, e.ArgumentError, ("'tremor'", "tuple")),
        ({"impairments": ["tremor"]}, e.ArgumentError, ("tuple",)),
        ({"impairments": ("tremors",)}, e.UnknownNameError, ("mean 'tremor'",)),
        ({"impairments": (None,)}, e.UnknownNameError, ("None", "tremor")),
    ],
)
def test_populations(fields, error, told):
    with refused(error, *told):
        Population(**{"sizes": "continuous", **fields})


def test_a_range_of_one_size_is_a_size():
    assert Population("continuous", stature=(1.0, 1.0), girth=(1, 1)).girth == (1, 1)


# -- Gymnasium ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "error", "told"),
    [
        ({"render_mode": "depth"}, RenderModeError, ("'depth'", "rgb_array")),
        ({"width": 0}, e.ArgumentError, ("width", "0")),
        ({"height": -5}, e.ArgumentError, ("height", "-5")),
        ({"width": 64.0}, e.ArgumentError, ("width", "64.0")),
        ({"camera": "frnt"}, UnknownCameraError, ("mean 'front'",)),
        ({"camera": None}, UnknownCameraError, ("None", "front")),
        ({"visuals": "pretty"}, e.UnknownNameError, ("'pretty'", "meshes")),
        ({"humans": "children"}, e.ArgumentError, ("'children'", "Population")),
        ({"impl": "mjx"}, e.ImplementationError, ("'mjx'", "native")),
    ],
)
def test_gymnasium(arguments, error, told):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # gymnasium's own remark on render modes
        with refused(error, *told):
            gymnasium.make(ID, **arguments)


def test_gymnasium_options():
    with refused(e.AgymError, "no reset options", "difficulty"):
        gymnasium.make(ID).unwrapped.reset(options={"difficulty": 3})


# -- pictures ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "error", "told"),
    [
        ({"width": 0}, e.ArgumentError, ("width", "0")),
        ({"height": -5}, e.ArgumentError, ("height", "-5")),
        ({"camera": "side"}, UnknownCameraError, ("'side'", "-1")),
        ({"camera": "7"}, UnknownCameraError, ("7", "-1")),
        ({"backend": "vulkan"}, RenderBackendError, ("'vulkan'", "raycast")),
        ({"backend": None}, RenderBackendError, ("None", "raycast")),
    ],
)
def test_renderers(monkeypatch, arguments, error, told):
    monkeypatch.delenv("AGYM_JAX_RENDER", raising=False)
    model = mujoco.MjModel.from_xml_string("<mujoco/>")
    with refused(error, *told):
        Renderer(model, **{"camera": -1, "backend": "raycast", **arguments})


@pytest.mark.parametrize(
    ("frames", "name", "error", "told"),
    [
        ([], "a.gif", FrameError, ()),
        ([np.zeros((4, 4, 3))], "a.gif", FrameError, ()),
        ([np.zeros((4, 4, 3), np.uint8), np.zeros((5, 4, 3), np.uint8)], "a.gif", FrameError, ()),
        ([np.zeros((4, 4, 3), np.uint8)], "a.avi", OutputPathError, ("gif", "mp4")),
        ([np.zeros((4, 4, 3), np.uint8)], "", OutputPathError, ()),
    ],
)
def test_clips(tmp_path, frames, name, error, told):
    with refused(error, *told):
        write_clip(frames, tmp_path / name)


# -- settings of training ----------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "value"),
    [(name, value) for name in ("policy_hidden", "value_hidden") for value in ((), (0,), (64, -5))]
    + [(name, value) for name in ("value_loss_coef", "entropy_coef", "policy_head_gain")
       for value in (NAN, INF, -1.0)]
    + [(name, value) for name in ("lr", "eps", "clip_param", "init_noise_std", "reward_scaling")
       for value in (NAN, INF, 0.0, -1.0)]
    + [(name, value) for name in ("gamma", "gae_lambda", "entropy_decay_share")
       for value in (NAN, -0.1, 1.1)]
    + [("max_grad_norm", NAN), ("max_grad_norm", 0.0)]
    + [(name, 0) for name in ("num_env_steps", "num_steps", "ppo_epoch", "num_mini_batch", "num_seeds")]
    + [("cost_limit", NAN), ("cost_limit", -1.0), ("num_env_steps", 2**40)],
)  # fmt: skip
def test_settings(name, value):
    said = "none" if value == () else str(value[-1] if isinstance(value, tuple) else value)
    for kind in (PPOConfig, CoopConfig):
        with refused(ConfigError, name, said):
            kind(**{name: value})


def never(*_: Any) -> Any:
    raise AssertionError("an environment was built before the flags were checked")


@pytest.mark.parametrize(
    ("command", "words", "told"),
    [
        (ppo, ["--save-dir", ""], ("--save-dir is empty", "--save-dir .")),
        (coop, ["--save-dir", ""], ("--save-dir is empty", "--save-dir .")),
        (sweep, ["--grid", "lr=1e-3,1e-4", "--save-dir", ""], ("--save-dir is empty",)),
        (sweep, ["--grid", "lr=1e-3,1e-4", "--num-seeds", "0"], ("--num-seeds", "0")),
        (sweep, ["--grid", "speed=1,2"], ("'speed'", "entropy_coef")),
        (sweep, ["--grid", "lr=1e-3"], ("at least two settings",)),
        (suite, ["--save-dir", ""], ("--save-dir is empty",)),
        (suite, ["--num-seeds", "0"], ("--num-seeds", "0")),
        (suite, ["--num-episodes", "0"], ("--num-episodes", "0")),
        (suite, ["--parallel", "0"], ("--parallel", "0")),
        (suite, ["--only", "Cooking"], ("'Cooking'", "ArmManipulation")),
        (evaluate, ["--num-episodes", "0"], ("--num-episodes", "at least 1")),
        (crossplay, ["--robots", "zero", "--num-episodes", "0"], ("--num-episodes",)),
        (crossplay, [], ("--runs", "--robots")),
        (compare, ["a", "b", "--num-episodes", "0"], ("--num-episodes",)),
        (compare, ["a", "b"], ("/a has no policies", "--num-seeds 8")),
        (select, ["a", "--num-episodes", "0"], ("num_episodes", "at least 1")),
        (select, ["a", "--seed", "1001"], ("--report-seed",)),
        (select, ["no_such_run"], ("no policies", "--num-seeds")),
        (enjoy, ["--episodes", "0"], ("--episodes", "at least 1")),
        (enjoy, ["--width", "0"], ("--width", "at least 1")),
        (enjoy, ["--height", "0"], ("--height", "at least 1")),
        (enjoy, ["--camera", "frnt"], ("mean 'front'",)),
        (enjoy, ["--backend", "vulkan"], ("'vulkan'", "raycast")),
        (enjoy, ["--clip", "film.avi"], (".gif or .mp4",)),
        (enjoy, ["--sheet", "sheet.gif"], (".png",)),
        (enjoy, ["--viewer"], ("DISPLAY", "--clip")),
        (demo, ["--humans", "0"], ("--humans", "at least 1")),
        (demo, ["--num-env-steps", "0"], ("--num-env-steps", "at least 1")),
    ],
)
def test_command_lines(command, words, told, capsys, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    for screen in enjoy.SCREENS:
        monkeypatch.delenv(screen, raising=False)
    monkeypatch.setattr(enjoy.sys, "platform", "linux")
    try:
        status = command.main(words) if command is suite else command.main(words, never)
    except SystemExit as exit:  # of tyro, which draws a box around what it says
        status = exit.code
    said = " ".join(capsys.readouterr().err.split())
    assert status == 2 and all(part in said for part in told), said


@pytest.mark.parametrize(
    ("command", "words"),
    [
        (enjoy, ["--width", "-5"]),
        (enjoy, ["--episodes", "2.5"]),
        (evaluate, ["--num-episodes", "ten"]),
        (ppo, ["--lr", "fast"]),
        (ppo, ["--activation", "sine"]),
        (ppo, ["--num-env-steps", "nan"]),
    ],
)
def test_words_that_are_no_numbers_or_choices(command, words, capsys):
    with pytest.raises(SystemExit, match="2"):
        command.main(words, never)
    said = capsys.readouterr()
    assert words[0] in said.err + said.out


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["build", ID, "--size", "0"], "--size must be a whole number of at least 1"),
        (["build", ID, "--size", "-3"], "--size must be a whole number of at least 1"),
        (["build", ID, "JacoReaching-v0"], "Did you mean 'ReachingJaco-v0'?"),
    ],
)
def test_placements(words, told, capsys, monkeypatch):
    monkeypatch.setattr(placements, "search", never)
    assert placements.main(words) == 1
    assert told in capsys.readouterr().err


# -- policies ----------------------------------------------------------------------------------


def altered(path: Path, change: Any) -> Path:
    """A shipped policy with other arrays or another record."""
    arrays, meta = read_npz(asset_path(f"policies/{ID}.npz"))
    arrays = {name: np.array(array) for name, array in arrays.items()}
    change(arrays, meta)
    write_npz(path, arrays, meta)
    return path


def kernel(arrays: dict[str, np.ndarray]) -> str:
    return next(name for name in arrays if name.endswith("kernel"))


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda a, m: a[kernel(a)].__setitem__((0, 0), NAN), ("kernel", "no finite numbers")),
        (lambda a, m: a[kernel(a)].__setitem__((0, 0), INF), ("kernel", "no finite numbers")),
        (lambda a, m: a.pop(kernel(a)), ("it has no policy/.*kernel",)),
        (lambda a, m: a.update({kernel(a): np.zeros((2, 2), np.float32)}), ("shape .2, 2., not",)),
        (lambda a, m: a["observation/mean"].fill(NAN), ("observation/mean", "finite")),
        (lambda a, m: a["observation/std"].fill(0.0), ("observation/std", "positive")),
        (lambda a, m: a.pop("observation/std"), ("it has no observation/std",)),
        (lambda a, m: a.pop("observation/mean"), ("not a policy",)),
        (lambda a, m: m.update(arch={}), ("record of a network",)),
        (lambda a, m: m.update(arch=None), ("record of a network",)),
        (lambda a, m: m["arch"].update(activation="sine"), ("sine",)),
        (lambda a, m: m["arch"].update(layers=3), ("layers",)),
        (lambda a, m: m.update(format=7), ("format 7",)),
    ],
)
def test_policies_that_cannot_act(tmp_path, change, told):
    path = altered(tmp_path / "policy.npz", change)
    with refused(e.PolicyDamagedError, "policy.npz", *told):
        agym_jax.load_policy(path)


@pytest.mark.parametrize(
    "content",
    [b"", b"a text", b"PK\x03\x04 not really", b"\x80\x04\x95.", b"\x93NUMPY", b"x" * 5000],
)
def test_files_that_are_no_policies(tmp_path, content):
    path = tmp_path / "policy.npz"
    path.write_bytes(content)
    with refused(e.PolicyDamagedError, "policy.npz") as caught:
        agym_jax.load_policy(path)
    assert "pickle" not in str(caught.value)


def test_objects_are_not_loaded_and_nobody_is_told_how(tmp_path):
    np.savez(tmp_path / "policy.npz", a=np.array([{"code": 1}], dtype=object))
    (tmp_path / "text.npz").write_bytes(b"a text" + (tmp_path / "policy.npz").read_bytes())
    for name in ("policy.npz", "text.npz"):
        with refused(e.PolicyDamagedError, name) as caught:
            agym_jax.load_policy(tmp_path / name)
        assert "pickle" not in str(caught.value)


@pytest.mark.parametrize("source", ["no/such/file.npz", "nothing.npz", "JacoReaching-v0", "", None])
def test_policies_that_are_not_there(source):
    with refused(e.PolicyNotFoundError, str(source) if source else "There are"):
        agym_jax.load_policy(source)


@pytest.mark.parametrize("name", ["ones", "", "Zero"])
def test_baselines(name):
    with refused(e.UnknownNameError, repr(name), "random"):
        agym_jax.policy.baseline_policy(name, 7)


def test_implementations_are_named():
    with refused(e.ImplementationError, "'C'", "native"):
        choose_impl("C")
