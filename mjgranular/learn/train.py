"""Training a policy, from the beginning or from the newest checkpoint."""

from __future__ import annotations

import signal
from collections.abc import Iterator, Mapping
from contextlib import closing, contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from mjgranular._util import files
from mjgranular._util.checks import require
from mjgranular._util.result_folder import CONFIG, versions
from mjgranular._util.signals import kept_signals
from mjgranular.errors import GranularError, InputError, shown, warn_user
from mjgranular.learn import environments
from mjgranular.learn.checkpoint import Progress, load_checkpoint, policy_arguments, write_policy
from mjgranular.learn.policies import load_policy
from mjgranular.learn.run import CHECKPOINTS, CURVE, NORMALIZER, PACKAGES, POLICY, TENSORBOARD, Run
from mjgranular.learn.sands import sands_made
from mjgranular.learn.settings import Settings, algorithm_class, linear_start

if TYPE_CHECKING:
    from mjgranular.learn.callback import Report


@dataclass(frozen=True)
class Training:
    """Outcome of a training."""

    progress: Progress  # progress at the end
    stopped_by: int | None  # the signal that ended it early; None if it is finished
    began: int  # steps of the checkpoint that it resumed from; 0 for a new run


def train(run: Run, *, report: Report | None = None, warp: str | None = None) -> Training:
    """Train until `total_steps`, from the newest checkpoint if there is one.

    SIGTERM or Ctrl-C end it with a checkpoint, a second one at once. The caller must lock the run.

    At each checkpoint the environments begin new episodes and all random numbers start over from
    the run's seed and the number of steps, in the same process as in a new one. So a run that was
    killed and resumed gives the same policy, bit for bit, as one that was not.

    `report` is called at every step of the environments. `warp` is the device of MuJoCo Warp that
    steps the batch, "cuda:0", "cpu" or "auto"; None for MuJoCo. It may change at a checkpoint.

    Raises:
        InputError: environment, algorithm, its arguments and the policy to start from do not match.
        OutputError: the environment's module would be executed only because a file names it, or a
            checkpoint cannot be written or read; those before it are intact.
        UnstableError: weights of the policy are not finite.

    Warns:
        GranularWarning: the run resumes with other packages or on other sand than it started with.
    """
    torch = require("torch", extra="train", purpose="Training a policy")
    require("tensorboard", extra="train", purpose="Training a policy")
    # Networks of this size are faster on one thread; the other cores step environments.
    torch.set_num_threads(1)
    run.check_environment()
    files.finish_publishing(run.path)
    files.remove_leftovers(run.path, (CONFIG, CURVE, POLICY, NORMALIZER))
    files.remove_leftovers(run.path / CHECKPOINTS)
    with closing(environments_of(run, warp=warp)) as env:
        newest = run.newest_checkpoint()
        if newest is None:
            model, start = new_model(run, env), Progress(0, 0.0, [])
            if run.settings.start_from is not None:
                _take_over(run.settings.start_from, run, model, env)
        else:
            _warn_of_versions(run)
            run.warn_of_sand(sands_made(run.environment, run.arguments))
            model, start = load_checkpoint(newest, run, env, lambda: new_model(run, env))
        reached, stopped_by = start, None
        if start.steps < run.settings.total_steps:
            with collected_signals() as received:
                reached = _learn(run, model, start, report, received)
            # After the last step there is nothing left to stop.
            if received and reached.steps < run.settings.total_steps:
                stopped_by = received[0]
        if stopped_by is None:  # also if an earlier process was killed before this
            write_policy(run, run.checkpoint_folder(reached.steps))
        return Training(reached, stopped_by, start.steps)


def _warn_of_versions(run: Run) -> None:
    """Warn if a run resumes with other package versions than it was started with."""
    now = versions(*PACKAGES)
    changed = [
        f"{name} {then} (now {now[name]})"
        for name, then in run.versions.items()
        if name in now and name != "platform" and now[name] != then
    ]
    if changed:
        warn_user(f"{run.path} was started with {', '.join(changed)}: numbers may differ from now")


