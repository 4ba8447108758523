"""Training, evaluation and replay of policies: ``agym-jax train``, or ``python -m train.ppo`` in a checkout.

``ppo`` trains one agent with PPO, ``coop`` robot and person, ``evaluate`` measures a policy over many
episodes, ``enjoy`` shows one. The learner is built around the networks, distributions and running
statistics of Brax; the training loop, checkpoints and policy files are our own. An installed wheel has
this folder as ``agym_jax.train``.
"""

import sys
from importlib.util import find_spec

from agym_jax.errors import MissingExtraError
from agym_jax.interrupts import leave_quietly

_commands = f"{__name__}."
if sys.argv[:1] == ["-m"] and any(word.startswith(_commands) for word in sys.orig_argv):
    # python -m train.<command> is importing us; it has not begun
    leave_quietly()

_missing = [name for name in ("tyro", "rich", "matplotlib", "PIL") if not find_spec(name)]
if _missing:
    raise MissingExtraError(
        f'Training and its command lines need {", ".join(_missing)}: pip install "agym_jax[train]"'
    )
