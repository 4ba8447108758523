"""Training, evaluation and replay of policies; runs from a checkout (``python -m train.ppo``).

``train.ppo`` trains one agent with PPO, ``train.evaluate`` measures a policy over many episodes,
``train.enjoy`` shows one. The learner is built around the networks, distributions and running
statistics of Brax; the training loop, checkpoints and policy files are our own.
"""

import agym_jax.compat.mjx_quat  # noqa: F401 (Brax imports MJX, which is quiet only when imported like this)
