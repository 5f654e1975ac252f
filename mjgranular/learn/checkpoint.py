"""Checkpoints: all that a training needs to resume, and the policy as it is evaluated."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from mjgranular._util import files
from mjgranular._util.io import read_arrays
from mjgranular.errors import OutputError
from mjgranular.experiment.folder import CONFIG
from mjgranular.learn.run import (
    CURVE,
    POLICY,
    REPLAY,
    STATE,
    Run,
    curve_text,
    open_run,
    read_curve,
    read_state,
)
from mjgranular.learn.weights import (
    NORMALIZER,
    Weights,
    add_spaces,
    brief,
    check_size,
    read_statistics,
    read_weights,
    restore_statistics,
    statistics_of,
)

_OF_THE_END = (POLICY, NORMALIZER, CURVE)  # files of a finished run in its folder itself

# State of the running episodes, which a checkpoint does not keep: see `train.begin_episodes`.
_OF_EPISODES = (
    "_last_obs",
    "_last_original_obs",
    "_last_episode_starts",
    "ep_info_buffer",
    "ep_success_buffer",
)


@dataclass(frozen=True)
class Progress:
    """Progress of a training.

    Attributes:
        steps: steps of all environments together.
        seconds: time spent in training, in all processes together [s].
        curve: rows of `run.CURVE_COLUMNS`.
    """

    steps: int
    seconds: float
    curve: Sequence[tuple[float, ...]]


def save_checkpoint(run: Run, model: Any, progress: Progress) -> Path:
    """Write a checkpoint atomically, and remove all but the newest two.

    Args:
        run: the run, to whose folder it is written.
        model: an algorithm of Stable-Baselines3 on a `VecNormalize`.
        progress: progress so far.

    Returns:
        The checkpoint's folder.

    Raises:
        OutputError: it cannot be written.
    """

    def fill(folder: Path) -> None:
        _write_json(folder / CONFIG, run.config())
        model.save(folder / POLICY, exclude=_OF_EPISODES)
        add_spaces(folder / POLICY, model.observation_space, model.action_space)
        _write_json(folder / NORMALIZER, statistics_of(model.get_vec_normalize_env()))
        (folder / CURVE).write_text(curve_text(progress.curve), encoding="utf-8")
        if hasattr(model, "replay_buffer"):
            write_replay(folder / REPLAY, model.replay_buffer)
        _write_json(folder / STATE, {"steps": progress.steps, "seconds": progress.seconds})

    folder = run.checkpoint_folder(progress.steps)
    files.write_folder(folder, fill)
    run.remove_old_checkpoints(folder)
    return folder


def load_checkpoint(
    folder: Path, run: Run, env: Any, make_model: Callable[[], Any]
) -> tuple[Any, Progress]:
    """Return the model and progress of a checkpoint.

    Nothing in it is executed.

    Args:
        folder: folder of the checkpoint, without a fault.
        run: the run that it belongs to.
        env: a fresh `VecNormalize`, which gets the saved state.
        make_model: makes a fresh model with the run's settings in it.

    Raises:
        OutputError: it is damaged, belongs to another run, or the installed packages cannot read
            it; says which versions wrote it.
    """
    check_belongs(folder, run)
    state = read_statistics(
        folder / NORMALIZER,
        normalized=run.settings.normalize_observations,
        shape=env.observation_space.shape,
    )
    weights = read_weights(folder / POLICY)
    check_spaces(weights, env, folder, run)
    check_size(run.settings, weights, folder / POLICY)
    model = make_model()
    try:
        model.set_parameters(dict(weights.parameters), exact_match=True, device="cpu")
        entropy = weights.variables.get("log_ent_coef")
        if entropy is not None:
            model.log_ent_coef.data = entropy.data.reshape(model.log_ent_coef.shape)
    except Exception as error:  # files of other versions fail in many ways
        raise OutputError(
            f"{folder} cannot be read by the packages installed here ({brief(error)}); it was "
            f"written with {_versions(run)}"
        ) from None
    for name, value in weights.counters.items():
        setattr(model, name, value)
    if hasattr(model, "replay_buffer"):
        read_replay(folder / REPLAY, model.replay_buffer)
    steps, seconds = read_state(folder)
    if steps != model.num_timesteps:
        raise OutputError(f"{folder} is damaged: {STATE} and {POLICY} differ in the steps")
    # Into the environment last: it is unchanged if anything was wrong.
    restore_statistics(env, state)
    return model, Progress(steps, seconds, read_curve(folder / CURVE))


def check_belongs(checkpoint: Path, run: Run) -> None:
    """Raise if a checkpoint is of another run, whose files were mixed with this one's."""
    whose = open_run(checkpoint)
    mine, theirs = (replace(each.settings, total_steps=1) for each in (run, whose))
    if (run.environment, run.seed, mine) != (whose.environment, whose.seed, theirs):
        raise OutputError(
            f"{checkpoint} is of another run ({whose.name}) than {run.path / CONFIG} ({run.name})"
        )


