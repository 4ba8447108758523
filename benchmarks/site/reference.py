"""The reference: a page of ``mkdocstrings`` for each part of the package that users import."""

from __future__ import annotations

import importlib.util

SECTIONS = {
    "agym_jax": ("agym_jax",),
    "environments": ("agym_jax.env", "agym_jax.state", "agym_jax.wrappers", "agym_jax.registry"),
    "adapters": (
        "agym_jax.adapters.gymnasium", "agym_jax.adapters.vector", "agym_jax.adapters.pettingzoo",
        "agym_jax.adapters.brax", "agym_jax.adapters.torch", "agym_jax.adapters.rsl_rl", "agym_jax.adapters.skrl",
        "agym_jax.adapters.stable_baselines3",
    ),
    "people_and_robots": ("agym_jax.human.population", "agym_jax.human.regions", "agym_jax.variation", "agym_jax.changes"),
    "tasks": ("agym_jax.spec.task", "agym_jax.spec.optional", "agym_jax.spec.robot", "agym_jax.sense", "agym_jax.observe", "agym_jax.preferences"),
    "policies": ("agym_jax.policy.policy", "agym_jax.policy.agents", "agym_jax.policy.export"),
    "pictures": ("agym_jax.rendering.render", "agym_jax.rendering.clips"),
    "training": ("train.ppo", "train.coop", "train.evaluate", "train.configs"),
    "errors": ("agym_jax.errors", "train.errors"),
}  # fmt: skip
"""Page -> modules; those that there are."""


def pages() -> dict[str, str]:
    """Path below ``docs`` -> Markdown."""
    found = {}
    for name, modules in SECTIONS.items():
        there = [x for x in modules if importlib.util.find_spec(x)]
        title = name if name == "agym_jax" else name.replace("_", " ").capitalize()
        found[f"reference/{name}.md"] = (
            "\n\n".join([f"# {title}", *(f"::: {x}" for x in there)]) + "\n"
        )
    return found