def environments_of(run: Run, *, warp: str | None = None) -> Any:
    """Return the environments of a run as a `VecNormalize`."""
    settings = run.settings
    env = environments.for_training(
        run.environment, run.arguments, num_envs=settings.num_envs, warp=warp
    )
    from gymnasium import spaces
    from stable_baselines3.common.vec_env import VecNormalize

    vectors = {"observations": env.observation_space}
    if settings.algorithm != "ppo":
        vectors["actions"] = env.action_space
    for name, space in vectors.items():
        if not isinstance(space, spaces.Box):
            env.close()
            raise InputError(
                f"{settings.algorithm} needs {name} that are vectors (Box), but those of "
                f"{run.environment} are {type(space).__name__}"
            )
    return VecNormalize(
        env,
        norm_obs=settings.normalize_observations,
        norm_reward=settings.normalize_rewards,
        gamma=float(settings.arguments.get("gamma", 0.99)),
    )


def new_model(run: Run, env: Any) -> Any:
    """Return an untrained algorithm of Stable-Baselines3."""
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


def _take_over(where: str, run: Run, model: Any, env: Any) -> None:
    """Give an untrained model the weights and the scales of observations of another policy."""
    try:
        other = load_policy(where)
        old, new = (one.observation_space.shape for one in (other.model, env))
        widens = run.settings.algorithm == "ppo" and len(old) == len(new) == 1 and new[0] > old[0]
        if not widens or other.model.action_space.shape != env.action_space.shape:
            other.checked(run.environment, env)
    except GranularError as error:
        raise InputError(f"start_from: {error}") from None
    if widens and other.run.settings.environment.get("observe_sand"):
        raise InputError(
            f"start_from: {where} observes the sand after all else, so this run can have no more "
            f"observations ({new[0]}) than it ({old[0]})"
        )
    names = ("algorithm", "net", "activation", "normalize_observations")
    theirs, ours = (
        ", ".join(f"{name} {shown(getattr(settings, name))}" for name in names)
        for settings in (other.run.settings, run.settings)
    )
    if theirs != ours:
        raise InputError(f"start_from: {where} has {theirs}, but this run has {ours}")
    try:
        weights, normalizer = dict(other.model.state_dict()), other.normalizer
        if widens:
            _widen(weights, model.policy.state_dict(), old[0], new[0])
            normalizer = normalizer.widened(new[0])
        if "log_std_init" in run.settings.policy:
            own = model.policy.state_dict()
            weights |= {name: own[name] for name in weights if name.endswith("log_std")}
        model.policy.load_state_dict(weights)
    except RuntimeError:
        raise InputError(
            f"start_from: the weights of {where} do not fit: policy and use_sde must be as in its "
            "settings"
        ) from None
    normalizer.restore(env)


def _widen(weights: dict[str, Any], untrained: Mapping[str, Any], old: int, new: int) -> None:
    """Give zero weights to observations that are new, which come last."""
    for name, own in untrained.items():
        if name in weights and (own.shape[1:], weights[name].shape[1:]) == ((new,), (old,)):
            wide = own.new_zeros(own.shape)
            wide[:, :old] = weights[name]
            weights[name] = wide


def _arguments(settings: Settings, env: Any) -> dict[str, Any]:
    """Return arguments for the algorithm's class, with schedules and noise made from numbers."""
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


def _learn(
    run: Run, model: Any, start: Progress, report: Report | None, received: list[int]
) -> Progress:
    """Train a model until the last step or a signal; return the progress of the last checkpoint."""
    from stable_baselines3.common.logger import configure

    from mjgranular.learn.callback import CheckpointCallback, check_finite, restart_episodes

    model.set_logger(configure(str(run.path / TENSORBOARD), ["tensorboard"]))
    callback = CheckpointCallback(run, start, report, received)
    restart_episodes(model, run.seed)
    steps = run.settings.total_steps - start.steps
    try:
        model.learn(steps, callback=callback, reset_num_timesteps=False)
    except ValueError:
        check_finite(model, run)  # the algorithm reports such weights by a ValueError
        raise
    if callback.stopped:
        model.num_timesteps = callback.rollout_start  # the policy has not learned from the rest
    reached = callback.save()
    model.logger.close()
    return reached


@contextmanager
def collected_signals() -> Iterator[list[int]]:
    """Collect SIGTERM and SIGINT; the second one acts at once, as usual."""
    received: list[int] = []
    with kept_signals(signal.SIGTERM, signal.SIGINT) as before:

        def receive(number: int, _frame: object) -> None:
            received.append(number)
            for each, handler in before.items():
                signal.signal(each, handler)

        for number in before:
            signal.signal(number, receive)
        yield received
