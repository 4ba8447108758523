# ruff: noqa: D103 (a test's name says what it shows)
"""Warp's wrappers of one of JAX's streams, without a GPU."""

from __future__ import annotations

import gc
import weakref
from types import SimpleNamespace

import mujoco
import pytest

from agym_jax.compat.warp_streams import hold_streams
from agym_jax.sim import mjx as mjx_physics

warp = pytest.importorskip("warp", reason='needs pip install "agym_jax[warp]"')
pytestmark = pytest.mark.warp


class Anything:
    """Something that can be told from its copies."""


@pytest.fixture
def calls(monkeypatch):
    """Calls of Warp's core, and a device that has it."""
    from warp._src import context

    hold_streams()
    made: list[tuple[str, int]] = []
    core = SimpleNamespace(
        wp_cuda_stream_register=lambda _, stream: made.append(("register", stream)),
        wp_cuda_stream_unregister=lambda _, stream: made.append(("unregister", stream)),
    )
    runtime = SimpleNamespace(core=core, get_device=lambda device: device)
    monkeypatch.setattr(context, "runtime", runtime)
    device = SimpleNamespace(runtime=runtime, context=None, is_cuda=True)
    return made, lambda stream: warp.Stream(device, cuda_stream=stream)


def test_a_stream_is_forgotten_with_its_last_wrapper(calls):
    made, wrap = calls
    first, second, other = wrap(7), wrap(7), wrap(8)
    del first
    gc.collect()
    assert ("unregister", 7) not in made
    del other
    gc.collect()
    assert made.count(("unregister", 8)) == 1 and ("unregister", 7) not in made
    del second
    gc.collect()
    assert made.count(("unregister", 7)) == 1
    third = wrap(7)
    assert made[-1] == ("register", 7)
    del third
    gc.collect()
    assert made.count(("unregister", 7)) == 2


def test_garbage_of_an_earlier_call_leaves_the_stream_of_this_one_alone(calls):
    made, wrap = calls
    garbage = SimpleNamespace(stream=wrap(7))
    garbage.itself = garbage
    del garbage
    now = wrap(7)
    gc.collect()
    assert ("unregister", 7) not in made
    del now
    gc.collect()
    assert made.count(("unregister", 7)) == 1


def test_patching_twice_is_patching_once():
    hold_streams()
    before = warp.Stream.__init__
    hold_streams()
    assert warp.Stream.__init__ is before


def test_streams_are_held_before_warp_gets_a_model(monkeypatch):
    done = []
    monkeypatch.setattr(mjx_physics, "hold_streams", lambda: done.append("held"))
    monkeypatch.setattr(mjx_physics, "compile_kernels", lambda *_: done.append("compiled"))
    ball = '<mujoco><worldbody><body><joint/><geom size="0.1"/></body></worldbody></mujoco>'
    mjx_physics.put_model(mujoco.MjModel.from_xml_string(ball), "warp")
    assert done == ["held", "compiled"]


def test_warp_still_keeps_the_frames_of_who_makes_a_function():
    def caller() -> weakref.ref:
        local = Anything()

        @warp.func(name="twice_for_a_test")
        def twice(x: float) -> float:
            return 2.0 * x

        return weakref.ref(local)

    gc.collect()
    gc.disable()
    try:
        assert caller()() is not None, "warp_streams.py may not be needed any more"
    finally:
        gc.enable()
