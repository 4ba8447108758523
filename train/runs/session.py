"""One training session, for any kind of agents: compile, run from log line to log line, save, resume.

The run is compiled once. Each call of the program performs the updates between two log lines. A session that finds
checkpoints in its folder resumes from them.
"""

from __future__ import annotations

import contextlib
import dataclasses
import math
import signal
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np
from jax.sharding import Mesh

from agym_jax.compat.warp_kernels import kernels_in_background
from agym_jax.data.npz import check_writable
from agym_jax.errors import AgymError
from agym_jax.flags import command_words, made_of
from agym_jax.interrupts import INTERRUPTED, deferred, raise_again
from agym_jax.policy.check import trained_otherwise
from agym_jax.registry import parse, plain_id

from ..configs import Config, LearnConfig, parse_arguments, resolve, updates_in
from ..envs import is_native, make_env, vectorize
from ..errors import ConfigError
from ..learning.agents import Agents
from ..learning.execution import STEPWISE, StepwiseEnv, compile_together, execution_of
from ..learning.hosts import check_agreement, join_hosts, wait_for_hosts
from ..learning.restarts import with_restarts
from ..learning.rollout import RolloutState, fold_in, init_rollout, split_keys
from ..learning.seeds import Lane, SideBySide, candidates_of, keep_learner, lane_keys, lanes_of
from ..learning.sharding import AXIS, device_mesh, replicate, shard, shardings, to_host
from ..learning.update import make_updates
from . import candidates
from .checkpoint import say_resumed, steps_of
from .curve import Row, check_overflow, diverged, make_rows, refuse_diverged
from .folder import RunFolder
from .logging import LoggedRun, Loggers, check_loggers, flat
from .manager import CheckpointManager, Policies
from .overview import CANDIDATES
from .progress import Progress, Silent, for_terminal
from .record import commit
from .result import SeedResult, TrainResult, summary, unsaved

SAVE_PERIOD = 60.0  # seconds after which a checkpoint is due at the next log line
GPU_OPTIONS = {"xla_gpu_enable_triton_gemm": False}
"""Of the compiler: trying out Triton's matrix products takes half of the time to compile, and cuBLAS wins."""
OnLog = Callable[[Row, Callable[[], Policies]], bool | None]


def resolve_config(env: Any, config: Config) -> tuple[Config, Mesh | None]:
    """Resolve the settings for an environment and this machine; also return the devices if there are several.

    Raises:
        ConfigError: if settings are inconsistent, or do not suit the machine.
    """
    if is_native(env) and config.devices > 1:
        raise ConfigError(
            f"--devices {config.devices} were asked for, but C MuJoCo (impl='native') steps all environments on the "
            f"CPU's cores. Leave --devices out, or use --impl jax."
        )
    single = isinstance(env, StepwiseEnv) or is_native(env)
    if single and jax.process_count() > 1:
        raise ConfigError("C MuJoCo (impl='native') trains on one machine; with --hosts, use MJX.")
    if config.restart_share and not config.stagger:
        raise ConfigError(
            "--restart-share needs episodes that end at different times. Use it with --stagger, or set it to 0."
        )
    mesh = None if single else device_mesh(config.devices)
    config = dataclasses.replace(config, **made_of(env))
    return resolve(config, jax.default_backend(), mesh.size if mesh else 1), mesh


