"""Training on Ray: RLlib's workers step environments, here the policy learns from all of them."""

from __future__ import annotations

import inspect
import logging
import os
import sys
import time
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from mjgranular.errors import GranularError, InputError
from mjgranular.extras import need
from mjgranular.learn.checkpoint import Progress
from mjgranular.learn.keeping import Keeping
from mjgranular.learn.run import TENSORBOARD, Run
from mjgranular.learn.settings import Settings, algorithm_class, linear_start
from mjgranular.pool import Workers
from mjgranular.pool.on_ray import begin_ray, cores_of
from mjgranular.pool.versions import versions

_PURPOSE = "Training with the engine ray"

# Arguments of PPO in Stable-Baselines3, each with the name of its like in RLlib; None for those
# that our own module and learner know.
_LIKE = {
    "learning_rate": "lr",
    "n_steps": None,
    "batch_size": "minibatch_size",
    "n_epochs": "num_epochs",
    "gamma": "gamma",
    "gae_lambda": "lambda_",
    "clip_range": "clip_param",
    "ent_coef": "entropy_coeff",
    "vf_coef": "vf_loss_coeff",
    "max_grad_norm": "grad_clip",
    "use_sde": None,
    "sde_sample_freq": None,
    "target_kl": None,
}


def check_training(settings: Settings, on: Workers | None) -> None:
    """Refuses a training on Ray that cannot be: settings that nothing there answers to, for one.

    Raises:
        InputError: says which, and what goes.
        MissingExtraError: RLlib is not installed.
    """
    if on is None or on.engine != "ray":
        return
    _check_settings(settings)
    envs, count = settings.num_envs, on.count
    if count is not None and envs % count:
        raise InputError(
            f"{envs} environments (num_envs) cannot be shared evenly among {count} env runners: "
            f"{_largest_divisor(envs, count)} can, or --set num_envs={count * -(-envs // count)}"
        )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of RLlib's, on its own ways
        need("ray.rllib.algorithms.ppo", extra="ray", purpose=_PURPOSE)


def _check_settings(settings: Settings) -> None:
    instead = "train with --engine local"
    if settings.algorithm != "ppo":
        raise InputError(f"--engine ray trains with ppo, not {settings.algorithm}: {instead}")
    if settings.processes:
        raise InputError("--engine ray has env runners of its own: leave processes away")
    for name, value in settings.arguments.items():
        if name == "normalize_advantage" and value is True:
            continue
        if name not in _LIKE:
            raise InputError(f"--engine ray has nothing like {name}: leave it away, or {instead}")
        if name != "learning_rate" and linear_start(value) is not None:
            raise InputError(f"with --engine ray {name} does not fall: give a number, or {instead}")
    if settings.policy.get("squash_output"):
        raise InputError(f"--engine ray has nothing like policy.squash_output: {instead}")


def here(run: Run) -> Run:
    """The run as the process that trains sees it: one environment, which is never stepped."""
    settings = run.settings
    steps = _argument(settings, "n_steps") * settings.num_envs
    alone = replace(settings, num_envs=1, arguments={**settings.arguments, "n_steps": steps})
    return replace(run, settings=alone)


def learn(
    run: Run,
    model: Any,
    progress: Progress,
    *,
    on: Workers,
    report: Any,
    received: list[int],
) -> Progress:
    """Trains until `total_steps`, or until a signal is received.

    Args:
        run: what to train.
        model: of Stable-Baselines3, of `here(run)`; what it knows is where the training begins, and
            it has what was learned afterwards.
        progress: what was done before.
        on: a cluster of Ray; as many workers as its count says.
        report: told the steps done and the mean return of the newest episodes.
        received: signals, added to it by someone else.

    Returns:
        How far it came; there is a checkpoint of that.

    Raises:
        InputError: Ray or its workers cannot do it.
    """
    from stable_baselines3.common.logger import configure

    model.set_logger(configure(str(run.path / TENSORBOARD), ["tensorboard"]))
    kept = Keeping(run, progress)
    with _session(on) as cores:
        algorithm = built(run, model, _runners(run.settings, on.count, cores))
        try:
            normalizer = model.get_vec_normalize_env()
            algorithm.statistics = _statistics(normalizer)
            algorithm.set_weights_of(model)
            while model.num_timesteps < run.settings.total_steps and not received:
                _rollout(algorithm, model, kept)
                if report is not None:
                    report(model.num_timesteps, kept.newest)
                if kept.is_due(model.num_timesteps):
                    _fetch(algorithm, model)
                    kept.save(model)
            _fetch(algorithm, model)
            return kept.save(model)
        finally:
            algorithm.stop()
            model.logger.close()


def _rollout(algorithm: Any, model: Any, kept: Keeping) -> None:
    """Samples once, and learns from it."""
    begin = time.monotonic()
    algorithm.begin_rollout()
    before = _steps(algorithm.last)
    try:
        algorithm.last = algorithm.train()
    except GranularError:
        raise
    except Exception as error:  # of Ray, of a worker, of anybody's environment
        raise InputError(f"RLlib cannot go on: {told(error)}") from None
    done = _steps(algorithm.last) - before
    model.num_timesteps += done
    for statistics, episodes in algorithm.take():
        algorithm.statistics.join(statistics)
        for returned, length in episodes:
            kept.end_episode(returned, length)
    if kept.newest is not None:
        model.logger.record("rollout/ep_rew_mean", kept.newest)
    model.logger.record("time/fps", done / (time.monotonic() - begin))
    for name, value in algorithm.last["learners"].get("default_policy", {}).items():
        with suppress(TypeError, ValueError):
            model.logger.record(f"train/{name}", float(value))
    model.logger.dump(model.num_timesteps)


