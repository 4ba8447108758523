"""Where curves and hyper-parameters go besides the run's folder: ``--logger tensorboard wandb trackio``, one file each.

A logger is given the rows that a checkpoint holds, after that is written. So a run that is killed and resumed continues
its log without rows twice or missing.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from importlib.util import find_spec

from agym_jax.errors import MissingExtraError, UnknownNameError

from ...errors import ConfigError
from ..curve import Row
from .protocol import Curves, LoggedRun, Logger

PACKAGES = {"tensorboard": "tensorboardX", "wandb": "wandb", "trackio": "trackio"}
"""Logger (and extra) -> package that it needs."""


def check_loggers(names: Sequence[str], save_dir: str | None) -> None:
    """Refuse loggers that cannot work, before anything is built.

    Raises:
        UnknownNameError: there is no such logger.
        MissingExtraError: its package is not installed; names the extra.
        ConfigError: the run has no folder.
    """
    for name in names:
        if name not in PACKAGES:
            raise UnknownNameError("logger", name, PACKAGES)
        if find_spec(PACKAGES[name]) is None:
            raise MissingExtraError(
                f'--logger {name} needs {PACKAGES[name]}: pip install "agym_jax[{name}]", or leave the logger out.'
            )
    if names and save_dir is None:
        raise ConfigError(
            f"--logger {' '.join(names)} needs the run's folder to continue its log, and --save-dir None has none. "
            f"Name a folder, or leave the logger out."
        )


def _make(name: str, run: LoggedRun) -> Logger:
    if name == "tensorboard":
        from .tensorboard import TensorBoard as Kind
    elif name == "wandb":
        from .wandb import Wandb as Kind
    else:
        from .trackio import Trackio as Kind
    return Kind(run)


class Loggers:
    """All loggers of a run.

    Args:
        names: of the loggers.
        run: what is logged.
        say: is told when a logger fails, which does not end the run.
    """

    def __init__(
        self, names: Sequence[str], run: LoggedRun | None, say: Callable[[str], None]
    ) -> None:
        self._say = say
        self._loggers = {name: _make(name, run) for name in dict.fromkeys(names)} if run else {}
        self._behind: set[str] = set()
        self._count: dict[str, int] = {}

    def begin(self, curves: Curves) -> None:
        """Open the logs, with what is known so far: rows before are a resumed run's.

        Raises:
            ConfigError: a service refuses; says how to do without it.
        """
        for logger in self._loggers.values():
            logger.begin(curves)
        self._count = {name: len(curve) for name, curve in curves.items()}

    def update(self, curves: Curves) -> None:
        """Log the rows that are new; a logger that failed is given all of them, until it works again."""
        new = {name: curve[self._count.get(name, 0) :] for name, curve in curves.items()}
        for name, logger in self._loggers.items():
            try:
                if name in self._behind:
                    logger.begin(curves)
                    self._behind.discard(name)
                else:
                    logger.add(new)
            except OSError as error:
                if name not in self._behind:
                    self._say(
                        f"--logger {name} failed: {error}. Tried again at the next checkpoint."
                    )
                self._behind.add(name)
        self._count = {name: len(curve) for name, curve in curves.items()}

    def close(self) -> None:
        """The session ends."""
        for name, logger in self._loggers.items():
            try:
                logger.close()
            except OSError as error:
                self._say(f"--logger {name} failed: {error}.")


def flat(settings: Mapping[str, object]) -> dict[str, bool | int | float | str]:
    """Settings as numbers and words: what loggers show as hyper-parameters; None is left out."""
    return {
        name: value if isinstance(value, bool | int | float | str) else str(value)
        for name, value in settings.items()
        if value is not None
    }


__all__ = ["Curves", "LoggedRun", "Logger", "Loggers", "Row", "check_loggers", "flat"]
