"""Fixtures and hooks of all tests; what they are made of is in ``tests/support``."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator

import jax
import numpy as np
import pytest
from compiled import ACTIVE, BATCH, STATIC, CompiledBatch, Rollout, compile_batch, roll
from groups import arrange

import agym_jax
from agym_jax.jax_settings import enable_compilation_cache


def pytest_configure(config: pytest.Config) -> None:
    """Share compiled programs, small ones too, between workers and runs; ``--cache-clear`` forgets them."""
    if hasattr(config, "cache") and not hasattr(config, "workerinput"):
        os.environ.setdefault("AGYM_JAX_CACHE", str(config.cache.mkdir("xla")))
    enable_compilation_cache()
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)


@pytest.hookimpl(tryfirst=True)  # before xdist reads the marks
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Groups for ``--dist loadgroup``."""
    arrange(items)


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
