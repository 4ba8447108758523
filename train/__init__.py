"""Training, evaluation and replay of policies: ``agym-jax train``, or ``python -m train.ppo`` in a checkout.

``ppo`` trains a single agent with PPO, ``coop`` trains robot and person together, ``evaluate`` evaluates a policy over
many episodes, and ``enjoy`` displays it. The learner is built on Brax's networks, distributions and running statistics;
the training loop, checkpoints and policy files are our own. In an installed wheel this folder is ``agym_jax.train``.
"""

from importlib.util import find_spec

from agym_jax.errors import MissingExtraError

_missing = [name for name in ("tyro", "rich", "matplotlib", "PIL") if not find_spec(name)]
if _missing:
    raise MissingExtraError(
        f'Training and its command lines need {", ".join(_missing)}: pip install "agym_jax[train]"'
    )
