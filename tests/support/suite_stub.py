"""Stands for ``agym-jax`` in a suite: the real trainer and the real choice, in a fake environment that takes its time."""

from __future__ import annotations

import sys
import time
from pathlib import Path

from fake_env import FakeEnv

from train import ppo, select
from train.configs import PPOConfig
from train.runs.session import command_line


def make(name: str, impl: str) -> FakeEnv:
    """The fake environment under the name of a real one."""
    return FakeEnv(name=name)


def train(env, config, progress):
    """Train, slowly enough to be killed."""
    return ppo.train(env, config, progress, on_log=lambda row, policy: time.sleep(0.03))


if __name__ == "__main__":
    command, *words = sys.argv[1:]
    if command == "train":
        sys.exit(command_line(PPOConfig, train, words, make))
    if command == "select":
        sys.exit(select.main(words, make))
    Path(words[words.index("--clip") + 1]).write_bytes(b"a film")