def check_spaces(weights: Weights, env: Any, folder: Path, run: Run) -> None:
    """Raise if weights are for an environment with other observations or actions."""
    for what in ("observation_space", "action_space"):
        mine, there = getattr(weights, what), getattr(env, what)
        if type(mine) is not type(there) or mine.shape != there.shape:
            raise OutputError(
                f"{folder} is not of {run.environment}: its {what.replace('_', ' ')} is {mine}, "
                f"that of the environment {there}"
            )


def write_policy(run: Run, checkpoint: Path) -> None:
    """Copy what evaluation needs from a checkpoint to the run's folder, atomically."""
    with files.replace_directory(run.path) as waiting:
        for name in _OF_THE_END:
            (waiting / name).write_bytes((checkpoint / name).read_bytes())


def write_replay(file: Path, buffer: Any) -> None:
    """Write the part of a `ReplayBuffer` that is in use, as arrays."""
    used = len(buffer.rewards) if buffer.full or buffer.optimize_memory_usage else buffer.pos
    arrays = {name: getattr(buffer, name)[:used] for name in _arrays_of(buffer)}
    with file.open("wb") as stream:
        np.savez(stream, **arrays, pos=buffer.pos, full=buffer.full)


def read_replay(file: Path, buffer: Any) -> None:
    """Put what `write_replay` wrote into a fresh buffer.

    Raises:
        OutputError: it is damaged, or from a buffer of other spaces or size.
    """
    names = _arrays_of(buffer)
    arrays = read_arrays(file, [*names, "pos", "full"], most=None)
    rows, used = len(buffer.rewards), len(arrays["rewards"])
    pos, full = arrays["pos"], arrays["full"]
    if pos.shape or full.shape or not 0 <= pos < rows or used > rows or (full and used != rows):
        raise OutputError(f"{file} is damaged: it is not of a buffer of {rows} rows")
    if not full and pos > used:
        raise OutputError(f"{file} is damaged: it ends before row {int(pos)}")
    for name in names:
        to, array = getattr(buffer, name), arrays[name]
        if array.shape != (used, *to.shape[1:]) or array.dtype != to.dtype:
            raise OutputError(f"{file} is damaged: {name} is not of this run")
        to[:used] = array
    buffer.pos, buffer.full = int(pos), bool(full)


def _arrays_of(buffer: Any) -> list[str]:
    names = ("observations", "next_observations", "actions", "rewards", "dones", "timeouts")
    return [name for name in names if hasattr(buffer, name)]


def _versions(run: Run) -> str:
    names = ("stable-baselines3", "torch", "gymnasium", "numpy")
    return ", ".join(f"{name} {run.versions.get(name)}" for name in names)


def _write_json(file: Path, content: Any) -> None:
    file.write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")