def run_session(
    env: Any,
    config: LearnConfig,
    single: Agents,
    mesh: Mesh | None = None,
    progress: Progress | None = None,
    on_log: OnLog | None = None,
    lanes: Sequence[Lane] | None = None,
) -> TrainResult:
    """Train until the number of steps is reached, or something stops it.

    Args:
        env: an environment (``agym_jax.make``), or a ``StepwiseEnv``.
        config: settings from ``resolve_config``.
        single: the agents that learn in a single training.
        mesh: devices from ``resolve_config``.
        progress: receives progress reports; None shows nothing.
        on_log: see ``train.ppo.train``; receives the policies of the first seed by agent.
        lanes: the trainings to run in parallel; by default, one for each seed of the configuration.

    Returns:
        Policies, learning curve and times.
    """
    if config.num_candidates > 1 and (lanes or isinstance(env, StepwiseEnv)):
        raise ConfigError(
            "--num-candidates does not work in a sweep, or with a StepwiseEnv, whose batch size is compiled in."
        )
    is_main_process = jax.process_index() == 0  # one host writes, and tells
    progress = (progress if is_main_process else None) or Silent()
    folder = RunFolder(config.save_dir, env.name) if config.save_dir is not None else None
    check_loggers(config.logger, config.save_dir)
    with contextlib.ExitStack() as stack:
        if folder and is_main_process:
            check_writable(folder.path.parent)
            stack.enter_context(folder.lock)
            if aside := folder.prepare(config.fresh):
                progress.say(f"Starting over; the earlier run is now in {aside}")
        wait_for_hosts("folder")
        logged = logged_run(env, config, folder) if folder and is_main_process else None
        loggers = Loggers(config.logger, logged, progress.say)
        stack.callback(loggers.close)
        session = _Session(env, config, single, mesh, progress, on_log)
        return session.run(list(lanes or lanes_of(config)), folder, loggers)


def logged_run(env: Any, config: LearnConfig, folder: RunFolder) -> LoggedRun:
    """What loggers are told of a run: its hyper-parameters, physics, device and commit."""
    about = {
        "impl": str(getattr(env, "impl", config.impl)),
        "device": jax.devices()[0].device_kind,
        "commit": commit(),
    }
    left_out = {name: None for name in ("save_dir", "logger", "fresh")}
    return LoggedRun(env.name, folder.path, flat(dataclasses.asdict(config) | about | left_out))


