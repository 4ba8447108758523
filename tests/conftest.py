"""Fixtures and hooks of all tests; what they are made of is in ``tests/support``."""

from __future__ import annotations

import gc
import os
import signal
from collections.abc import Iterator
from typing import Any

import jax
import numpy as np
import pytest
from compiled import ACTIVE, BATCH, STATIC, CompiledBatch, Rollout, compile_batch, roll
from groups import arrange, scheduler
from xla_flags import compile_quickly

import agym_jax
from agym_jax.jax_settings import enable_compilation_cache


def pytest_configure(config: pytest.Config) -> None:
    """Compile quickly; share compiled programs, small ones too, between workers and runs (``--cache-clear`` forgets them)."""
    compile_quickly()
    if hasattr(config, "cache") and not hasattr(config, "workerinput"):
        os.environ.setdefault("AGYM_JAX_CACHE", str(config.cache.mkdir("xla")))
    enable_compilation_cache()
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """The longest groups of tests come first."""
    arrange(items)


def pytest_collection_finish() -> None:
    """The garbage collector leaves alone what was imported and collected, and looks less often: JAX makes many objects that stay."""
    gc.freeze()
    gc.set_threshold(100_000, 50, 100)


@pytest.hookimpl(optionalhook=True)  # of pytest-xdist
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """``--dist loadgroup`` hands out our groups."""
    return scheduler(config, log) if config.getoption("dist") == "loadgroup" else None


@pytest.fixture(autouse=True)
def interruptible() -> Iterator[None]:
    """A shell lets what it starts in the background ignore SIGINT; tests run as in the foreground."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    yield


@pytest.fixture(scope="session")
def batch() -> CompiledBatch:
    """Eight environments of a person who does not act."""
    return compile_batch(STATIC)


@pytest.fixture(scope="session")
def rollout(batch: CompiledBatch) -> Rollout:
    """Thirty random steps."""
    actions = np.random.default_rng(0).uniform(-1, 1, (30, BATCH, batch.env.action_size))
    return roll(batch, 0, actions.astype(np.float32))


@pytest.fixture(scope="session")
def static_env() -> agym_jax.Env:
    """The environment of one environment, not compiled."""
    return agym_jax.make(STATIC, impl="jax")


@pytest.fixture(scope="session")
def active_env() -> agym_jax.Env:
    """The same with a person who acts."""
    return agym_jax.make(ACTIVE, impl="jax")


@pytest.fixture
def restored_settings() -> Iterator[None]:
    """What a command line of ``train`` sets in this process is as before after the test."""
    handler = signal.getsignal(signal.SIGTERM)
    yield
    signal.signal(signal.SIGTERM, handler)


@pytest.fixture
def raycast(monkeypatch: pytest.MonkeyPatch) -> None:
    """Draw without OpenGL."""
    monkeypatch.setitem(os.environ, "AGYM_JAX_RENDER", "raycast")
