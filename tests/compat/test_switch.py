# ruff: noqa: D103
"""``AGYM_JAX_COMPAT`` says which repairs of other packages are applied."""

from __future__ import annotations

import pytest

from agym_jax.compat import switch
from agym_jax.errors import UnknownNameError


@pytest.mark.parametrize(
    ("value", "applied"),
    [
        (None, True),
        ("", True),
        ("on", True),
        ("off", False),
        ("-brax_jax", False),
        ("-mjx_quat, -brax_jax", False),
        ("-mjx_quat", True),
        ("brax_jax", True),
        ("mjx_quat", False),
    ],
)
def test_the_variable_switches_a_repair(value: str | None, applied: bool, monkeypatch):
    if value is None:
        monkeypatch.delenv(switch.VARIABLE, raising=False)
    else:
        monkeypatch.setenv(switch.VARIABLE, value)
    assert switch.enabled("brax_jax") is applied


def test_every_module_beside_it_is_a_repair():
    assert {"brax_jax", "mjx_quat", "warp_streams"} <= set(switch.repairs())
    assert "switch" not in switch.repairs()


def test_a_repair_that_does_not_exist_is_refused(monkeypatch):
    monkeypatch.delenv(switch.VARIABLE, raising=False)
    with pytest.raises(UnknownNameError, match=r"'brax_jacks'.*Did you mean 'brax_jax'"):
        switch.enabled("brax_jacks")
    monkeypatch.setenv(switch.VARIABLE, "-brax_jacks")
    with pytest.raises(UnknownNameError, match=r"Did you mean 'brax_jax'.*AGYM_JAX_COMPAT"):
        switch.enabled("mjx_quat")


def test_a_list_that_both_takes_and_leaves_out_is_refused(monkeypatch):
    monkeypatch.setenv(switch.VARIABLE, "mjx_quat,-brax_jax")
    with pytest.raises(switch.CompatError, match="both"):
        switch.enabled("mjx_quat")