@dataclasses.dataclass(frozen=True)
class _Session:
    """What the parts of a session have in common; see ``run_session``."""

    env: Any
    config: LearnConfig
    single: Agents
    mesh: Mesh | None
    progress: Progress
    on_log: OnLog | None

    def run(
        self,
        lanes: list[Lane],
        folder: RunFolder | None,
        loggers: Loggers,
        until: float | None = None,
    ) -> TrainResult:
        """Train in a folder that is ours; candidates until a fraction of the steps."""
        env, config, progress = self.env, self.config, self.progress
        is_main_process = jax.process_index() == 0
        start = time.perf_counter()
        agents = SideBySide(self.single, lanes) if len(lanes) > 1 else self.single
        num_envs = config.num_envs * len(lanes)
        key_learner, key_envs = split_keys(lane_keys(lanes))
        manager = CheckpointManager(
            env, config, agents, folder, lanes, is_main_process, progress.say, loggers
        )
        learner, meta = manager.resume(jax.jit(agents.init)(key_learner))
        before: TrainResult | None = None
        if until is None and meta:
            candidates.say_what_stays(manager.candidates, config, progress.say)
        elif until is None and config.num_candidates > 1:
            loggers.begin({"": []})  # what they need is known now, not after hours
            before = self.run_candidates(folder)
            if before.interrupted:
                return before
            learner = candidates.hand_over(before, config, self.single, manager, progress.say)
            before, start = dataclasses.replace(before, learner=None, seeds=[]), time.perf_counter()
        elif until is None and folder:
            candidates.refuse_unfinished(folder.path, config)
        venv = vectorize(env, num_envs // config.devices)
        venv = with_restarts(venv, config.restart_share, len(lanes))
        first_steps = steps_of(learner)
        if meta:
            say_resumed(progress.say, meta, config, first_steps)
        elif not before:
            for policy in filter(None, (agent.start for agent in self.single.agents)):
                if otherwise := trained_otherwise(policy, env):
                    progress.say(f"The policy it starts from was trained otherwise: {otherwise}.")
        check_agreement("the step to go on from", first_steps, "They need a common --save-dir.")
        batch = config.num_envs * config.num_steps
        total_steps = updates_in(config.num_env_steps, batch) * batch
        end = updates_in(math.ceil(config.num_env_steps * (until or 1)), batch) * batch
        manager.begin(learner, complete=first_steps >= end)

        rollout: Any = None
        run: Any = None
        if first_steps < end:
            # A resumed run gets fresh episodes, and other ones than the run before it began with.
            key_envs = fold_in(key_envs, first_steps)
            if execution_of(venv) is STEPWISE:
                rollout = init_rollout(venv, key_envs, config.stagger)
                run = make_updates(venv, config, agents, execution=STEPWISE)
            else:
                learner, rollout, run = _compile(venv, config, agents, learner, key_envs, self.mesh)
        elif until is None and not before:
            progress.say("This run is complete; raise --num-env-steps to continue it.")
        compile_seconds = time.perf_counter() - start

        progress.start(first_steps, end)
        hyper = agents.hyper(total_steps)
        for i, lane in enumerate(lanes):
            if lane.name in manager.stopped:
                hyper.learns[i] = 0.0
        start = last_save = time.perf_counter()
        env_steps, since_save, interrupted = first_steps, 0, False
        nan_before = nan_total = manager.combined[-1]["nan_total"] if manager.combined else 0
        try:
            while env_steps < end and not interrupted:
                count = min(config.log_interval, math.ceil((end - env_steps) / batch))
                began = time.perf_counter()
                next_learner, rollout, totals = run(learner, rollout, np.int32(count), hyper)
                totals = jax.device_get(totals)
                with deferred():  # an interrupt must not come between a row and its learner
                    rows = make_rows(totals, count, count * batch, env.episode_length)
                    now = time.perf_counter()
                    nan_total += sum(int(row["nan"]) for row in rows)
                    about = {
                        "env_steps": env_steps + count * batch,
                        "seconds": manager.seconds + now - start,
                        "steps_per_second": count * batch * len(rows) / (now - began),
                        "nan_total": nan_total,
                    }
                    rows = [row | about for row in rows]
                    check_overflow(sum(row["overflow"] for row in rows), env.name, num_envs)
                    going = {
                        i: x for i, x in enumerate(rows) if lanes[i].name not in manager.stopped
                    }
                    for i, bad in [(i, x) for i, x in going.items() if diverged(x)]:
                        if len(going) == 1:
                            refuse_diverged(bad, env.name)
                        next_learner = keep_learner(next_learner, learner, i)
                        hyper.learns[i] = 0.0
                        manager.stopped[lanes[i].name] = diverged(going.pop(i))
                        progress.say(
                            f"{lanes[i].name} diverged {diverged(bad)}; the others continue."
                        )
                    row = manager.add(going)
                    learner, env_steps = next_learner, env_steps + count * batch
                progress.update(row)
                since_save += count
                due = since_save >= config.save_interval or now - last_save > SAVE_PERIOD
                if self.on_log and self.on_log(row, lambda kept=learner: manager.policies(kept)[0]):
                    interrupted = env_steps < total_steps
                save = manager.save if env_steps < end else manager.save_end
                if (due or interrupted or env_steps >= end) and save(learner, now - start):
                    since_save, last_save = 0, time.perf_counter()
        except KeyboardInterrupt:
            interrupted = True
            try:
                if env_steps > manager.saved_steps:
                    manager.save(learner, time.perf_counter() - start)
            except KeyboardInterrupt:  # SIGINT and SIGTERM at once, as when a suite is stopped
                if env_steps > manager.saved_steps:
                    manager.save(learner, time.perf_counter() - start)
        finally:
            progress.stop()
        train_seconds = time.perf_counter() - start
        policies = manager.finish(learner)
        result = TrainResult(
            seeds=[
                SeedResult(x.name, x.seed, own, curve, manager.stopped.get(x.name, ""))
                for x, own, curve in zip(lanes, policies, manager.curves, strict=True)
            ],
            learner=to_host(learner),
            config=config,
            curve=manager.combined,
            env_steps=env_steps,
            session_steps=(env_steps - first_steps) * len(lanes),
            compile_seconds=compile_seconds,
            train_seconds=train_seconds,
            nan_steps=nan_total - nan_before,
            interrupted=interrupted,
            folder=folder.path if folder and is_main_process else None,
            unsaved=manager.trouble,
            saved_steps=manager.saved_steps,
            of_candidates=until is not None,
        )
        return result.after(before) if before else result

    def run_candidates(self, folder: RunFolder | None) -> TrainResult:
        """Train the candidates of all seeds, in a folder of their own in that of the run."""
        lanes, own = candidates_of(self.config), folder and folder.of_lane(CANDIDATES)
        if own and jax.process_index() == 0:
            own.prepare(fresh=False)
        wait_for_hosts("candidates")
        until, say = self.config.candidates_until, self.progress.say
        say(
            f"Training {len(lanes)} candidates; after {until:.0%} of the steps, one of each seed continues."
        )
        return self.run(lanes, own, Loggers((), None, say), until)


def _compile(
    venv: Any,
    config: LearnConfig,
    agents: Agents | SideBySide,
    learner: Any,
    key: jax.Array,
    mesh: Mesh | None,
) -> tuple[Any, RolloutState, Callable]:
    """The learner on its devices, environments at their start, the compiled function for many updates."""

    def first(key: jax.Array) -> RolloutState:
        return init_rollout(venv, key, config.stagger)

    run = make_updates(venv, config, agents, AXIS if mesh else None)
    common = own = None
    if mesh:
        common, own = shardings(mesh)
        first, run = shard(mesh, first, run)
        learner, key = replicate(mesh, (learner, key))
    with kernels_in_background():
        go, begin = _lower_and_compile(first, run, agents, learner, key, (common, own))
    return learner, jax.block_until_ready(begin(key)), go


def _lower_and_compile(
    first: Callable, run: Callable, agents: Any, learner: Any, key: jax.Array, where: tuple
) -> list[Any]:
    """The compiled programs that continue and begin the environments."""
    common, own = where
    # XLA would leave Warp's empty buffers anywhere, so every place is said.
    reset = jax.jit(first, out_shardings=own).lower(key)
    rollout = jax.tree.map(
        lambda leaf: jax.ShapeDtypeStruct(leaf.shape, leaf.dtype, sharding=own), reset.out_info
    )
    update = jax.jit(run, out_shardings=(common, own, common))
    update = update.lower(learner, rollout, np.int32(1), agents.hyper(1))
    options = GPU_OPTIONS if jax.default_backend() == "gpu" else None
    return compile_together(update, reset, options=options)


def on_terminate(*_: Any) -> None:
    """Handle SIGTERM as Ctrl-C, once: Linux tells a child of each thread of its parent that dies, and the state is being saved."""
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    raise KeyboardInterrupt


def command_line(
    kind: type[Config],
    train: Callable[[Any, Config, Progress], TrainResult],
    arguments: Sequence[str] | None,
    make: Callable[..., Any] = make_env,
    prog: str | None = None,
) -> int:
    """The command line of a trainer.

    Args:
        kind: of its settings.
        train: the trainer: environment, settings and progress -> result.
        arguments: command-line arguments; None for those of this process.
        make: id, physics and options -> environment.
        prog: program name shown in the help.

    Returns:
        The exit status.
    """
    words = command_words(arguments)
    try:
        helps = {"-h", "--help"} & {*words}  # it shows the defaults of this machine
        config = parse_arguments(words, kind, prog, jax.default_backend() if helps else "gpu")
        signal.signal(signal.SIGTERM, on_terminate)
        if make is make_env:
            parse(config.env_name)  # a name that does not exist leaves nothing in the folder
        check_loggers(config.logger, config.save_dir)
        if config.save_dir is not None:  # before the environment is built, which takes seconds
            check_writable(Path(config.save_dir))
        join_hosts(config.hosts)
        config = parse_arguments(words, kind, prog, jax.default_backend())  # JAX knows it only now
        if config.save_dir is not None and jax.process_index() == 0:
            RunFolder(config.save_dir, plain_id(config.env_name)).check(config.fresh)
        env = make(config.env_name, config.impl, **config.options())
        raise_again()
        result = train(env, config, for_terminal())
    except AgymError as error:
        print(f"{type(error).__name__}: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("Stopped. Rerun the same command to train.", file=sys.stderr)
        return INTERRUPTED
    if jax.process_index() == 0:
        print(summary(result))
    if result.unsaved:
        print(unsaved(result), file=sys.stderr)
        return 2
    if result.interrupted:
        without = " without --fresh" if config.fresh else ""
        print(f"Rerun the same command{without} to continue.")
        return INTERRUPTED
    return 0
