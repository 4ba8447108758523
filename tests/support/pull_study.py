"""Many scripted pulls over the range of people: how often a limb comes through the gown.

    python tests/support/pull_study.py [pulls] [side by side] [edges of the gown, m ...]

With several edges it is the study of resolution: success, force and hang, coarse to fine; finer gowns get the
substeps that they need. Every edge adds a line to ``benchmarks/results/pulls.jsonl``.
"""

from __future__ import annotations

import sys
import time

import jax
import numpy as np
from cloth_scene import Outcome, draw_pull, pull_on

from agym_jax.matter.cloth.hang import settle
from agym_jax.matter.cloth.topology import build_cloth
from agym_jax.offline.gown import GownMeasures, build_gown
from benchmarks.markdown import RESULTS
from train.runs.record import append_record, record

STEPS = 560  # of 10 ms, at 0.15 m/s, the slowest


def main(count: int, batch: int, edge: float) -> None:
    """Pull, and print what came of it."""
    gown = settle(build_gown(GownMeasures(edge=edge)))
    spec = build_cloth(gown)
    pull = jax.jit(jax.vmap(lambda key: pull_on(spec, draw_pull(key), STEPS)[0]))
    keys = jax.random.split(jax.random.PRNGKey(0), count)
    start = time.perf_counter()
    parts = []
    for i in range(0, count, batch):
        parts.append(jax.device_get(pull(keys[i : i + batch])))
        print(
            f"{min(i + batch, count)} of {count}, {time.perf_counter() - start:.0f} s", flush=True
        )
    out: Outcome = jax.tree.map(lambda *x: np.concatenate(x), *parts)
    row = record(
        "pulls",
        edge_m=edge,
        vertices=spec.count,
        substeps=spec.substeps,
        pulls=count,
        through=int(np.sum(out.through > 0)),
        broken=int(np.sum(out.broken)),
        hang_m=float(-gown.hanging[:, 2].min()),
        beyond_0_4_m=float(np.mean(out.best >= 0.4)),
        progress_above_0_8=float(np.mean(out.progress > 0.8)),
        force_median_n=float(np.median(out.force)),
        force_99_n=float(np.quantile(out.force, 0.99)),
        deepest_mm=float(1e3 * out.deepest.max()),
        wall_s=time.perf_counter() - start,
    )
    append_record(RESULTS / "pulls.jsonl", row)
    print({k: v for k, v in row.items() if k not in ("versions", "device")})


if __name__ == "__main__":
    pulls, side_by_side, *edges = sys.argv[1:] + ["64", "32"][len(sys.argv) - 1 :]
    for size in edges or ["0.0241"]:
        main(int(pulls), int(side_by_side), float(size))
