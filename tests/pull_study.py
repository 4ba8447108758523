"""Many scripted pulls over the range of people: how often a limb comes through the gown.

    python tests/pull_study.py [pulls] [side by side] [edge of the gown, m]

Also the study of resolution: success, force and hang at finer edges.
"""

from __future__ import annotations

import sys

import jax
import numpy as np
from cloth_world import Outcome, draw_pull, pull_on

from agym_jax.matter.gown import Cut, cut
from agym_jax.matter.hang import settle
from agym_jax.matter.weave import weave

STEPS = 560  # of 10 ms, at 0.15 m/s, the slowest


def main(count: int, batch: int, edge: float) -> None:
    """Pull, and print what came of it."""
    gown = settle(cut(Cut(edge=edge)))
    spec = weave(gown)
    pull = jax.jit(jax.vmap(lambda key: pull_on(spec, draw_pull(key), STEPS)[0]))
    keys = jax.random.split(jax.random.PRNGKey(0), count)
    parts = [jax.device_get(pull(keys[i : i + batch])) for i in range(0, count, batch)]
    out: Outcome = jax.tree.map(lambda *x: np.concatenate(x), *parts)
    print(
        f"{count} pulls, {spec.count} vertices, hangs {-gown.hanging[:, 2].min():.3f} m: "
        f"through in {np.sum(out.through > 0)}, broken in {np.sum(out.broken)}, best >= 0.4 m in "
        f"{100 * np.mean(out.best >= 0.4):.1f} %, progress > 0.8 in {100 * np.mean(out.progress > 0.8):.1f} %, "
        f"greatest force {np.median(out.force):.2f} N (99 %: {np.quantile(out.force, 0.99):.2f}), "
        f"deepest {1e3 * out.deepest.max():.1f} mm"
    )


if __name__ == "__main__":
    words = sys.argv[1:] + ["64", "32", "0.0241"][len(sys.argv) - 1 :]
    main(int(words[0]), int(words[1]), float(words[2]))
