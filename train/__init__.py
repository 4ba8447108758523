"""Training, evaluation and replay of policies: ``agym-jax train``, or ``python -m train.ppo`` in a checkout.

``ppo`` trains one agent with PPO, ``coop`` robot and person, ``evaluate`` measures a policy over many
episodes, ``enjoy`` shows one. The learner is built around the networks, distributions and running
statistics of Brax; the training loop, checkpoints and policy files are our own. An installed wheel has
this folder as ``agym_jax.train``.
"""

from importlib.util import find_spec

from agym_jax.errors import MissingExtraError

_missing = [name for name in ("tyro", "rich", "matplotlib", "PIL") if not find_spec(name)]
if _missing:
    raise MissingExtraError(
        f'Training and its command lines need {", ".join(_missing)}: pip install "agym_jax[train]"'
    )