def _steps(result: Mapping[str, Any]) -> int:
    """Steps that an algorithm has sampled in its life."""
    return int(result.get("num_env_steps_sampled_lifetime", 0))


def _fetch(algorithm: Any, model: Any) -> None:
    """Takes what was learned over into the model."""
    policy, optimizer = algorithm.weights()
    model.policy.load_state_dict(policy)
    model.policy.optimizer.load_state_dict(optimizer)


def _statistics(normalizer: Any) -> Any:
    """Those of a `VecNormalize`, which it goes on with: what is joined to them it has too."""
    from mjgranular.learn.scaling import Statistics

    none = Statistics.none(normalizer.observation_space.shape)
    observations = normalizer.obs_rms if normalizer.norm_obs else none.observations
    return Statistics(observations, normalizer.ret_rms)


@contextmanager
def _session(on: Workers) -> Iterator[int]:
    """A session of Ray, with the number of its cores."""
    # Each worker is one of Ray's actors, and takes a core.
    ray, mine = begin_ray(on)
    try:
        yield cores_of(ray)
    finally:
        if mine:
            ray.shutdown()


def _runners(settings: Settings, count: int | None, cores: int) -> int:
    """How many workers there are.

    Raises:
        InputError: more than the cluster has cores: they would wait for ever.
    """
    if count is None:
        return _largest_divisor(settings.num_envs, cores)
    if count > cores:
        raise InputError(
            f"the cluster has {cores} cores, and each of {count} env runners takes one: give "
            f"--env-runners {_largest_divisor(settings.num_envs, cores)}"
        )
    return count


def _largest_divisor(number: int, most: int) -> int:
    return max(k for k in range(1, min(number, most) + 1) if number % k == 0)


def built(run: Run, model: Any, runners: int) -> Any:
    """The algorithm of RLlib, which writes nothing anywhere."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of RLlib's, on its own ways
        from ray.rllib.algorithms.ppo import PPOConfig
        from ray.rllib.core.rl_module.rl_module import RLModuleSpec
        from ray.tune.registry import register_env

        from mjgranular.learn.rllib import SandLearner, SandModule, SandPPO, make_envs

        settings = run.settings
        normalizer = model.get_vec_normalize_env()
        name = "mjgranular"
        register_env(name, make_envs)
        steps = _argument(settings, "n_steps")
        word = np.random.SeedSequence([run.seed, model.num_timesteps]).generate_state(1)[0]
        config = (
            PPOConfig(algo_class=SandPPO)
            .environment(
                name,
                env_config={
                    "environment": run.environment,
                    "arguments": run.arguments,
                    "scaling": (
                        settings.normalize_observations,
                        settings.normalize_rewards,
                        normalizer.gamma,
                        normalizer.clip_obs,
                        normalizer.epsilon,
                    ),
                    "versions": versions(),
                },
                clip_actions=True,
                normalize_actions=False,
                disable_env_checking=True,
            )
            .env_runners(
                num_env_runners=runners,
                num_envs_per_env_runner=settings.num_envs // runners,
                gym_env_vectorize_mode="vector_entry_point",
                rollout_fragment_length=steps,
                batch_mode="truncate_episodes",
            )
            .learners(num_learners=0)
            .training(
                **_training(settings, model.num_timesteps),
                train_batch_size_per_learner=steps * settings.num_envs,
                shuffle_batch_per_epoch=True,
                vf_clip_param=float("inf"),
                use_kl_loss=False,
                kl_coeff=0.0,
                grad_clip_by="global_norm",
                learner_class=SandLearner,
                learner_config_dict={"target_kl": _argument(settings, "target_kl")},
            )
            .rl_module(
                rl_module_spec=RLModuleSpec(
                    module_class=SandModule,
                    observation_space=model.observation_space,
                    action_space=model.action_space,
                    model_config={"settings": settings.as_json()},
                )
            )
            .debugging(seed=int(word) % 2**31, log_level="ERROR")
        )
        logging.getLogger("ray.rllib").setLevel(logging.ERROR)
        try:
            with _silent():
                algorithm = config.build_algo()
        except Exception as error:  # of Ray, of a worker, of anybody's environment
            raise InputError(f"the workers of RLlib cannot begin: {told(error)}") from None
        _leave_no_folder(Path(str(algorithm.logdir)))
        return algorithm


@contextmanager
def _silent() -> Iterator[None]:
    """Keeps Ray's library, which no logger reaches, from writing an error where there is none.

    Of every env runner that may be begun again it tells what would happen if this process lost what
    it holds for as long as it lives.
    """
    sys.stderr.flush()
    kept = os.dup(2)
    nothing = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nothing, 2)
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nothing)


def _leave_no_folder(folder: Path) -> None:
    """Removes the empty folder that every algorithm makes, and the one for them all."""
    with suppress(OSError):
        folder.rmdir()
        folder.parent.rmdir()


def _training(settings: Settings, done: int) -> dict[str, Any]:
    """Arguments of RLlib's PPO; what falls goes on falling from where it was."""
    made = {like: _argument(settings, name) for name, like in _LIKE.items() if like}
    start = linear_start(made["lr"])
    if start is not None:
        left = max(settings.total_steps - done, 1)
        made["lr"] = [[0, start * left / settings.total_steps], [left, 0.0]]
    return made


def _argument(settings: Settings, name: str) -> Any:
    """An argument of PPO, or what it is in Stable-Baselines3 by default."""
    signature = inspect.signature(algorithm_class("ppo").__init__).parameters
    return settings.arguments.get(name, signature[name].default)


def told(error: Exception) -> str:
    """What an error of Ray's says, without the tracebacks of all processes."""
    cause = getattr(error, "cause", None)
    lines = [line.strip() for line in str(cause or error).splitlines() if line.strip()]
    return (lines[-1] if lines else type(error).__name__)[:500]
