"""Several machines that train together: each runs the same command and holds a part of the environments."""

from __future__ import annotations

import jax
import numpy as np
from jax.experimental import multihost_utils

from ..errors import ConfigError

FORM = (
    "Write --hosts auto (SLURM, Open MPI, Cloud TPU), or --hosts ADDRESS:PORT,COUNT,INDEX, such as "
    "--hosts 10.0.0.1:8476,2,0 on the first of two machines and ...,2,1 on the second."
)


def parse_hosts(hosts: str) -> tuple[str, int, int] | None:
    """Address of machine 0, number of machines, index of this one; None for ``"auto"``.

    Raises:
        ConfigError: it is neither.
    """
    if hosts == "auto":
        return None
    address, *numbers = hosts.split(",")
    whole = len(numbers) == 2 and all(n.isascii() and n.isdigit() for n in numbers)
    host, _, port = address.rpartition(":")
    if not whole or not host or not port.isdigit() or int(numbers[0]) < 1:
        raise ConfigError(f"--hosts {hosts!r} names no machines. {FORM}")
    count, index = map(int, numbers)
    if index >= count:
        raise ConfigError(
            f"--hosts {hosts!r}: of {count} machines, the indices are 0 to {count - 1}. {FORM}"
        )
    return address, count, index


def join_hosts(hosts: str | None) -> None:
    """Join the other machines; comes before anything else that JAX does.

    Args:
        hosts: value of ``--hosts``; None for this machine alone.

    Raises:
        ConfigError: JAX cannot tell which machines, or does not reach them.
    """
    if hosts is None:
        return
    named = parse_hosts(hosts)
    try:
        if named is None:
            jax.distributed.initialize()
        else:
            jax.distributed.initialize(*named)
    except (ValueError, RuntimeError) as error:
        raise ConfigError(f"--hosts {hosts!r} did not work: {error} {FORM}") from error


def wait_for_hosts(what: str) -> None:
    """Go on when all hosts are here."""
    if jax.process_count() > 1:
        multihost_utils.sync_global_devices(what)


def check_agreement(what: str, value: int, advice: str) -> None:
    """Make sure that all hosts have the same number.

    Raises:
        ConfigError: they do not; says what each has.
    """
    if jax.process_count() > 1:
        values = np.unique(multihost_utils.process_allgather(np.int64(value)))
        if len(values) > 1:
            listed = ", ".join(str(v) for v in values)
            raise ConfigError(f"The hosts do not agree on {what}: {listed}. {advice}")
