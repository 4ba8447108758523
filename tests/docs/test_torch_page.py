# ruff: noqa: D103
"""The examples in ``docs/torch.md`` train as they stand there: success rises."""

from __future__ import annotations

import re
import warnings
from pathlib import Path
from typing import Any

import pytest
from paths import ROOT

PAGE = (ROOT / "docs" / "torch.md").read_text()
BLOCKS = dict(re.findall(r'^```python title="(\w+)\.py"\n(.*?)^```$', PAGE, re.S | re.M))
TRAININGS = [name for name in BLOCKS if name.startswith("train_")]


def test_versions_are_those_that_ci_trains_with():
    pins = dict(line.split("==") for line in (ROOT / "constraints.txt").read_text().split())
    for name, version in re.findall(r"([A-Za-z][\w-]+) (\d+\.\d+\.\d+)", PAGE):
        assert pins[name.lower()] == version
    assert len(TRAININGS) == 4 and "success" in BLOCKS


def test_ci_runs_them_in_an_environment_with_the_extras():
    script = (ROOT / ".ci" / "run").read_text()
    assert '".[torch,rl,warp]"' in script and '-m "torch or warp"' in script


@pytest.mark.torch
@pytest.mark.slow
@pytest.mark.jit
@pytest.mark.parametrize("name", TRAININGS)
def test_an_example_learns_to_reach(name: str, tmp_path: Path, monkeypatch, capsys):
    pytest.importorskip("torch", reason='needs pip install "agym_jax[torch,rl]"')
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {"__name__": name}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of the libraries, about each other
        for part in ("success", name):
            exec(compile(BLOCKS[part], f"docs/torch.md:{part}", "exec"), names)
    assert names["before"] <= 0.05 and names["after"] >= 0.5
    assert f"{names['after']:.0%} after" in capsys.readouterr().out
