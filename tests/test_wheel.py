# ruff: noqa: D103
"""The wheel is whole: built, installed into an empty place and used there, with nothing of the checkout in reach.

Python runs without ``site``, so that an editable installation beside it is not seen.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import sysconfig
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import pytest
from paths import PROCESS_SECONDS, ROOT

pytestmark = pytest.mark.slow
GIT = ("git", "-c", "user.name=a", "-c", "user.email=a@b.c")


@dataclass(frozen=True)
class Installed:
    """An installed wheel, in a repository of the user's.

    Attributes:
        target: where it was installed.
        folder: the user's, empty but for a train.py of their own.
    """

    target: Path
    folder: Path

    def run(self, *words: str) -> str:
        """What Python prints when it is given these words in the user's folder; it may not fail."""
        python_path = os.pathsep.join([str(self.target), sysconfig.get_path("purelib")])
        found = subprocess.run(
            [sys.executable, "-S", *words], cwd=self.folder, capture_output=True, text=True, check=False, timeout=PROCESS_SECONDS,
            env={"PYTHONPATH": python_path, "PATH": os.environ["PATH"], "JAX_PLATFORMS": "cpu",
                 "HOME": str(self.folder), "AGYM_JAX_CACHE": os.environ.get("AGYM_JAX_CACHE", "off"),
                 "XLA_FLAGS": os.environ.get("XLA_FLAGS", "")},
        )  # fmt: skip
        assert found.returncode == 0, found.stderr + found.stdout
        return found.stdout

    def agym_jax(self, *words: str) -> str:
        """What ``python -m agym_jax`` prints."""
        return self.run("-m", "agym_jax", *words)


def pip(*words: str) -> None:
    command = [sys.executable, "-m", "pip", "--quiet", "--disable-pip-version-check", *words]
    subprocess.run(command, check=True, timeout=PROCESS_SECONDS)


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Installed:
    """The wheel of this checkout."""
    home = tmp_path_factory.mktemp("home")
    subprocess.run([*GIT, "init", "--quiet", home], check=True)
    subprocess.run(
        [*GIT, "-C", home, "commit", "--quiet", "--allow-empty", "-m", "mine"], check=True
    )
    pip("wheel", "--no-deps", "--wheel-dir", str(home / "wheel"), str(ROOT))
    (wheel,) = (home / "wheel").iterdir()
    pip("install", "--no-deps", "--target", str(home / "site"), str(wheel))
    folder = home / "empty"
    folder.mkdir()
    (folder / "train.py").write_text("raise SystemExit('the train.py of the user was run')\n")
    return Installed(home / "site", folder)


def files(folder: Path, names: Sequence[str] = ("*",)) -> set[str]:
    found = (path for name in names for path in folder.rglob(name) if path.is_file())
    return {p.relative_to(folder).as_posix() for p in found if "__pycache__" not in p.parts}


def test_one_package_is_installed_with_all_of_its_parts(installed: Installed):
    there = {path.name for path in installed.target.iterdir() if path.suffix != ".dist-info"}
    assert there == {"agym_jax", "bin"}
    package = installed.target / "agym_jax"
    assert files(package / "assets") == files(ROOT / "assets")
    assert files(package / "train") == files(ROOT / "train", ["*.py"])
    own = files(package) - {
        f"{part}/{x}" for part in ("assets", "train") for x in files(package / part)
    }
    assert own == files(ROOT / "agym_jax")


def test_it_is_imported_from_where_it_was_installed(installed: Installed):
    said = installed.run(
        "-c", "import agym_jax, agym_jax.train.ppo as ppo; print(agym_jax.__file__, ppo.__file__)"
    )
    assert all(Path(path).is_relative_to(installed.target) for path in said.split())
    assert installed.agym_jax("--version").strip() == _version()


def _version() -> str:
    import agym_jax

    return agym_jax.__version__


def test_a_shipped_policy_acts(installed: Installed):
    code = (
        "import agym_jax, numpy as np; "
        "policy, pair = map(agym_jax.load_policy, ('ScratchItchJaco-v0', 'FeedingPR2Human-v0')); "
        "print(policy(np.zeros(30)).shape, pair(np.zeros((2, 25 + 23))).shape)"
    )
    assert installed.run("-c", code).strip() == "(7,) (2, 11)"


def test_a_policy_is_measured_and_the_users_repository_is_not_ours(installed: Installed):
    words = "evaluate --env-name ReachingJaco-v0 --num-episodes 2 --impl native --json out.jsonl"
    assert "ReachingJaco-v0, 2 episodes" in installed.agym_jax(*words.split())
    line = json.loads((installed.folder / "out.jsonl").read_text())
    assert line["commit"] is None and line["versions"]["agym_jax"] == _version()


def test_a_film_is_drawn(installed: Installed):
    words = (
        "enjoy --env-name ReachingJaco-v0 --clip film.gif --width 32 --height 24 --backend raycast"
    )
    assert "film.gif" in installed.agym_jax(*words.split())
    assert (installed.folder / "film.gif").read_bytes()[:3] == b"GIF"


def test_a_policy_is_trained_measured_and_loaded(installed: Installed):
    words = "--env-name ReachingJaco-v0 --num-env-steps 80 --num-envs 4 --num-mini-batch 1 --save-dir runs"
    assert "ReachingJaco-v0: trained 80 steps" in installed.agym_jax("train", *words.split())
    words = "--env-name ReachingJaco-v0 --load-dir runs --num-episodes 1 --impl native"
    assert "ReachingJaco-v0, 1 episodes" in installed.agym_jax("evaluate", *words.split())
    code = "import agym_jax; print(agym_jax.load_policy('runs/ReachingJaco-v0').info['env_steps'])"
    assert installed.run("-c", code).strip() == "80"


@pytest.mark.parametrize("command", ["coop", "crossplay", "demo"])
def test_the_other_tools_start(installed: Installed, command: str):
    assert f"usage: python -m agym_jax {command} " in installed.agym_jax(command, "--help")


def test_the_console_script_is_the_same(installed: Installed):
    script = str(installed.target / "bin" / "agym-jax")
    assert "usage: agym-jax COMMAND" in installed.run(script, "--help")
    assert "usage: agym-jax evaluate " in installed.run(script, "evaluate", "--help")
    assert len(installed.run(script, "list").split()) == 56
    assert "damaged" not in installed.run(script, "placements", "report")
