"""Training a policy, from the beginning or from the newest checkpoint."""

from __future__ import annotations

import random
import signal
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from mjgranular._util import files
from mjgranular._util.extras import require
from mjgranular.errors import InputError, OutputError, UnstableError, warn_user
from mjgranular.experiment.folder import CONFIG
from mjgranular.learn import environments
from mjgranular.learn.checkpoint import Progress, load_checkpoint, save_checkpoint, write_policy
from mjgranular.learn.run import (
    CHECKPOINTS,
    CURVE,
    POLICY,
    TENSORBOARD,
    Run,
    current_versions,
    curve_text,
)
from mjgranular.learn.sands import arguments_for, as_variant, sands_made
from mjgranular.learn.settings import Settings, algorithm_class, linear_start
from mjgranular.learn.weights import NORMALIZER, policy_arguments

_ROWS_PER_CHECKPOINT = 5  # of the learning curve
_NEWEST = 20  # episodes in the mean return that is reported; chosen, not measured


@dataclass(frozen=True)
class Training:
    """Outcome of a training.

    Attributes:
        progress: progress at the end.
        stopped_by: the signal that ended it early; None if it is finished.
        began: steps of the checkpoint that it resumed from; 0 for a new run.
    """

    progress: Progress
    stopped_by: int | None
    began: int


Report = Callable[[int, float | None], None]
"""Called with the steps done and the mean return of the newest episodes (None before the first
ends)."""


def train(
    run: Run,
    *,
    report: Report | None = None,
    threads: int | None = None,
    warp: str | None = None,
) -> Training:
    """Train until `total_steps`, from the newest checkpoint if there is one.

    SIGTERM or Ctrl-C end it early, with a checkpoint of what was learned so far; a second one ends
    it at once. The caller must lock the run.

    At each checkpoint the environments begin new episodes and all random numbers start over from
    the run's seed and the number of steps, in the same process as in a new one. So a run that was
    killed and resumed gives the same policy, bit for bit, as one that was not.

    If the environment has other sand now than at the start of the run, because a default has
    changed for example, training continues on the sand of the start.

    Args:
        run: the run to train.
        report: called at every step of the environments.
        threads: threads of a batch of environments; None for one per core. Results are the same.
        warp: device of MuJoCo Warp that steps the batch, "cuda:0", "cpu" or "auto"; None for MuJoCo
            here. A run may change this at any checkpoint.

    Raises:
        InputError: the environment, the algorithm and its arguments do not match.
        OutputError: the environment's module would be executed only because a file names it; the
            sand of the run's start cannot be restored; or a checkpoint cannot be written or read;
            those before it are intact.
        UnstableError: the policy's weights are not finite any more.
    """
    torch = require("torch", extra="train", purpose="Training a policy")
    require("tensorboard", extra="train", purpose="Training a policy")
    # Networks of this size are faster on one thread; the other cores step environments.
    torch.set_num_threads(1)
    run.check_environment()
    run = _on_its_sand(run)
    files.finish_publishing(run.path)
    files.remove_leftovers(run.path, (CONFIG, CURVE, POLICY, NORMALIZER))
    files.remove_leftovers(run.path / CHECKPOINTS)
    env = environments_of(run, threads=threads, warp=warp)
    try:
        newest = run.newest_checkpoint()
        if newest is None:
            model, progress = new_model(run, env), Progress(0, 0.0, [])
        else:
            _warn_of_versions(run)
            model, progress = load_checkpoint(newest, run, env, lambda: new_model(run, env))
            if progress.steps >= run.settings.total_steps:
                write_policy(run, newest)  # the process may have been killed before that
                return Training(progress, None, progress.steps)
        with collected_signals() as received:
            saved = _learn(run, model, progress, report, received)
        # After the last step a signal has nothing left to stop.
        finished = saved.steps >= run.settings.total_steps
        stopped_by = received[0] if received and not finished else None
        if stopped_by is None:
            write_policy(run, run.checkpoint_folder(saved.steps))
        return Training(saved, stopped_by, progress.steps)
    finally:
        env.close()


