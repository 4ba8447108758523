"""Train many environments and choose a policy for each: ``agym-jax suite --only Jaco --num-seeds 8``.

For every environment, the suite trains several seeds (``train``, or ``coop`` if the person acts too), chooses the best
one (``select``, on one set of people, reported on another), and films the chosen policy (``enjoy``). Each of these is a
separate process, one at a time per GPU. The save folder contains a table and a plot of all runs (``results.md``,
``curves.png``), which are updated after each environment. Rerunning the same command continues where it was stopped:
finished runs are kept, and unfinished ones are resumed from their checkpoints.
"""

from __future__ import annotations

import signal
import sys
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import tyro

from agym_jax import list_envs
from agym_jax.data.npz import check_writable, write_file
from agym_jax.errors import AgymError
from agym_jax.flags import plain
from agym_jax.interrupts import raise_again

from .runs.overview import markdown, selection_of, training_summary
from .runs.plots import plot_runs
from .runs.progress import duration
from .suites.children import own_program, visible_gpus
from .suites.plan import SuiteConfig, check_entries, named
from .suites.runner import Outcome, Runner
from .suites.whole import Whole

LINE_PERIOD = 60.0  # seconds between lines about the whole


def write_results(config: SuiteConfig, ids: Sequence[str]) -> None:
    """Write the table and the plot of all finished runs to the save folder."""
    folder = Path(config.save_dir)
    there = [(selection_of(folder / name), training_summary(folder / name)) for name in ids]
    runs = [(selection, training) for selection, training in there if selection]
    if runs:
        write_file(folder / "results.md", markdown(runs).encode())
        plot_runs(folder / "curves.png", [training for _, training in runs if training])


def describe(outcome: Outcome) -> str:
    """Return a line of the table, or what failed."""
    name = f"{outcome.env_name:<28}"
    took = outcome.kept or duration(outcome.seconds)
    if outcome.line is None:
        return f"{name} failed after {took}:\n{outcome.problem}"
    if not outcome.line:
        return f"{name} trained in {took}"
    x = outcome.line
    gentle = f", gently {x['chosen_gentle_success']:.1%}" if "chosen_gentle_success" in x else ""
    return (
        f"{name} chosen {x['chosen_success']:6.1%}{gentle}   of {len(x['seeds'])} seeds: interquartile mean "
        f"{x['success_iqm']:6.1%}, worst {min(x['success_of_seeds']):6.1%}   {took}"
    )


def main(
    arguments: Sequence[str] | None = None,
    prog: str = f"python -m {__package__}.suite",
    program: tuple[str, ...] | None = None,
) -> int:
    """Run the command line and return the exit status."""
    raise_again()
    try:
        config = tyro.cli(SuiteConfig, prog=prog, args=arguments, description=plain(__doc__))
        ids = named(config.only, list_envs())
        check_entries(config, list_envs())
        gpus = visible_gpus(config.gpus)
        check_writable(Path(config.save_dir))
    except AgymError as error:
        print(f"{type(error).__name__}: {error}", file=sys.stderr)
        return 2
    where = f"{len(gpus)} GPUs" if len(gpus) > 1 else "one device"
    print(
        f"{len(ids)} environments, {config.num_seeds} seeds each, on {where}, into {config.save_dir}",
        flush=True,
    )
    runner = Runner(config, program or own_program(), gpus)

    def stop(*_: Any) -> None:
        runner.children.stop()  # first: nobody waits for a training that was not told
        print("Stopping; trainings save their state ...", flush=True)
        raise KeyboardInterrupt

    before = [(number, signal.signal(number, stop)) for number in (signal.SIGINT, signal.SIGTERM)]
    try:
        return _run_all(config, ids, runner)
    except KeyboardInterrupt:
        runner.finish()
        print("Rerun the same command to continue.")
        return 130
    finally:
        for number, handler in before:
            signal.signal(number, handler)


def _run_all(config: SuiteConfig, ids: Sequence[str], runner: Runner) -> int:
    """Run everything, printing a line per environment and an overall line every minute; return the exit status."""
    whole, over = Whole(config, ids), threading.Event()

    def tell() -> None:
        while not over.wait(LINE_PERIOD):
            print(whole.words(), flush=True)

    threading.Thread(target=tell, daemon=True).start()
    failed, used = 0, 0.0
    try:
        for number, outcome in enumerate(runner.all(ids), 1):
            failed += outcome.line is None
            used += 0.0 if outcome.kept else outcome.seconds
            print(f"{number:>3}/{len(ids)}  {describe(outcome)}", flush=True)
            if outcome.line:
                write_results(config, ids)
        for name, problem in runner.finish().items():
            print(f"No film of {name}:\n{problem}")
    finally:
        over.set()
    took, results = time.perf_counter() - whole.start, Path(config.save_dir) / "results.md"
    print(
        f"{len(ids) - failed} of {len(ids)} environments in {duration(took)}; one after another, their trainings "
        f"and choices would take {duration(used)}."
        + (f" Results: {results}" if results.is_file() else "")
    )
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
