"""One switch for all repairs of other packages: the environment variable ``AGYM_JAX_COMPAT``.

========================  =================================================
``AGYM_JAX_COMPAT``       repairs that are applied
========================  =================================================
unset, empty or ``on``    all
``off``                   none
``-mjx_quat,-brax_jax``   all but these
``mjx_quat``              only these
========================  =================================================

A repair's name is that of its module in ``agym_jax.compat``.
"""

from __future__ import annotations

import os
import pkgutil
from importlib import metadata
from pathlib import Path

from agym_jax.errors import AgymError, UnknownNameError

VARIABLE = "AGYM_JAX_COMPAT"


class CompatError(AgymError, ValueError):
    """A value of ``AGYM_JAX_COMPAT`` that says two things at once."""


def repairs() -> list[str]:
    """Names of the repairs there are."""
    modules = pkgutil.iter_modules([str(Path(__file__).parent)])
    return sorted(module.name for module in modules if module.name != "switch")


def enabled(name: str) -> bool:
    """Whether a repair is to be applied, as ``AGYM_JAX_COMPAT`` is now.

    Args:
        name: of the repair.

    Raises:
        UnknownNameError: there is no such repair, or the variable names one that does not exist.
        CompatError: the variable both lists repairs and leaves some out.
    """
    known = repairs()
    if name not in known:
        raise UnknownNameError("repair", name, known)
    value = os.environ.get(VARIABLE, "").strip()
    if value in ("", "on", "off"):
        return value != "off"
    words = [word.strip() for word in value.split(",") if word.strip()]
    left_out = {word.removeprefix("-") for word in words if word.startswith("-")}
    chosen = {word for word in words if not word.startswith("-")}
    for word in sorted(left_out | chosen):
        if word not in known:
            advice = (
                f'{VARIABLE} is {value!r}; write "off", or names, each with "-" to leave it out.'
            )
            raise UnknownNameError("repair", word, known, advice)
    if left_out and chosen:
        raise CompatError(
            f"{VARIABLE}={value!r} both lists repairs and leaves some out. Write either names "
            f"(only these are applied) or names with '-' before each (all others are)."
        )
    return name in chosen if chosen else name not in left_out


def applies(name: str, package: str, first: str, before: str) -> bool:
    """Whether a repair is switched on and meant for the installed version of a package.

    Args:
        name: of the repair.
        package: that it repairs, as it is installed.
        first: the first version it is known to be needed for.
        before: the first version nobody has looked at.
    """
    try:
        installed = _parts(metadata.version(package))
    except metadata.PackageNotFoundError:
        return False
    return enabled(name) and _parts(first) <= installed < _parts(before)


def _parts(version: str) -> tuple[int, ...]:
    """Numbers of a version: ``"3.17.0rc1"`` is (3, 17, 0)."""
    digits = ("".join(c for c in part if c.isdigit()) or "0" for part in version.split(".")[:3])
    return tuple(int(part) for part in digits)