def begin_episodes(model: Any, seed: int) -> None:
    """Begin new episodes, with random numbers that follow from the seed and the steps done."""
    torch = require("torch", extra="train", purpose="Training a policy")
    word = int(np.random.SeedSequence([seed, model.num_timesteps]).generate_state(1)[0]) % 2**31
    random.seed(word)
    np.random.seed(word)  # noqa: NPY002  Stable-Baselines3 draws from it
    torch.manual_seed(word)
    model.action_space.seed(word)
    model.env.seed(word)
    model._last_obs = model.env.reset()
    model._last_episode_starts = np.ones(model.env.num_envs, dtype=bool)
    model._last_original_obs = model.get_vec_normalize_env().get_original_obs()


def _warn_of_versions(run: Run) -> None:
    """Warn if a run resumes with other package versions than it was started with."""
    now = current_versions()
    changed = [
        f"{name} {then} (now {now[name]})"
        for name, then in run.versions.items()
        if name in now and name != "platform" and now[name] != then
    ]
    if changed:
        warn_user(
            f"{run.path} was begun with {', '.join(changed)}: numbers may differ from here on"
        )


def _on_its_sand(run: Run) -> Run:
    """Return the run, with arguments that restore the sand of its start, if needed.

    Raises:
        OutputError: no arguments do.
    """
    now = sands_made(run.environment, run.arguments)
    other = run.other_sand(now)
    if other is None or run.sand is None:
        return run
    restored = arguments_for(run.sand, run.environment, run.arguments)
    if restored is None:
        raise OutputError(
            f"{run.path} {other}; its environment cannot be given that any more: train anew, with "
            "another --out"
        )
    warn_user(f"{run.path} {other}; it goes on with what it was begun on, {as_variant(restored)}")
    return replace(run, restored=restored)


def environments_of(run: Run, *, threads: int | None = None, warp: str | None = None) -> Any:
    """Return the environments of a run as a `VecNormalize`."""
    from gymnasium import spaces
    from stable_baselines3.common.vec_env import VecNormalize

    settings = run.settings
    env = environments.for_training(
        run.environment,
        run.arguments,
        num_envs=settings.num_envs,
        processes=settings.processes,
        threads=threads,
        warp=warp,
    )
    if not isinstance(env.observation_space, spaces.Box):
        env.close()
        raise InputError(
            f"{run.environment} observes a {type(env.observation_space).__name__}; policies are "
            "trained on plain vectors (Box)"
        )
    if settings.algorithm != "ppo" and not isinstance(env.action_space, spaces.Box):
        env.close()
        raise InputError(
            f"{settings.algorithm} needs actions that are vectors; those of {run.environment} are "
            f"{type(env.action_space).__name__}: take --algorithm ppo"
        )
    return VecNormalize(
        env,
        norm_obs=settings.normalize_observations,
        norm_reward=settings.normalize_rewards,
        gamma=float(settings.arguments.get("gamma", 0.99)),
    )


def new_model(run: Run, env: Any) -> Any:
    """Return an algorithm of Stable-Baselines3 that has learned nothing yet."""
    settings = run.settings
    try:
        return algorithm_class(settings.algorithm)(
            "MlpPolicy",
            env,
            seed=run.seed,
            device="cpu",
            policy_kwargs=policy_arguments(settings),
            **_arguments(settings, env),
        )
    except Exception as error:  # its checks of arguments differ, and some are missing
        raise InputError(f"{settings.algorithm}: {' '.join(str(error).split())}") from None


def _arguments(settings: Settings, env: Any) -> dict[str, Any]:
    """Return arguments for the algorithm's class: schedules and noise made from their numbers."""
    from stable_baselines3.common.noise import NormalActionNoise
    from stable_baselines3.common.utils import LinearSchedule

    made: dict[str, Any] = {}
    for name, value in settings.arguments.items():
        start = linear_start(value)
        if start is not None:
            made[name] = LinearSchedule(start, 0.0, 1.0)
        elif name == "action_noise":
            size = env.action_space.shape
            made[name] = NormalActionNoise(np.zeros(size), np.full(size, float(value)))
        else:
            made[name] = tuple(value) if isinstance(value, list) else value
    return made


class _StoppedError(Exception):
    """Raised to leave the algorithm's loop."""


