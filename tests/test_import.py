# ruff: noqa: D103
"""Importing has no effects that surprise. Each test is a program of its own, which has imported nothing yet."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from paths import PROCESS_SECONDS, ROOT

MODULES = "agym_jax, agym_jax.env, agym_jax.wrappers, agym_jax.registry, agym_jax.policy, agym_jax.tasks.dressing"


def run(code: str, folder: Path, **settings: str) -> str:
    """What a program prints; it may not fail."""
    found = subprocess.run(
        [sys.executable, "-W", "error::RuntimeWarning", "-c", code],
        cwd=folder, capture_output=True, text=True, check=False, timeout=PROCESS_SECONDS,
        env={"PYTHONPATH": str(ROOT), "PATH": "", "JAX_PLATFORMS": "cpu", "HOME": str(folder)} | settings,
    )  # fmt: skip
    assert found.returncode == 0, found.stderr
    return found.stdout


def test_the_package_is_imported_without_jax_tasks_or_a_word(tmp_path: Path):
    said = run(
        "import os, sys, warnings, gymnasium  # which sets some of these itself\n"
        "before = sys.stdout, list(warnings.filters), list(sys.meta_path), list(sys.path)\n"
        "variables = dict(os.environ)\n"
        "import agym_jax\n"
        "heavy = {'jax', 'mujoco', 'brax', 'agym_jax.tasks.dressing', 'agym_jax.spec', 'agym_jax.env'}\n"
        "assert not heavy & set(sys.modules), heavy & set(sys.modules)\n"
        "assert before == (sys.stdout, list(warnings.filters), list(sys.meta_path), list(sys.path))\n"
        "assert variables == dict(os.environ)\n"
        "assert len(agym_jax.list_envs()) == 56 and not heavy & set(sys.modules)\n",
        tmp_path,
    )
    assert said == "" and not list(tmp_path.iterdir())


def test_no_module_changes_jaxs_settings_or_weaves(tmp_path: Path):
    said = run(
        "import sys, jax\n"
        "before = dict(jax.config.values)\n"
        f"import {MODULES}\n"
        "changed = {k for k, v in jax.config.values.items() if v != before[k]}\n"
        "assert not changed, changed\n"
        "assert jax.config.jax_compilation_cache_dir is None\n"
        "from agym_jax.tasks.dressing import DRESSING\n"
        "assert 'spec' not in vars(DRESSING)\n"
        "from jax._src import xla_bridge\n"
        "assert not xla_bridge._backends  # no device was asked for\n",
        tmp_path,
    )
    assert said == "" and not list(tmp_path.iterdir())


def test_it_imports_little_besides_jax(tmp_path: Path):
    """What takes long to import is imported where it is needed. Modules are counted, for no clock is the same twice."""
    said = run(
        "import sys, jax\n"
        "before = set(sys.modules)\n"
        "import agym_jax, agym_jax.registry, agym_jax.tasks.dressing\n"
        "new = {x.split('.')[0] for x in set(sys.modules) - before}\n"
        "print(len(set(sys.modules) - before), *sorted(new - set(sys.stdlib_module_names)))\n",
        tmp_path,
    )
    count, *packages = said.split()
    allowed = {"agym_jax", "numpy", "gymnasium", "farama_notifications"}
    assert {x for x in packages if not x.startswith("_")} <= allowed
    assert int(count) < 200, said


def test_programs_are_cached_from_the_first_environment_on(tmp_path: Path):
    """Even if JAX has compiled something before, when there was no cache."""
    cache = tmp_path / "cache"
    run(
        "import jax\n"
        "jax.jit(lambda x: x + 1)(1.0)\n"
        "import agym_jax\n"
        "agym_jax.make('ReachingJaco-v0', impl='native')\n"
        f"assert jax.config.jax_compilation_cache_dir == {str(cache)!r}\n"
        "jax.config.update('jax_persistent_cache_min_compile_time_secs', 0.0)\n"
        "jax.jit(lambda x: x * x - 3)(2.0)\n",
        tmp_path,
        AGYM_JAX_CACHE=str(cache),
    )
    assert any(path.name.startswith("jit__lambda") for path in cache.iterdir())


@pytest.mark.parametrize(
    ("variable", "configured", "wanted"),
    [("off", None, None), ("", "mine", "mine"), ("other", "mine", "mine"), ("", None, "{home}")],
)
def test_a_users_own_cache_is_left_alone(tmp_path: Path, variable, configured, wanted):
    said = run(
        "import jax\n"
        f"jax.config.update('jax_compilation_cache_dir', {configured!r})\n"
        "from agym_jax.jax_settings import enable_compilation_cache\n"
        "enable_compilation_cache()\n"
        "enable_compilation_cache()\n"
        "print(jax.config.jax_compilation_cache_dir)",
        tmp_path,
        AGYM_JAX_CACHE=variable,
    )
    home = tmp_path / ".cache" / "agym_jax" / "xla"
    assert said.strip() == str(wanted).format(home=home)


# -- gymnasium -----------------------------------------------------------------------------------


@pytest.mark.parametrize("order", ["agym_jax, gymnasium", "gymnasium, agym_jax"])
def test_gymnasium_knows_the_ids_and_nothing_else_is_new(tmp_path: Path, order: str):
    said = run(
        f"import {order}, sys\n"
        "ours = agym_jax.list_envs()\n"
        "spec = gymnasium.spec('ScratchItchJaco-v0')\n"
        "new = {name for name, x in gymnasium.registry.items() if 'agym_jax' in str(x.entry_point)}\n"
        "assert new == set(ours) and gymnasium.spec('CartPole-v1')\n"
        "agym_jax.register_envs()  # again: no warning, nothing new\n"
        "assert gymnasium.spec('ScratchItchJaco-v0') is spec\n"
        "assert 'jax' not in sys.modules and 'agym_jax.adapters.gymnasium' not in sys.modules\n",
        tmp_path,
    )
    assert said == ""


def test_gymnasium_imports_the_module_before_the_colon(tmp_path: Path):
    """Of ours, or of a plug-in that has called ``register_envs``."""
    (tmp_path / "mine.py").write_text(
        "import dataclasses, agym_jax\n"
        "from agym_jax.registry import register_task\n"
        "from agym_jax.tasks import TASKS\n"
        "register_task(dataclasses.replace(TASKS['Reaching'], name='Waving'))\n"
        "agym_jax.register_envs()\n"
    )
    run(
        "import gymnasium\n"
        "env = gymnasium.make('agym_jax:ReachingJaco-v0')\n"
        "assert env.spec.id == 'ReachingJaco-v0' and env.action_space.shape == (7,)\n"
        "try:\n"
        "    gymnasium.make('mine:WavingJaco-v0')\n"
        "except Exception as error:\n"
        "    assert type(error).__name__ == 'MissingPlacementError', error\n"
        "assert gymnasium.spec('WavingJaco-v0').kwargs == {'env_id': 'WavingJaco-v0'}\n",
        tmp_path,
    )