def _learn(
    run: Run, model: Any, progress: Progress, report: Report | None, received: list[int]
) -> Progress:
    from stable_baselines3.common.logger import configure

    model.set_logger(configure(str(run.path / TENSORBOARD), ["tensorboard"]))
    keeper = _keeper(run, progress, report, received)
    begin_episodes(model, run.seed)
    try:
        model.learn(
            run.settings.total_steps - progress.steps,
            callback=keeper,
            reset_num_timesteps=False,
        )
    except _StoppedError:
        model.num_timesteps = keeper.rollout_start
    except ValueError:
        _check_finite(model, run)  # that is how the algorithm notices it
        raise
    saved = keeper.save()
    model.logger.close()
    return saved


def _keeper(run: Run, progress: Progress, report: Report | None, received: Sequence[int]) -> Any:
    """Return the callback that writes the curve and the checkpoints when they are due."""
    # Its base class is in an optional package: hence a class within a function.
    from stable_baselines3.common.callbacks import BaseCallback

    class Keeper(BaseCallback):
        def __init__(self) -> None:
            super().__init__()
            self.rollout_start = progress.steps
            self.curve = list(progress.curve)
            self.began = time.monotonic()
            self.ended: list[tuple[float, int]] = []  # return and length, since the last row
            self.newest: float | None = None
            self.plan(progress.steps)
            # Rows after the checkpoint that is resumed belong to what was lost.
            files.write_text(run.path / CURVE, curve_text(self.curve))

        def _on_rollout_start(self) -> None:
            steps = self.rollout_start = self.num_timesteps
            self._stop_if_asked()
            checkpoint = steps >= self.next_checkpoint
            if steps >= self.next_row:
                self.add_row()
            self.plan(steps)
            if checkpoint:
                self.save()
                begin_episodes(self.model, run.seed)
                policy: Any = self.model.policy
                if self.model.use_sde:  # as the algorithm does before each rollout
                    policy.reset_noise(self.training_env.num_envs)

        def _on_step(self) -> bool:
            for info in self.locals["infos"]:
                if "episode" in info:
                    self.ended.append((float(info["episode"]["r"]), int(info["episode"]["l"])))
                    self.newest = float(np.mean([one for one, _ in self.ended[-_NEWEST:]]))
            if report is not None:
                report(self.num_timesteps, self.newest)
            self._stop_if_asked()
            return True

        def _stop_if_asked(self) -> None:
            if received:
                raise _StoppedError

        def plan(self, steps: int) -> None:
            """Find the steps after which the next row and the next checkpoint are due."""
            every = run.settings.checkpoint_every
            row_every = max(1, every // _ROWS_PER_CHECKPOINT)
            self.next_checkpoint = (steps // every + 1) * every
            self.next_row = (steps // row_every + 1) * row_every

        def seconds(self) -> float:
            """Return the time spent in training, in all processes [s]."""
            return progress.seconds + time.monotonic() - self.began

        def add_row(self) -> None:
            """Add the episodes since the last row to the curve."""
            if not self.ended:
                return
            returns, lengths = np.array(self.ended).T
            steps, seconds = self.model.num_timesteps, round(self.seconds(), 3)
            row = (steps, seconds, len(returns), float(returns.mean()), float(lengths.mean()))
            self.curve.append(row)
            self.ended = []
            files.write_text(run.path / CURVE, curve_text(self.curve))

        def save(self) -> Progress:
            """Write a checkpoint."""
            _check_finite(self.model, run)
            self.add_row()
            reached = Progress(self.model.num_timesteps, self.seconds(), tuple(self.curve))
            save_checkpoint(run, self.model, reached)
            return reached

    return Keeper()


def _check_finite(model: Any, run: Run) -> None:
    """Raise `UnstableError` if a weight of the policy is not finite."""
    torch = require("torch", extra="train", purpose="Training a policy")
    if not all(bool(torch.isfinite(p).all()) for p in model.policy.parameters()):
        raise UnstableError(
            f"{run.name}: the policy's numbers are not finite after {model.num_timesteps} steps; "
            "the checkpoints before are whole: begin a new run with a smaller learning_rate"
        )


@contextmanager
def collected_signals() -> Iterator[list[int]]:
    """Collect SIGTERM and SIGINT; the second one acts at once, as usual."""
    received: list[int] = []
    if threading.current_thread() is not threading.main_thread():
        yield received  # signals belong to the main thread
        return
    before = {number: signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGINT)}

    def receive(number: int, _frame: object) -> None:
        received.append(number)
        for each, handler in before.items():
            signal.signal(each, handler)

    for number in before:
        signal.signal(number, receive)
    try:
        yield received
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
